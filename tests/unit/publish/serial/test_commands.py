"""The commands of a console: what they tell, what they ask before they do it, and what programs read."""

import asyncio
import os
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from support.clock import FakeClock
from support.measurements import changed
from support.serving import serving
from support.status_fixtures import checked
from support.wire import Wire

from altd.config import ConsolePortSettings
from altd.publish.serial import commands
from altd.publish.serial.commands import COMMANDS, identification
from altd.publish.serial.console import PROMPT, QUESTION_PROMPT, QUESTION_S, Console
from altd.publish.serial.publisher import ConsolePublisher
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import MEASURING, Health, State
from altd.status.state import UnitState
from altd.status.target_area import TargetArea
from altd.status.unit import PublishedUnit, UnitFacts
from tools.pages.serial_examples import MEASURED, SPOT_LOST

from .conftest import answer, console, well


class TestQuestion:
    @pytest.fixture
    def asked(self) -> list[bool]:
        return []

    @pytest.fixture
    def typed(self, asked: list[bool]) -> Console:
        unit = well()
        unit.self_check.open(lambda: asked.append(True))
        return Console(unit)

    async def test_nothing_is_done_before_a_y(self, typed: Console, asked: list[bool]) -> None:
        assert typed.feed(b"selfcheck now\r").endswith(QUESTION_PROMPT)
        assert typed.asking_s == QUESTION_S == 10.0
        assert asked == []
        assert typed.feed(b"y") == b"yes\r\nchecking: up to ten seconds\r\n"
        assert (asked, typed.asking_s, typed.is_finding) == ([True], None, True)
        service = typed.unit.self_check
        service.publish(checked(service.begin(), time=datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC)))
        assert await typed.found() == b"2026-11-20T08:15:30.125Z: good\r\n> "

    async def test_a_check_that_does_not_end_is_reported(
        self, typed: Console, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(commands, "SELF_CHECK_TIMEOUT_S", 0)
        typed.feed(b"selfcheck now\ry")
        assert await typed.found() == b"not finished within 0 s; see status, then type selfcheck\r\n> "

    @pytest.mark.parametrize(
        "key", [b"n", b"N", b"\r", b"\x03", b"\x1b[A", b"\xff\xe4\xff\xfe", b"\x80x", b"\x7f"]
    )
    def test_any_other_key_or_noise_is_a_no(self, typed: Console, asked: list[bool], key: bytes) -> None:
        typed.feed(b"selfcheck now\r")
        shown = typed.feed(key) + typed.rest()
        assert shown.startswith(b"no\r\n> ")
        typed.feed(b"\x03y\r")
        assert (asked, typed.asking_s) == ([], None)

    def test_who_types_on_is_understood(self, typed: Console, asked: list[bool]) -> None:
        """A program that does not know of questions."""
        assert typed.feed(b"selfcheck now\rversion\r").endswith(
            b"no\r\n> version\r\naltd 0.1.0, unit ALT-0007\r\n> "
        )
        assert asked == []

    def test_a_check_that_has_become_impossible_is_said_so(self, typed: Console) -> None:
        typed.feed(b"selfcheck now\r")
        typed.unit.self_check.unavailable = "the lamps are gone"
        assert b"no self-check: the lamps are gone" in typed.feed(b"y")

    async def test_no_answer_within_ten_seconds_is_a_no(
        self, wire: Wire, board: Board, clock: FakeClock, health: Health, published: PublishedUnit
    ) -> None:
        asked: list[bool] = []
        published.self_check.open(lambda: asked.append(True))
        settings = ConsolePortSettings(device=wire.device, speaks="console")
        publisher = ConsolePublisher(settings, published, health.component("serial"))
        async with serving(publisher):
            wire.send(b"selfcheck now\r")
            await wire.receive(lambda shown: shown.endswith(QUESTION_PROMPT))
            for _ in range(4):  # the rest after what was typed, then the question's time
                await clock.advance((QUESTION_S - 0.1) / 4)
                await asyncio.sleep(0.03)
            with pytest.raises(BlockingIOError):
                os.read(wire.far, 4096)
            await clock.advance(0.2)
            await wire.receive(lambda shown: shown == b"no\r\n> ")
            wire.send(b"y\r")
            await wire.receive(lambda shown: b"no command 'y'" in shown)
        assert asked == []


class TestParts:
    def test_spots_are_told_in_mm_and_as_the_cameras_see_them(self) -> None:
        assert answer("spots") == [
            "front  x 10.012 mm, y 4.987 mm",
            "       spot at u 1 v 2 px",
            "rear   x 15.613 mm, y -3.413 mm",
            "       spot at u 3 v 4 px",
        ]

    def test_no_place_is_told_of_an_invalid_measurement(self) -> None:
        lines = answer("spots", SPOT_LOST)
        assert [line for line in lines if "known" in line] == [
            "front  no place known",
            "rear   no place known",
        ]
        assert answer("spots", None) == ["no measurement so far: wait, or type `health`"]

    def test_health_tells_what_components_say_and_count(self) -> None:
        lines = answer("health")
        assert lines[0].startswith("component ")
        assert any("frames 147600" in line for line in lines)

    def test_calibration_tells_where_it_holds_and_that_it_is_due(self) -> None:
        unit = well()
        corners = ((-75.04, -62.5), (75.0, -62.5), (75.0, 62.51))
        unit.targets = (TargetArea("front", 0.0, corners), TargetArea("rear", 280.0, ()))
        shown = Console(unit).feed(b"calibration\r").decode().split("\r\n")
        assert shown[1:4] == [
            "calibration  2026-11-02, workshop, stage 2",
            "  front      z 0.0 mm, valid within x -75.0 to 75.0, y -62.5 to 62.5 mm",
            "  rear       z 280.0 mm",
        ]

    @pytest.mark.parametrize("line", [name for name in COMMANDS if not name.startswith("*")])
    def test_an_ordinary_answer_is_through_at_9600_baud_in_two_seconds(self, line: str) -> None:
        """A page at a time, so the first one is soon shown. 960 characters a second."""
        assert len(console().feed(line.encode() + b"\r")) <= 2 * 960


class TestForPrograms:
    """IEEE 488.2-1992: 10.14 for the four fields, 11.2 for the bits."""

    def state(
        self,
        board: Board,
        health: Health,
        clock: FakeClock,
        *measurements: Measurement,
    ) -> Console:
        state = UnitState(board, health, clock)
        clock.now_ns += 60_000_000_000  # it has started long since
        for measurement in measurements:
            board.publish(replace(measurement, t_ns=clock.now_ns))
        return Console(PublishedUnit(board, health, state=state.read))

    @staticmethod
    def byte(console: Console) -> int:
        return int(console.feed(b"*stb?\r").decode().split("\r\n")[1])

    def test_the_identification_has_four_fields(self) -> None:
        assert answer("*IDN?") == ["altd,Active Laser Target,ALT-0007,0.1.0"]
        nasty = UnitFacts(serial="A,B;C\n\x1b[2J\u00e4")
        assert identification(nasty).split(",")[2] == "A_B_C__[2J_"
        assert identification(nasty).count(",") == 3

    def test_a_good_unit_has_0(self, board: Board, health: Health, clock: FakeClock) -> None:
        assert self.byte(self.state(board, health, clock, MEASURED)) == 0

    def test_each_signal_has_its_bit_and_the_summary(
        self, board: Board, health: Health, clock: FakeClock
    ) -> None:
        for fault, weight in (
            (Fault(Reason.SIMULATED), 4 + 128),
            (Fault(Reason.SPOT_MISSING, "front"), 2 + 128),
            (Fault(Reason.CAMERA_SILENT, "rear"), 8 + 128),
        ):
            valid = None if weight > 128 else MEASURED
            measured = (
                replace(MEASURED, status=(fault,)) if valid else changed(MEASURED, None, status=(fault,))
            )
            assert self.byte(self.state(board, Health(clock), clock, measured)) == 64 + weight

    async def test_maintenance_is_bit_0(self, board: Board, health: Health, clock: FakeClock) -> None:
        unit = self.state(board, health, clock, MEASURED)
        health.component("lamps").set_state(State.FAILED, "lost")
        for _ in range(60):  # maintenance is asked for after 10 s
            clock.now_ns += 250_000_000
            board.publish(replace(MEASURED, t_ns=clock.now_ns))
            byte = self.byte(unit)
        assert byte == 64 + 1

    def test_before_the_first_measurement_nothing_is_valid(
        self, board: Board, health: Health, clock: FakeClock
    ) -> None:
        assert self.byte(self.state(board, health, clock)) & 128

    @pytest.mark.parametrize(
        ("verdict", "number"),
        [("good", 0), ("suspect", 1), ("bad", 2), ("unknown", 3)],
    )
    def test_the_self_test_is_the_last_self_check(self, verdict: str, number: int) -> None:
        unit = well()
        unit.self_check.open(lambda: pytest.fail("it was asked for"))
        typed = Console(unit)
        assert typed.feed(b"*TST?\r") == b"*TST?\r\n4\r\n> "
        unit.self_check.publish(checked(1, verdict=verdict))
        assert typed.feed(b"*TST?\r") == b"*TST?\r\n%d\r\n> " % number

    @pytest.mark.parametrize("line", ["*RST", "*CLS", "*ESR?", "*IDN", "*", "*IDN? 1"])
    def test_others_of_the_standard_are_not_there(self, line: str) -> None:
        (said,) = answer(line)
        assert said.startswith(("no command ", "too many arguments for "))
        assert console().feed(line.encode() + b"\r").endswith(PROMPT)


def test_a_measuring_that_says_nothing_of_a_target_leaves_its_line_out() -> None:
    unit = well()
    unit.health.component(MEASURING).set_state(State.DEGRADED, "no frames")
    shown = Console(unit).feed(b"spots\r").decode().split("\r\n")
    assert len(shown) == 4


def test_why_there_is_no_self_check_is_told_to_its_end() -> None:
    unit = well()
    unit.self_check.unavailable = "the settings have no [lamps]: there are no frame LEDs to be switched"
    shown = Console(unit).feed(b"selfcheck now\r").decode()
    assert " ".join(shown.split()).endswith("no frame LEDs to be switched >")


def test_in_help_each_command_stands_apart_from_what_it_does() -> None:
    for line, command in zip(answer("help"), COMMANDS.values(), strict=True):
        assert line.startswith(f"{command.usage} ")
        assert line.endswith(command.does)
