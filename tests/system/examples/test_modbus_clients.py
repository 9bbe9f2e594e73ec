"""The Modbus clients of ``examples/``: one table of answers, with stale, forged and torn ones, for all."""

from __future__ import annotations

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
"""What must never come through."""

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
    (block(7, age_ms=None, of=None), "late", True),
    (block(8, session=SESSION + 1, of=OTHER), "restarted", False),
    (Wire.EXCEPTION, "no answer", False),
    (block(9), GOOD, True),
    (Wire.EXCEPTION, "no answer", True),
    (Wire.TORN, "no answer", True),
    (Wire.SHORT, "no answer", True),
    (Wire.OTHER_REQUEST, "no answer", True),
    (Wire.SILENT, "no answer", True),
    (block(10), GOOD, True),
    (block(11, of=measurement(160, 0, Reason.PLAYBACK)), "not live", False),
    (block(12), GOOD, True),
    (block(13, of=measurement(160, 0, Reason.SIMULATED)), "not live", False),
    (block(14), GOOD, True),
    (block(15, of=refused(Reason.SPOT_MISSING, "front")), "not valid: front_spot_missing", False),
    (block(16, of=refused(Reason.CAMERA_SILENT, "rear")), "not valid: rear_camera_silent", False),
    (block(17, of=STALE), "not valid: stale", False),
    (forged(block(18, of=OTHER), NAN), "not valid: unknown_reason", False),
    (forged(block(19, of=OTHER), {236: 0xFF80, 237: 0}), "not valid: unknown_reason", False),
    (forged(block(20, of=STALE), {221: 17}), "not valid: unknown_reason", False),
    (forged(block(21, of=STALE), {221: 0xFFFF}), "not valid: unknown_reason", False),
    (forged(block(22, of=OTHER), {220: 0}), "not valid: unknown_reason", False),
    (block(23), GOOD, True),
)
"""What comes for each request, the fault, and whether the last good values are in use then."""
EXPECTED = [(fault, VALUES if usable else None) for _, fault, usable in TABLE]


def test_each_gives_the_verdicts_of_the_table(judge: Judge) -> None:
    polls = [(100.0 * n, said if isinstance(said, bytes) else None) for n, (said, _, _) in enumerate(TABLE)]
    assert judge(polls, SERIAL, LIMIT_MS, False) == EXPECTED


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_program_gives_them_over_a_connection(language: str, tmp_path: Path) -> None:
    words = clients.command(language, tmp_path)
    with answering([said for said, _, _ in TABLE]) as port:
        limit_ms = 4 / 3 * LIMIT_MS  # of it a quarter is for the time between two results
        with clients.running([*words, "127.0.0.1", port, SERIAL, f"{limit_ms:.0f}"]) as told:
            assert [next(told) for _ in TABLE] == EXPECTED


def test_each_reason_has_its_published_name(judge: Judge) -> None:
    polls = [(100.0 * n, block(n + 1, of=refused(reason))) for n, reason in enumerate(REASON_CODES)]
    expected = [(f"not valid: {reason}", None) for reason in REASON_CODES]
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


def test_an_age_above_the_limit_is_late_and_the_limit_itself_is_not(judge: Judge) -> None:
    polls = [(100, block(1, age_ms=499)), (200, block(2, age_ms=501)), (300, block(3, age_ms=60))]
    assert judged(judge, polls) == [(GOOD, True), ("late", False), (GOOD, True)]


def test_what_a_queue_holds_back_is_late_until_the_queue_is_empty(judge: Judge) -> None:
    """A gateway that begins to hand out each answer five polls late: fresh by its age, old by the clocks."""
    polls = [(100 * n, block(n)) for n in range(1, 11)]
    polls += [(100 * n, block(n - 5)) for n in range(16, 30)]
    polls += [(100 * n, block(n)) for n in range(30, 33)]
    assert judged(judge, polls) == [(GOOD, True)] * 10 + [("late", False)] * 14 + [(GOOD, True)] * 3


def test_a_unit_that_answers_but_publishes_nothing_has_stopped(judge: Judge) -> None:
    """Its age is forged: only ``published`` shows it."""
    polls = [(100 * n, block(n, published=min(n, 3))) for n in range(1, 10)]
    polls.append((1000, block(10, published=4)))
    assert judged(judge, polls) == [(GOOD, True)] * 8 + [("stopped", False), (GOOD, True)]


def test_clocks_that_differ_by_100_ppm_make_nothing_late_in_a_day(judge: Judge) -> None:
    for ppm in (100, -100):
        polls = [
            (n * 60_000, block(n, round(n * 60_000 * (1 + ppm * 1e-6)), 490)) for n in range(1, 1440, 180)
        ]
        assert set(judged(judge, polls)) == {(GOOD, True)}


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


def test_a_rising_edge_of_acknowledge_accepts_a_restarted_unit_once() -> None:
    target = Library(clients.STRUCTURED_TEXT.read_text()).new("ALTD_TARGET")
    seen = []
    for session, acknowledge in (
        (1, False),
        (2, False),
        (2, True),
        (2, True),
        (3, True),
        (3, False),
        (3, True),
    ):
        words = struct.unpack(">80H", block(len(seen) + 1, session=session))
        target(
            r=words, answered=True, unit=UNIT, now_ms=100 * len(seen), limit_ms=500.0, acknowledge=acknowledge
        )
        seen.append(clients.FAULTS[target.v["fault"]])
    assert seen == [GOOD, "restarted", GOOD, GOOD, "restarted", "restarted", GOOD]


def test_the_program_of_a_plc_drives_only_by_values_in_use() -> None:
    """Its cycle is shorter than the polls: between two answers nothing comes."""
    program = Library(clients.STRUCTURED_TEXT.read_text()).new("GUIDANCE")
    words = struct.unpack(">80H", block(1))
    program(registers=words, done=True, plc_ms=5000)
    assert (program.v["drive"], program.v["x_mm"]) == (True, pytest.approx(10.012, abs=1e-4))
    drives = []
    for now_ms in (5010, 5689, 5690, 5700):
        program(registers=words, done=False, plc_ms=now_ms)
        drives.append((program.v["drive"], program.v["x_mm"] > 1e29))
    assert drives == [(True, False), (True, False), (False, True), (False, True)]


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
    files = [path for path in files if path.stem != "altd_telegram"]
    lines = {path.name: len(path.read_text().splitlines()) for path in files}
    lines["function"] = len(json.loads(clients.NODE_RED.read_text())[-2]["func"].splitlines())
    assert len(lines) >= 5
    assert max(lines.values()) < 80, lines
