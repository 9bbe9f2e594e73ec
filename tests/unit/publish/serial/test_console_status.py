"""`status` on a unit and its faults, on pages that fit a screen."""

import re
from dataclasses import replace

import pytest

from altd.publish.serial.console import MORE_PROMPT, Console
from altd.reasons import Reason
from altd.records import Fault, FaultCause
from altd.status.health import MEASURING, CameraTrouble, State
from tools.pages.serial_examples import MEASURED, SPOT_LOST, unit_that_shows

from .conftest import answer, well


def test_status_says_what_is_wrong_and_what_to_do() -> None:
    unit = Console(unit_that_shows(SPOT_LOST))
    unit.unit.health.component("camera rear").set_state(
        State.FAILED, "not found: /dev/video2; trying again", CameraTrouble.NOT_FOUND
    )
    unit.unit.health.component("camera rear").count("frames", 12)
    unit.unit.health.component("serial /dev/ttyS1").set_state(
        State.FAILED, "there is no such port now; next try in 0.4 s"
    )
    text = unit.feed(b"status\r").decode().replace("\r\n", "\n")
    assert "serial       ALT-0007" in text
    assert "measuring    NO: front and rear targets: no laser spot" in text
    assert "\ncamera rear        FAILED    0.0 s\n" in text
    one_line = re.sub(r"\s+", " ", text)
    why = "no laser spot (nothing is brighter than the background): switch the laser on"
    assert f" - front and rear targets: {why}" in one_line
    assert (
        " - camera rear failed: not found: /dev/video2; trying again: check its cable and power" in one_line
    )
    assert " - serial /dev/ttyS1 failed: there is no such port now; next try in 0.4 s " in one_line


def test_neither_raw_codes_nor_healthy_spots_stand_under_what_is_wrong() -> None:
    half = replace(SPOT_LOST, status=SPOT_LOST.status[1:])
    unit = Console(unit_that_shows(half))
    seen = "front: spot at u 345.5 v 236.8 px, diameter 41 px, peak 175 counts; rear: spot_missing, dark"
    unit.unit.health.component(MEASURING).set_state(State.DEGRADED, seen)
    text = unit.feed(b"status\r").decode()
    assert "causes and remedies" in text
    assert not re.search(r"[a-z]_[a-z]|345\.5", text)
    assert "345.5" in unit.feed(b"status all\r").decode()


def test_status_says_that_nothing_is_wrong() -> None:
    assert "nothing is wrong" in answer("status")


def test_status_all_leaves_out_what_is_not_known() -> None:
    unit = well()
    unit.health.component("camera rear").observe({"level": None})
    lines = Console(unit).feed(b"status all\r").decode().split("\r\n")
    assert lines[lines.index(next(line for line in lines if line.startswith("camera rear"))) + 1] == (
        "    exposure_control auto, exposure_ms 2.0, frames 147600"
    )


def test_status_of_an_ordinary_unit_fits_a_screen_of_24_lines() -> None:
    """All of its parts, both targets dark: nothing scrolls away."""
    unit = unit_that_shows(SPOT_LOST)
    for name in ("lamps", "indicators", "modbus_tcp 0.0.0.0:502"):
        unit.health.component(name).set_state(State.OK)
    shown = Console(unit).feed(b"status\r").decode()
    assert shown.endswith("\r\n> ")
    assert shown.removeprefix("status\r\n").count("\r\n") < 24


def test_a_fault_of_one_target_names_it_and_two_faults_of_one_kind_are_one_step() -> None:
    lit = Fault(
        Reason.AMBIGUOUS, "front", "the frame LEDs are lit, 6 of 6 shine at their places", FaultCause.LEDS_LIT
    )
    unit = Console(unit_that_shows(replace(SPOT_LOST, status=(lit, replace(lit, target="rear")))))
    told = " ".join(unit.feed(b"status\r").decode().split())
    assert (
        told.count("- front and rear targets: the frame LEDs are lit (6 of 6 shine at their places): ") == 1
    )
    other = replace(lit, target="rear", detail="the frame LEDs are lit, 3 of 6 shine at their places")
    unit = Console(unit_that_shows(replace(SPOT_LOST, status=(lit, other))))
    told = " ".join(unit.feed(b"status\r").decode().split())
    assert "- front target: the frame LEDs are lit (6 of 6" in told
    assert "- rear target: the frame LEDs are lit (3 of 6" in told


def test_status_takes_no_other_word() -> None:
    assert answer("status everything") == ["usage: status [all], not 'everything'"]


class TestPages:
    @pytest.fixture
    def crowded(self) -> Console:
        unit = unit_that_shows(MEASURED)
        for number in range(60):
            unit.health.component(f"serial /dev/ttyS{number:02}").set_state(State.OK)
        return Console(unit)

    def test_no_page_is_longer_than_a_screen_and_none_is_left_out(self, crowded: Console) -> None:
        pages = [crowded.feed(b"status\r").removeprefix(b"status\r\n")]
        while pages[-1].endswith(MORE_PROMPT):
            pages.append(crowded.feed(b" ").rpartition(b" \r")[2])
        assert len(pages) == 4
        assert max(page.count(b"\r\n") for page in pages) == 23
        assert pages[-1].endswith(b"\r\n> ")
        assert all(b"/dev/ttyS%02d " % number in b"".join(pages) for number in range(60))

    @pytest.mark.parametrize("keys", [b"q", b"Q", b"\x03", b"\x1b[A", b"\x1b[15~", b"\x7f"])
    def test_a_key_ends_them(self, crowded: Console, keys: bytes) -> None:
        assert crowded.feed(b"status\r").endswith(MORE_PROMPT)
        assert crowded.feed(keys).endswith(b" \r> ")
        assert crowded.feed(b"version\r").startswith(b"version\r\n")

    def test_who_types_on_is_understood(self, crowded: Console) -> None:
        """A program that does not know of pages, or a technician who has seen enough."""
        shown = crowded.feed(b"status\rversion\r")
        assert shown.endswith(b"\r> version\r\naltd 0.1.0, unit ALT-0007\r\n> ")

    def test_noise_does_not_end_them(self, crowded: Console) -> None:
        crowded.feed(b"status\r")
        assert crowded.feed(b"\0\xfe\xff\xfb\x01\x1b[?62c") == b""
        assert crowded.feed(b"\r").startswith(b"\r")
