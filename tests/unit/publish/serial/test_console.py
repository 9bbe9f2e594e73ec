"""The console as a technician meets it: bytes in, bytes out, no port and no board."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.measurements import changed
from support.status_fixtures import checked

from altd.publish.serial.console import PROMPT, Console
from altd.reasons import Reason
from altd.records import Fault
from altd.status.health import State
from tools.pages.example import AGE_S
from tools.pages.serial_examples import MEASURED, SPOT_LOST, unit_that_shows

from .conftest import answer, console, well


def test_the_greeting_names_the_unit_and_ends_with_the_prompt() -> None:
    shown = console().welcome()
    assert b"ALT-0007" in shown
    assert shown.endswith(b"\r\n> ")


def test_an_empty_line_gives_the_prompt_again() -> None:
    assert answer("") == []


@pytest.mark.parametrize("line", ["HELP", "  help  ", "Help"])
def test_case_and_blanks_do_not_matter(line: str) -> None:
    assert answer(line) == answer("help")


def test_an_unknown_command_is_named_in_one_line() -> None:
    assert answer("reboot now") == ["no command 'reboot'; type help for the commands"]


def test_too_many_words_are_told() -> None:
    assert answer("measure now") == ["too many arguments for measure; usage: measure"]


@pytest.mark.parametrize(
    ("keys", "told"),
    [(b"x" * 500, b"line too long"), (bytes(range(128, 256)) * 4, b"wrong baud rate or parity")],
)
def test_an_overlong_line_or_garbage_gives_one_clear_line(keys: bytes, told: bytes) -> None:
    shown = console().feed(keys + b"\r")
    assert told in shown
    assert shown.count(b"\r\n") == 2
    assert shown.endswith(PROMPT)


def test_measure_shows_numbers_with_units_and_sigma() -> None:
    text = "\n".join(answer("measure"))
    assert "measurement 160, 2026-11-20T08:15:30.125Z, mean of 20 exposures" in text
    assert "10.012 mm  +/- 0.004" in text
    assert "-1.7184 deg +/- 0.0011  =  -30.001 mm/m" in text
    assert "not available" in text


def test_measure_and_status_show_what_sigma_is_now() -> None:
    unit = Console(well(MEASURED, AGE_S))
    assert "10.012 mm  +/- 0.004, now 0.029" in unit.feed(b"measure\r").decode()
    sigmas = "sigma now    x 0.029 mm, y 0.015 mm, yaw 0.0020 deg, pitch 0.0016 deg\r\n"
    assert sigmas in unit.feed(b"status\r").decode()


def test_where_nobody_knows_what_sigma_is_now_status_says_so() -> None:
    unknown = replace(MEASURED, motions={})
    unit = Console(well(unknown, AGE_S))
    assert "sigma now    not known: " in unit.feed(b"status\r").decode()
    assert "now" not in unit.feed(b"measure\r").decode()
    lost = Console(well(SPOT_LOST, AGE_S))
    assert "sigma" not in lost.feed(b"status\r").decode()


def test_measure_shows_no_number_when_there_is_none() -> None:
    lines = answer("measure", SPOT_LOST)
    assert lines[1] == "  NOT VALID"
    assert lines[2].startswith("  front target: no laser spot: switch the laser on")
    assert "mm" not in "\n".join(lines)


def test_measure_says_that_nothing_was_measured_so_far() -> None:
    assert answer("measure", None) == ["no measurement so far: wait, or type `health`"]


def test_a_playback_is_told_with_every_measurement() -> None:
    playing = replace(MEASURED, status=(Fault(Reason.PLAYBACK),))
    assert "PLAYBACK" in "\n".join(answer("measure", playing))
    assert "PLAYBACK" in "\n".join(answer("status", playing))
    assert b"playback" in console(playing).feed(b"watch\r")


def test_the_detail_of_a_fault_is_shown_in_ascii() -> None:
    fault = Fault(Reason.OUT_OF_RANGE, "rear", "81 mm right of the area − too far")
    assert "    81 mm right of the area ? too far" in answer(
        "measure", changed(MEASURED, None, status=(fault,))
    )


@pytest.mark.parametrize(("line", "told"), [("?", "help"), ("VERSION", "altd 0.1.0, unit ALT-0007")])
def test_a_question_mark_helps_and_version_tells(line: str, told: str) -> None:
    assert answer(line)[0].startswith(told)
    assert answer("?") == answer("help")


@pytest.mark.parametrize("line", ["exit", "quit", "Exit"])
def test_who_wants_to_leave_learns_how(line: str) -> None:
    assert answer(line)[0].startswith("No session to end")
    assert "picocom Ctrl-A Ctrl-X" in answer(line)[1]


def test_ctrl_l_shows_the_line_anew_with_its_cursor() -> None:
    assert console().feed(b"help\x1b[D\x0c") == b"help\b\r\n> help\b"


def test_no_line_is_wider_than_the_screen() -> None:
    crowd = tuple(Fault(reason, "front", "because of " + "something " * 20) for reason in Reason)
    unit = Console(unit_that_shows(replace(SPOT_LOST, status=crowd)))
    unit.unit.health.component("a" * 60).set_state(State.DEGRADED, "very " * 60 + "x" * 200)
    unit.unit.facts = unit.unit.facts.model_copy(update={"calibration": "long " * 40})
    shown = unit.feed(b"status\rmeasure\rwatch\rq" + b"zzz " * 16 + b"\r").decode("ascii")
    assert max(map(len, shown.split("\r\n"))) < 80
    assert shown.count("\n") == shown.count("\r\n")


@given(
    st.lists(st.binary(max_size=60) | st.sampled_from([b"help\r", b"watch\r", b"status\n", b"measure\r\n"]))
)
@settings(max_examples=50)
def test_the_console_survives_anything_in_pieces(pieces: list[bytes]) -> None:
    whole, piecewise = console(), console()
    assert whole.feed(b"".join(pieces)) == b"".join(map(piecewise.feed, pieces))
    assert whole.commands == piecewise.commands


class TestSelfCheck:
    def test_where_there_is_none_says_why(self) -> None:
        assert answer("selfcheck") == ["no self-check: this unit has no frame LEDs that the daemon switches"]
        assert answer("selfcheck now") == answer("selfcheck")

    def test_shows_the_last_one_and_asks_for_another(self) -> None:
        unit, asked = well(), []
        unit.self_check.open(lambda: asked.append(True))
        typed = Console(unit)
        assert b"no self-check since the unit started" in typed.feed(b"selfcheck\r")
        reason = "front: shift 1.20 px, 0.061°, " + "which is a great deal more than anybody allows " * 3
        time = datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC)
        unit.self_check.publish(checked(1, reason.strip(), verdict="bad", time=time))
        shown = typed.feed(b"selfcheck\r").decode("ascii")
        assert "\r\n2026-11-20T08:15:30.125Z: bad: front: shift 1.20 px, 0.061 deg, which" in shown
        assert "anybody allows\r\n>" in shown  # nothing of it is cut off
        assert not asked
        assert typed.feed(b"SELFCHECK Now\r").endswith(b"Start? (y: yes) ")
        assert not asked
        assert b"checking" in typed.feed(b"y")
        assert asked == [True]

    def test_nothing_else_can_be_asked_of_it(self) -> None:
        assert answer("selfcheck later") == ["usage: selfcheck [now], not 'later'"]

    @pytest.mark.parametrize(
        "keys",
        [
            b"selfcheck\x00now\r",
            b"selfcheck now\xff\r",
            b"\x80\xfeselfcheck now\r",
            b"selfcheck " + b"now " * 1000 + b"\r",
            b"selfcheck now" + b" " * 1000 + b"\r",
            b"selfcheck now now\r",
            b"selfcheck\tnow\x1b[",
            b"selfcheck now\x03\r",
        ],
    )
    def test_noise_and_lines_without_end_ask_for_nothing(self, keys: bytes) -> None:
        unit = well()
        unit.self_check.open(lambda: pytest.fail("it was asked for"))
        typed = Console(unit)
        typed.feed(keys)
        assert b"altd" in typed.feed(b"\x03\x03version\r")
