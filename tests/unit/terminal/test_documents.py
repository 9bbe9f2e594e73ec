"""Any program may answer at the socket: only documents that can be shown pass."""

import contextlib
import json
import random
from collections.abc import Callable
from typing import Any

import pytest
from support.daemon_documents import (
    CALIBRATION,
    CHECK,
    DUSTY,
    TARGETS,
    calibrated,
    invalid,
    measurement,
    status,
)

from altd.files.documents import parse_json
from altd.instruments.beam.instrument import QUANTITIES
from altd.terminal.canvas import Canvas
from altd.terminal.documents import (
    CalibrationDocument,
    SelfCheckDocument,
    StatusDocument,
    TargetsDocument,
    checked,
    reading_of,
)
from altd.terminal.knowledge import Knowledge
from altd.terminal.lines import WIDTH, self_check_table, status_text
from altd.terminal.screen import PAGES, ScreenView, draw


def test_a_measurement_is_read_by_the_units_own_quantities() -> None:
    reading = reading_of(measurement(), QUANTITIES)
    assert [(number.label, number.unit, number.value, number.sigma_now) for number in reading.numbers] == [
        ("x", "mm", 35.0123, 0.0288),
        ("y", "mm", -27.5, 0.0151),
        ("yaw", "deg", 1.1459, 0.00196),
        ("pitch", "deg", -1.7184, 0.00161),
    ]
    assert reading.numbers[2].also == (20.0024, "mm/m", 3)
    assert reading.spots == {"front": (35.0123, -27.5), "rear": (-36.0, 13.75)}


def test_a_daemon_may_say_more_than_this_program_knows() -> None:
    newer = status(DUSTY | {"new": 1}) | {"new": []}
    assert checked(StatusDocument, newer).state.causes[0].code == "dusty"


def test_an_invalid_one_has_targets_without_places() -> None:
    reading = reading_of(invalid("stale"), QUANTITIES)
    assert not reading.valid
    assert reading.spots == {"front": None, "rear": None}
    assert {number.value for number in reading.numbers} == {None}


@pytest.mark.parametrize(
    ("document", "place"),
    [
        ([], "the answer"),
        ({}, "sequence"),
        (measurement(valid="perhaps"), "valid"),
        (measurement(x_mm="many"), "value"),
        (measurement(x_mm=float("nan")), "x_mm"),
        (measurement(age_s=float("inf")), "age_s"),
        (measurement(status=["stale"] * 1000), "status"),
        (measurement(front={"x_mm": 1e999, "y_mm": 0.0}), "x_mm"),
        ({"error": "try again later"}, "status"),
    ],
)
def test_what_is_no_measurement_names_the_place(document: object, place: str) -> None:
    with pytest.raises(ValueError, match=f"^{place}: "):
        reading_of(document, QUANTITIES)


def test_control_characters_do_not_reach_a_terminal() -> None:
    nasty = "\x1b[2J\x1b]0;owned\x07\r\n\x9b31m\u202e\u200b"
    cause = DUSTY | {"brief": nasty, "remedy": nasty, "detail": nasty, "of": nasty}
    state = checked(StatusDocument, status(cause) | {"serial": nasty, "version": nasty, "calibration": nasty})
    reading = reading_of(measurement(status=[nasty], time=nasty), QUANTITIES)
    check = checked(SelfCheckDocument, {"verdict": "bad", "reasons": [nasty], "time": nasty})
    calibration = checked(CalibrationDocument, {"targets": [calibrated(nasty, 1.0, 0.01, nasty)]})
    knowledge = Knowledge()
    knowledge.set_reading(reading, 0.0)
    knowledge.set_status(state, 0.0)
    targets = checked(TargetsDocument, TARGETS | {"targets": [{"name": nasty, "z_mm": 0.0, "valid_mm": []}]})
    knowledge.set_documents(check, targets)
    shown = [status_text(reading, state, check, calibration)]
    for page in range(len(PAGES)):
        canvas = Canvas(24, 80, is_utf8=True)
        draw(knowledge, 0.0, ScreenView(page), canvas)
        shown.append(canvas.text())
    for text in shown:
        assert all(line.isprintable() for line in text.split("\n"))


def test_characters_of_two_cells_do_not_move_what_stands_behind() -> None:
    canvas = Canvas(1, 6, is_utf8=True)
    canvas.put(0, 0, "漢e\u0301µ±")
    assert canvas.text() == "?e?µ±"


Spoil = Callable[[random.Random, Any], Any]
_STRANGE = (
    None,
    True,
    -1,
    1e308,
    -(10**30),
    "",
    "\x1b[31m",
    "x" * 3000,
    [],
    {},
    [[]],
    {"a": 1},
    float("nan"),
)


def _spoilt(chance: random.Random, document: Any) -> Any:
    """Something of it is replaced, taken away or added."""
    document = json.loads(json.dumps(document))
    node: Any = document
    for _ in range(chance.randrange(1, 6)):
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else []
        if not keys:
            break
        key = chance.choice(list(keys))
        if isinstance(node[key], (dict, list)) and chance.random() < 0.6:
            node = node[key]
            continue
        if isinstance(node, dict) and chance.random() < 0.3:
            del node[key]
        else:
            node[key] = chance.choice(_STRANGE)
        break
    return document


def test_ten_thousand_spoilt_documents_are_refused_or_shown_within_the_screen() -> None:
    chance = random.Random(13)
    refused = 0
    knowledge = Knowledge()
    for number in range(2_500):
        asked = (
            lambda: reading_of(_spoilt(chance, measurement()), QUANTITIES),
            lambda: checked(StatusDocument, _spoilt(chance, status(DUSTY))),
            lambda: checked(SelfCheckDocument, _spoilt(chance, CHECK)),
            lambda: checked(TargetsDocument, _spoilt(chance, TARGETS)),
            lambda: checked(CalibrationDocument, _spoilt(chance, CALIBRATION)),
        )
        told: list[Any] = []
        for ask in asked:
            with contextlib.suppress(ValueError):
                told.append(ask())
        refused += 5 - len(told)
        if len(told) < 5:
            continue
        knowledge.set_reading(told[0], float(number))
        knowledge.set_status(told[1], float(number))
        knowledge.set_documents(told[2], told[3])
        canvas = Canvas(24, 80, is_utf8=number % 2 == 0)
        draw(knowledge, float(number), ScreenView(number % len(PAGES)), canvas)
        lines = canvas.text().split("\n")
        assert all(len(line) <= 80 and line.isprintable() for line in lines)
        text = status_text(told[0], told[1], told[2], told[4])
        text = "\n".join([text, *self_check_table(told[2])])
        assert all(line.isprintable() and len(line) <= WIDTH for line in text.split("\n")), text
    assert 1_000 < refused < 9_000


@pytest.mark.parametrize(
    "content", [b"", b"nul", b'{"a":', b"\xff", b"[" * 100_000, b"1" * 100, b'{"a":1,"a":2}']
)
def test_what_is_no_json_is_refused_before(content: bytes) -> None:
    with pytest.raises(ValueError, match=r"JSON|nested|digits|twice"):
        parse_json(content)
