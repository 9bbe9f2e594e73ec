"""The Modbus clients of ``examples/``: one table of answers, with stale, forged and torn ones, for all."""

import json
import random
import struct
from pathlib import Path

import pytest
from support import example_clients as clients
from support.example_clients import Judge, Polls
from support.measurements import measured, measurement
from support.places import EXAMPLES
from support.scripted_unit import (
    SERIAL,
    SESSION,
    UNIT,
    Wire,
    answering,
    block,
    flipped,
    forged,
    refused,
    swapped,
)
from support.structured_text import Library

from altd.instruments.beam.solver import Beam
from altd.publish.modbus.registers import WordOrder
from altd.publish.modbus.values import REASON_CODES
from altd.reasons import Reason

VALUES = pytest.approx((10.012, 4.987, 1.1459, -1.7184), abs=1e-4)
LIMIT_MS = 30_000.0
"""Of the table: no delay of a busy machine reaches it."""

_, CDAB, BADC, DCBA = WordOrder
OTHER = measured(Beam(99.0, 99.0, 9.0, 9.0, 0.004, 0.004, 0.0011, 0.0011))
"""Values that must never come through."""

GOOD, STALE, NAN = "good", refused(Reason.STALE), {230: 0x7FC0, 231: 0}
TABLE: tuple[tuple[bytes | Wire, str, bool], ...] = (
    (block(2), GOOD, True),
    (block(3), GOOD, True),
    (block(3), "not newer", True),
    (block(2, of=OTHER), "not newer", True),
    (block(3 + 2**31, of=OTHER), "not newer", True),
    (flipped(block(4, of=OTHER), 480), "corrupt", True),
    (bytes(160), "corrupt", True),
    (b"\xff" * 160, "corrupt", True),
    (swapped(block(4, of=OTHER), 2), "corrupt", True),
    (swapped(block(4, of=OTHER), 4), "corrupt", True),
    *((block(4, of=OTHER, order=order), "corrupt", True) for order in (CDAB, BADC, DCBA)),
    (forged(block(4, of=OTHER), {200: 2}), "corrupt", True),
    (block(5, unit=UNIT ^ 1, of=OTHER), "foreign", True),
    (block(6, age_ms=3_600_000, of=OTHER), "late", True),
    (forged(block(7, of=OTHER), {218: 0xFFFF, 219: 0xFFFE}), "late", True),
    (forged(block(8, of=OTHER), {218: 0xFFFF, 219: 0xFFFF}), "not valid: unknown_reason", False),
    (block(9), GOOD, True),
    (Wire.EXCEPTION, "no answer", True),
    (Wire.TORN, "no answer", True),
    (Wire.SHORT, "no answer", True),
    (Wire.OTHER_REQUEST, "no answer", True),
    (Wire.SILENT, "no answer", True),
    (block(10), GOOD, True),
    (block(11, age_ms=None, of=None), "not valid: warming_up", False),
    (block(12), GOOD, True),
    (block(13, of=measurement(160, 0, Reason.PLAYBACK)), "not live", False),
    (block(14), GOOD, True),
    (block(15, of=measurement(160, 0, Reason.SIMULATED)), "not live", False),
    (block(16), GOOD, True),
    (block(17, of=refused(Reason.SPOT_MISSING, "front")), "not valid: front_spot_missing", False),
    (block(18, of=refused(Reason.CAMERA_SILENT, "rear")), "not valid: rear_camera_silent", False),
    (block(19, of=STALE), "not valid: stale", False),
    (forged(block(20, of=OTHER), NAN), "not valid: unknown_reason", False),
    (forged(block(21, of=OTHER), {236: 0xFF80, 237: 0}), "not valid: unknown_reason", False),
    (forged(block(22, of=STALE), {221: 17}), "not valid: unknown_reason", False),
    (forged(block(23, of=STALE), {221: 0xFFFF}), "not valid: unknown_reason", False),
    (forged(block(24, of=OTHER), {220: 0}), "not valid: unknown_reason", False),
    (block(25), GOOD, True),
    (block(26, session=SESSION + 1, of=OTHER), "restarted", False),
    (Wire.EXCEPTION, "no answer", False),
    (block(27, session=SESSION + 1, of=OTHER), "restarted", False),
    (block(27, session=SESSION + 1, of=OTHER), "not newer", False),
    (block(28), "restarted", False),
    (block(29), "restarted", False),
)
"""The answer to each request, the fault, and whether the last good values are in use then."""
EXPECTED = [(fault, VALUES if usable else None) for _, fault, usable in TABLE]


def test_each_gives_the_verdicts_of_the_table(judge: Judge) -> None:
    polls = [(100.0 * n, said if isinstance(said, bytes) else None) for n, (said, _, _) in enumerate(TABLE)]
    assert judge(polls, SERIAL, LIMIT_MS, False) == EXPECTED


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_program_gives_them_over_a_connection(language: str, tmp_path: Path) -> None:
    words = clients.command(language, tmp_path)
    with answering([said for said, _, _ in TABLE]) as port:
        limit_ms = 4 / 3 * LIMIT_MS  # of it a quarter is for the time between two results
        with clients.running([*words, "127.0.0.1", port, SERIAL, f"{limit_ms:.0f}"]) as (_, told):
            assert [next(told) for _ in TABLE] == EXPECTED


OF_OTHERS = {
    Reason.LEDS_MISSING,
    Reason.LEDS_MISFIT,
    Reason.STUCK_CLEAR,
    Reason.SLOW,
    Reason.NOT_CONFIRMED,
    Reason.CAMERAS_SWAPPED,
    Reason.BEAM_LOST,
}
"""Reasons of a plate and of a row; the examples read a beam."""


def test_each_reason_has_its_published_name(judge: Judge) -> None:
    of_beam = [reason for reason in REASON_CODES if reason not in OF_OTHERS]
    polls = [(100.0 * n, block(n + 1, of=refused(reason))) for n, reason in enumerate(of_beam)]
    expected = [(f"not valid: {reason}", None) for reason in of_beam]
    assert judge(polls, SERIAL, LIMIT_MS, False) == expected, "put a new reason into all examples"


@pytest.mark.parametrize("reason", [Reason.PLAYBACK, Reason.SIMULATED])
def test_values_that_are_not_live_are_used_only_to_rehearse(judge: Judge, reason: Reason) -> None:
    polls = [(0.0, block(1, of=measurement(160, 0, reason)))]
    assert judge(polls, SERIAL, LIMIT_MS, True) == [(GOOD, VALUES)]
    assert judge(polls, SERIAL, LIMIT_MS, False) == [("not live", None)]


def judged(judge: Judge, polls: Polls) -> list[tuple[str, bool]]:
    """The faults, and whether values are in use, for a limit of 500 ms."""
    return [(fault, values is not None) for fault, values in judge(polls, SERIAL, 500, False)]


def test_values_are_dropped_at_the_limit_whatever_comes(judge: Judge) -> None:
    """60 ms old when they came at 1000 ms, so they may be used for 440 ms more."""
    for says, fault in ((None, "no answer"), (bytes(160), "corrupt"), (block(1), "not newer")):
        polls = [(1000, block(1)), (1439, says), (1440, says), (1441, says), (9999, says)]
        assert judged(judge, polls) == [(GOOD, True), (fault, True), *[(fault, False)] * 3]


def test_a_delay_shortens_the_time_that_values_are_in_use(judge: Judge) -> None:
    """The second answer was held back for 100 ms: 60 ms + 100 ms of 500 ms are over when it comes."""
    polls = [(100, block(1)), (300, block(2)), (639, None), (641, None)]
    assert judged(judge, polls) == [(GOOD, True), (GOOD, True), ("no answer", True), ("no answer", False)]


def test_a_restarted_unit_is_refused_until_an_operator_acknowledges_it(judge: Judge) -> None:
    polls: list[tuple[float, bytes | None]] = [(100, block(1)), (200, block(2, session=1)), (300, None)]
    polls += [(310, clients.ACKNOWLEDGE), (400, None), (500, block(3, session=1))]  # before it answers again
    polls += [(510, clients.ACKNOWLEDGE), (600, block(4, session=2))]  # of another session than was shown
    polls += [(700, block(5, session=2)), (710, clients.ACKNOWLEDGE), (800, block(6, session=2))]
    polls += [(900, block(6, session=2)), (1000, block(1))]
    assert judged(judge, polls) == [
        (GOOD, True),
        ("restarted", False),
        ("no answer", False),
        ("no answer", False),
        *[("restarted", False)] * 3,
        (GOOD, True),
        ("not newer", True),
        ("restarted", False),
    ]


def test_a_unit_that_was_silent_is_refused_until_an_operator_acknowledges_it(judge: Judge) -> None:
    """Silent for longer than the limit, and back; at the end its answers are held up for 0.6 s."""
    polls: list[tuple[float, bytes | None]] = [(100 * n, block(n)) for n in (1, 2)]
    polls += [(700, block(7)), (1201, block(12)), (1300, clients.ACKNOWLEDGE), (1800, block(18))]
    polls += [(1900, block(19)), (1910, clients.ACKNOWLEDGE), (2000, block(20)), (2010, clients.ACKNOWLEDGE)]
    polls += [(2600, bytes(160)), (2700, block(21)), (2710, clients.ACKNOWLEDGE), (2800, block(22))]
    assert judged(judge, polls) == [
        *[(GOOD, True)] * 3,
        *[("silent", False)] * 3,
        (GOOD, True),
        ("corrupt", False),
        ("silent", False),
        ("late", False),
    ]


def test_no_unit_has_the_number_zero(judge: Judge) -> None:
    """A controller whose unit number was never set, and a unit or a line that sends zeros with their CRC."""
    assert judge([(100, block(1, unit=0))], "", 500, False) == [("foreign", None)]


def test_an_age_above_the_limit_is_late_and_the_limit_itself_is_not(judge: Judge) -> None:
    polls = [(100, block(1, age_ms=499)), (200, block(2, age_ms=501)), (300, block(3, age_ms=60))]
    assert judged(judge, polls) == [(GOOD, True), ("late", False), (GOOD, True)]


def test_what_a_queue_holds_back_is_late_until_the_queue_is_empty(judge: Judge) -> None:
    """A gateway that comes to hand out each answer five polls late: fresh by its age, old by the clocks."""
    polls = [*((100 * n, block(n)) for n in range(1, 11)), (1300, block(11))]
    polls += [(100 * n, block(n - 5)) for n in range(17, 30)]
    polls += [(100 * n, block(n)) for n in range(30, 33)]
    assert judged(judge, polls) == [(GOOD, True)] * 11 + [("late", False)] * 13 + [(GOOD, True)] * 3


def test_a_unit_that_answers_but_publishes_nothing_has_stopped(judge: Judge) -> None:
    """Its age is forged: only ``published`` shows it."""
    polls = [(100 * n, block(n, published=min(n, 3))) for n in range(1, 10)]
    polls.append((1000, block(10, published=4)))
    assert judged(judge, polls) == [(GOOD, True)] * 8 + [("stopped", False), (GOOD, True)]


def test_a_unit_that_has_not_measured_yet_is_warming_up(judge: Judge) -> None:
    """It has published 0 measurements, which is also a number that a reader may begin with."""
    polls = [(2000 + 50 * n, block(n, age_ms=None, published=0, of=None)) for n in range(1, 4)]
    assert judged(judge, polls) == [("not valid: warming_up", False)] * 3


def test_clocks_that_differ_by_100_ppm_make_nothing_late_in_a_day(judge: Judge) -> None:
    """A limit of an hour, and each hour a value that is 10 ms younger: 100 ppm are 360 ms in that time."""
    hour_ms = 3_600_000
    for ppm in (100, -100):
        polls = [
            (n * hour_ms, block(n, round(n * hour_ms * (1 + ppm * 1e-6)), hour_ms - 10)) for n in range(24)
        ]
        verdicts = judge(polls, SERIAL, hour_ms, False)
        assert [fault for fault, _ in verdicts] == [GOOD] * 24


def test_a_unit_may_have_started_long_after_its_reader(judge: Judge) -> None:
    polls = [(1e6 + 100 * n, block(n, 100 * n)) for n in (1, 2)]
    assert judged(judge, polls) == [(GOOD, True)] * 2


def test_counters_wrap(judge: Judge) -> None:
    top = 0xFFFF_FFFE
    polls = [
        (2**32 - 1000 + n * 400, block((top - 2 + n) % (top + 1), (top - 900 + n * 400) % (top + 1)))
        for n in range(6)
    ]
    assert judged(judge, polls) == [(GOOD, True)] * 6


def test_any_corruption_of_a_block_is_found(judge: Judge) -> None:
    chance = random.Random(1)
    polls = [(0, block(1))]
    for _ in range(30):
        places = chance.sample(range(1280), chance.choice((1, 1, 2, 3, 9, 600)))
        polls.append((100, flipped(block(2), *places)))
    assert judged(judge, [*polls, (100, block(2))]) == [(GOOD, True), *[("corrupt", True)] * 30, (GOOD, True)]


def test_a_button_that_is_held_down_acknowledges_once() -> None:
    """In a cycle without an answer, too, and where registers that were read before are given again."""
    target = Library(clients.STRUCTURED_TEXT.read_text()).new("ALTD_TARGET")
    seen = []
    for message, session, acknowledge in (
        *((1, 1, False), (2, 2, False), (2, 2, True), (3, 2, True), (4, 2, True)),
        *((5, 3, True), (6, 3, True), (6, 3, False), (6, 3, True), (7, 3, True)),
    ):
        words = struct.unpack(">80H", block(message, session=session))
        clock = {"unit": UNIT, "now_ms": 100 * message, "limit_ms": 500.0, "acknowledge": acknowledge}
        target(r=words, answered=True, **clock)
        seen.append(clients.FAULTS[target.v["fault"]])
    assert seen[:5] == [GOOD, "restarted", "not newer", GOOD, GOOD]
    assert seen[5:] == ["restarted", "restarted", "not newer", "not newer", GOOD]


def test_the_program_of_a_plc_drives_only_by_values_in_use() -> None:
    """Its cycle is shorter than the polls: between two answers nothing comes."""
    program = Library(clients.STRUCTURED_TEXT.read_text()).new("GUIDANCE")

    def shown(now_ms: int, answer: bytes | None = None) -> tuple[bool, bool, str]:
        given = {} if answer is None else {"registers": struct.unpack(">80H", answer)}
        program(**given, done=answer is not None, plc_ms=now_ms)
        v = program.v
        return (
            v["drive"],
            v["x_mm"] == pytest.approx(10.012, abs=1e-4),
            clients.FAULTS[v["fault"]] + v["reason"],
        )

    assert shown(4900, block(1)) == (False, False, "foreign"), "the number of the unit was not put in"
    program.v["unit"] = UNIT
    assert shown(5000, block(2)) == (True, True, GOOD)
    assert [shown(ms)[:2] for ms in (5010, 5689, 5690)] == [(True, True), (True, True), (False, False)]
    assert shown(5700, block(3, of=STALE)) == (False, False, "not valid: stale")
    assert shown(5710, block(4)) == (True, True, GOOD), "the reason has gone"


def test_the_flow_of_node_red_is_wired() -> None:
    tab, *nodes = flow = json.loads(clients.NODE_RED.read_text())
    assert (tab["type"], {value["name"]: value["value"] for value in tab["env"]}["REHEARSAL"]) == (
        "tab",
        "false",
    )
    by_id = {node["id"]: node for node in nodes}
    assert len({node["id"] for node in flow}) == len(flow)
    assert all(node["z"] == tab["id"] for node in nodes)
    (check,) = (node for node in nodes if node["type"] == "function")
    sources = [
        node
        for node in nodes
        if check["id"] in [target for output in node.get("wires", []) for target in output]
    ]
    assert [node["type"] for node in sources] == ["modbus-read", "catch", "inject", "inject"]
    assert all(target in by_id for node in nodes for output in node.get("wires", []) for target in output)
    read, caught, clock, acknowledge = sources
    assert (read["dataType"], read["adr"], read["quantity"]) == ("InputRegister", "200", "80")
    assert read["wires"][0] == [check["id"]]
    assert by_id[read["server"]]["type"] == "modbus-client"
    assert not by_id[read["server"]]["bufferCommands"], "a queue makes answers late"
    assert (caught["scope"], read["showErrors"]) == ([read["id"]], True)
    assert (clock["repeat"], acknowledge["topic"]) == ("0.05", "acknowledge")


def test_each_example_has_less_than_80_lines() -> None:
    """The parser of the telegram, ``altd_telegram``, is a library that an example uses."""
    files = [path for path in EXAMPLES.rglob("*.*") if path.is_file() and path.suffix != ".pyc"]
    files = [path for path in files if path.stem != "altd_telegram" and "grafana" not in path.parts]
    lines = {path.name: len(path.read_text().splitlines()) for path in files}
    lines["function"] = len(json.loads(clients.NODE_RED.read_text())[-2]["func"].splitlines())
    assert len(lines) >= 5
    assert max(lines.values()) < 80, lines
