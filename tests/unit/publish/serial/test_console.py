"""The console as a technician meets it: bytes in, bytes out, no port and no board."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.measurements import changed

from altd.instruments.beam.quantities import QUANTITIES
from altd.publish.serial.console import COMMANDS, MORE, PROMPT, Console
from altd.publish.serial.words import WIDTH
from altd.reasons import LEDS_LIT, Reason
from altd.records import Fault, Measurement
from altd.status.health import MEASURING, Health, State
from tools.pages.serial_examples import MEASURED, SPOT_LOST, health


def console(measurement: Measurement | None = MEASURED) -> Console:
    return Console(lambda: measurement, health(), QUANTITIES)


def well() -> Health:
    """A unit with the same parts of which none is ill."""
    unit = health()
    unit.component(MEASURING).say(State.OK, "front: spot at u 1 v 2 px; rear: spot at u 3 v 4 px")
    return unit


def answer(line: str, measurement: Measurement | None = MEASURED) -> list[str]:
    """What is shown after the echo of one line, without the prompt."""
    shown = Console(lambda: measurement, well(), QUANTITIES).feed(line.encode() + b"\r").decode("ascii")
    echo, _, text = shown.partition("\r\n")
    assert echo == line
    assert text.endswith(PROMPT.decode())
    return text.removesuffix(PROMPT.decode()).split("\r\n")[:-1]


def test_the_greeting_names_the_unit_and_ends_with_the_prompt() -> None:
    shown = console().greet()
    assert b"ALT-0007" in shown
    assert shown.endswith(b"\r\n> ")


def test_help_names_every_command() -> None:
    assert [line.split()[0] for line in answer("help")] == list(COMMANDS)


def test_an_empty_line_gives_the_prompt_again() -> None:
    assert answer("") == []


@pytest.mark.parametrize("line", ["HELP", "  help  ", "Help"])
def test_case_and_blanks_do_not_matter(line: str) -> None:
    assert answer(line) == answer("help")


def test_an_unknown_command_is_named_in_one_line() -> None:
    assert answer("reboot now") == ["no command 'reboot'; type help for what there is"]


def test_too_many_words_are_told() -> None:
    assert answer("measure now") == ["too much after measure; it is used as: measure"]


@pytest.mark.parametrize("seconds", ["0", "-1", "soon", "nan", "inf", "1e9"])
def test_watch_refuses_what_is_no_interval(seconds: str) -> None:
    assert answer(f"watch {seconds}") == [f"watch wants seconds from 0.1 to 3600, not '{seconds}'"]


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


def test_measure_shows_no_number_when_there_is_none() -> None:
    lines = answer("measure", SPOT_LOST)
    assert lines[1] == "  NOT VALID"
    assert lines[2].startswith("  front target: no laser spot: switch the laser on")
    assert "mm" not in "\n".join(lines)


def test_measure_says_that_nothing_was_measured_so_far() -> None:
    assert answer("measure", None) == ["no measurement so far: wait some seconds, then see `status`"]


def test_a_playback_is_told_with_every_measurement() -> None:
    playing = replace(MEASURED, status=(Fault(Reason.PLAYBACK),))
    assert "NOT LIVE" in "\n".join(answer("measure", playing))
    assert "NOT LIVE" in "\n".join(answer("status", playing))
    assert b"playback" in console(playing).feed(b"watch\r")


def test_the_detail_of_a_fault_is_shown_in_ascii() -> None:
    fault = Fault(Reason.OUT_OF_RANGE, "rear", "81 mm right of the area − too far")
    assert "    81 mm right of the area ? too far" in answer(
        "measure", changed(MEASURED, None, status=(fault,))
    )


def test_status_says_what_is_wrong_and_what_to_do() -> None:
    unit = Console(lambda: SPOT_LOST, health(), QUANTITIES)
    unit.health.component("camera rear").say(State.FAILED, "not found: /dev/video2; trying again")
    unit.health.component("camera rear").count("frames", 12)
    unit.health.component("serial /dev/ttyS1").say(
        State.FAILED, "there is no such port now; next try in 0.4 s"
    )
    text = unit.feed(b"status\r").decode().replace("\r\n", "\n")
    assert "serial       ALT-0007" in text
    assert "measuring    NO: front and rear targets: no laser spot" in text
    assert "\ncamera rear        FAILED    0.0 s\n" in text
    one_line = re.sub(r"\s+", " ", text)
    assert (
        " - front and rear targets: no laser spot (nothing stands out of the background): switch the laser on"
        in one_line
    )
    assert (
        " - camera rear failed: not found: /dev/video2; trying again: is it plugged in, and has it power?"
        in one_line
    )
    assert " - serial /dev/ttyS1 failed: there is no such port now; next try in 0.4 s " in one_line


def test_neither_raw_codes_nor_healthy_spots_stand_under_what_is_wrong() -> None:
    half = replace(SPOT_LOST, status=SPOT_LOST.status[1:])
    unit = Console(lambda: half, health(), QUANTITIES)
    seen = "front: spot at u 345.5 v 236.8 px, diameter 41 px, peak 175 counts; rear: spot_missing, dark"
    unit.health.component(MEASURING).say(State.DEGRADED, seen)
    text = unit.feed(b"status\r").decode()
    assert "what is wrong" in text
    assert not re.search(r"[a-z]_[a-z]|345\.5", text)
    assert "345.5" in unit.feed(b"status all\r").decode()


def test_status_says_that_nothing_is_wrong() -> None:
    assert "nothing is wrong" in answer("status")


def test_status_all_leaves_out_what_is_not_known() -> None:
    unit = well()
    unit.component("camera rear").observe({"level": None})
    lines = Console(lambda: MEASURED, unit, QUANTITIES).feed(b"status all\r").decode().split("\r\n")
    assert lines[lines.index(next(line for line in lines if line.startswith("camera rear"))) + 1] == (
        "    exposure_control auto, exposure_ms 2.0, frames 147600"
    )


def test_status_of_an_ordinary_unit_fits_a_screen_of_24_lines() -> None:
    """All of its parts, both targets dark: nothing scrolls away."""
    unit = health()
    for name in ("lamps", "indicators", "modbus_tcp 0.0.0.0:502"):
        unit.component(name).say(State.OK)
    shown = Console(lambda: SPOT_LOST, unit, QUANTITIES).feed(b"status\r").decode()
    assert shown.endswith("\r\n> ")
    assert shown.removeprefix("status\r\n").count("\r\n") < 24


@pytest.mark.parametrize(("line", "told"), [("?", "help"), ("VERSION", "altd 0.1.0, unit ALT-0007")])
def test_a_question_mark_helps_and_version_tells(line: str, told: str) -> None:
    assert answer(line)[0].startswith(told)
    assert answer("?") == answer("help")


@pytest.mark.parametrize("line", ["exit", "quit", "Exit"])
def test_who_wants_to_leave_learns_how(line: str) -> None:
    assert answer(line)[0].startswith("there is nothing to leave")
    assert "picocom Ctrl-A Ctrl-X" in answer(line)[1]


@pytest.mark.parametrize("line", [*COMMANDS, "wat", "status x", "\xe4", "\xc3\xa4", "x" * 99])
def test_no_answer_is_cut_at_the_edge_of_the_screen(line: str) -> None:
    unit = Console(lambda: SPOT_LOST, health(), QUANTITIES)
    shown = unit.feed(line.encode("latin-1") + b"\r").split(b"\r\n")
    assert max(map(len, shown)) < WIDTH


def test_a_fault_of_one_target_names_it_and_two_faults_of_one_kind_are_one_step() -> None:
    lit = Fault(Reason.AMBIGUOUS, "front", f"{LEDS_LIT}, 6 of 6 shine at their places")
    unit = Console(
        lambda: replace(SPOT_LOST, status=(lit, replace(lit, target="rear"))), health(), QUANTITIES
    )
    told = " ".join(unit.feed(b"status\r").decode().split())
    assert (
        told.count("- front and rear targets: the frame LEDs are lit (6 of 6 shine at their places): ") == 1
    )
    other = replace(lit, target="rear", detail=f"{LEDS_LIT}, 3 of 6 shine at their places")
    unit = Console(lambda: replace(SPOT_LOST, status=(lit, other)), health(), QUANTITIES)
    told = " ".join(unit.feed(b"status\r").decode().split())
    assert "- front target: the frame LEDs are lit (6 of 6" in told
    assert "- rear target: the frame LEDs are lit (3 of 6" in told


def test_status_takes_no_other_word() -> None:
    assert answer("status everything") == ["status is used as: status [all], not 'everything'"]


def test_ctrl_l_shows_the_line_anew_with_its_cursor() -> None:
    assert console().feed(b"help\x1b[D\x0c") == b"help\b\r\n> help\b"


class TestPages:
    @pytest.fixture
    def crowded(self) -> Console:
        unit = health()
        for number in range(60):
            unit.component(f"serial /dev/ttyS{number:02}").say(State.OK)
        return Console(lambda: MEASURED, unit, QUANTITIES)

    def test_no_page_is_longer_than_a_screen_and_none_is_left_out(self, crowded: Console) -> None:
        pages = [crowded.feed(b"status\r").removeprefix(b"status\r\n")]
        while pages[-1].endswith(MORE):
            pages.append(crowded.feed(b" ").rpartition(b" \r")[2])
        assert len(pages) == 4
        assert max(page.count(b"\r\n") for page in pages) == 23
        assert pages[-1].endswith(b"\r\n> ")
        assert all(b"/dev/ttyS%02d " % number in b"".join(pages) for number in range(60))

    @pytest.mark.parametrize("keys", [b"q", b"Q", b"\x03", b"\x1b[A", b"\x1b[15~", b"\x7f"])
    def test_a_key_ends_them(self, crowded: Console, keys: bytes) -> None:
        assert crowded.feed(b"status\r").endswith(MORE)
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


def test_no_line_is_wider_than_the_screen() -> None:
    crowd = tuple(Fault(reason, "front", "because of " + "something " * 20) for reason in Reason)
    unit = Console(lambda: replace(SPOT_LOST, status=crowd), health(), QUANTITIES)
    unit.health.component("a" * 60).say(State.DEGRADED, "very " * 60 + "x" * 200)
    unit.health.facts["calibration"] = "long " * 40
    shown = unit.feed(b"status\rmeasure\rwatch\rq" + b"zzz " * 16 + b"\r").decode("ascii")
    assert max(map(len, shown.split("\r\n"))) < 80
    assert shown.count("\n") == shown.count("\r\n")


class TestWatch:
    def test_a_line_at_once_and_with_every_tick_until_a_key(self) -> None:
        unit = console()
        shown = unit.feed(b"watch 2\r\n").decode()  # the LF of the pair is no key
        assert unit.watching_s == 2.0
        assert shown.splitlines()[-1] == "08:15:30.125       10.012      4.987     1.1459    -1.7184"
        assert unit.tick() == b"08:15:30.125       10.012      4.987     1.1459    -1.7184\r\n"
        assert unit.feed(b"q") == PROMPT
        assert unit.watching_s is None
        assert unit.tick() == b""

    def test_the_key_that_ends_it_is_no_input(self) -> None:
        unit = console()
        unit.feed(b"watch\r")
        assert unit.feed(b"\x1b[Ahelp\r").startswith(PROMPT + b"help\r\n")

    @pytest.mark.parametrize("keys", [b"\x1b[A", b"\x1bOP", b"\x1b[24~", b"\x0c", b"\x1b[[A", b"\x9bD"])
    def test_a_key_that_sends_a_sequence_ends_it_as_a_whole(self, keys: bytes) -> None:
        unit = console()
        unit.feed(b"watch\r")
        assert b"".join(unit.feed(bytes([key])) for key in keys) == PROMPT

    def test_escape_ends_it_once_nothing_follows(self) -> None:
        unit = console()
        unit.feed(b"watch\r")
        assert unit.feed(b"\x1b") == b""
        assert unit.rest() == PROMPT

    @pytest.mark.parametrize("noise", [b"\0", b"\xfe", b"\xff\xfb\x01", b"\x1b[?62;22c", b"\x1b[I", b"\x8d"])
    def test_what_is_no_key_does_not_end_it(self, noise: bytes) -> None:
        unit = console()
        unit.feed(b"watch\r")
        assert unit.feed(noise) == b""
        assert unit.watching_s is not None

    @pytest.mark.parametrize("line", [b"exit\r", b"quit\r", b"EXIT\r"])
    def test_exit_is_understood_although_its_first_key_ended_it(self, line: bytes) -> None:
        unit = console()
        unit.feed(b"watch\r")
        assert b"there is nothing to leave" in unit.feed(line)
        assert b"no command 'xit'" in unit.feed(b"xit\r")

    def test_enter_of_either_kind_ends_it_with_one_prompt(self) -> None:
        for enter in (b"\r", b"\n", b"\r\n"):
            unit = console()
            unit.feed(b"watch\r\n")
            assert unit.feed(enter) == PROMPT

    def test_an_invalid_line_has_its_reasons_and_no_number(self) -> None:
        assert Console(lambda: SPOT_LOST, health(), QUANTITIES).feed(b"watch\r").splitlines()[-1] == (
            b"08:15:31.125  NOT VALID: front_spot_missing rear_spot_missing"
        )

    def test_nothing_measured_is_a_line_too(self) -> None:
        assert console(None).feed(b"watch\r").splitlines()[-1] == b"no measurement so far"


@given(
    st.lists(st.binary(max_size=60) | st.sampled_from([b"help\r", b"watch\r", b"status\n", b"measure\r\n"]))
)
@settings(max_examples=50)
def test_the_console_survives_anything_in_pieces(pieces: list[bytes]) -> None:
    whole, piecewise = console(), console()
    assert whole.feed(b"".join(pieces)) == b"".join(map(piecewise.feed, pieces))
    assert whole.commands == piecewise.commands
