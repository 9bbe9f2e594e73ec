"""The console as a technician meets it: bytes in, bytes out, no port and no board."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from altd.publish.serial.console import COMMANDS, PROMPT, Console
from altd.publish.serial.examples import MEASURED, SPOT_LOST, health
from altd.publish.serial.words import ADVICE
from altd.records import Fault, Measurement, Reason
from altd.service.health import State


def console(measurement: Measurement | None = MEASURED) -> Console:
    return Console(lambda: measurement, health())


def answer(line: str, measurement: Measurement | None = MEASURED) -> list[str]:
    """What is shown after the echo of one line, without the prompt."""
    shown = console(measurement).feed(line.encode() + b"\r").decode("ascii")
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
        "measure", replace(MEASURED, beam=None, status=(fault,))
    )


def test_status_says_what_is_wrong_and_what_to_do() -> None:
    unit = Console(lambda: SPOT_LOST, health())
    unit.health.component("camera rear").say(State.FAILED, "no such device; next try in 4 s")
    unit.health.component("camera rear").count("frames", 12)
    text = unit.feed(b"status\r").decode().replace("\r\n", "\n")
    assert "serial       ALT-0007" in text
    assert "measuring    NO: front target: no laser spot; rear target: no laser spot" in text
    assert "camera rear        FAILED    0.0 s\n    no such device; next try in 4 s; frames 12" in text
    assert "  - camera rear failed: no such device; next try in 4 s" in text
    assert "switch the laser on" in text


def test_status_says_that_nothing_is_wrong() -> None:
    assert answer("status")[-1] == "nothing is wrong"


def test_no_line_is_wider_than_the_screen() -> None:
    crowd = tuple(Fault(reason, "front", "because of " + "something " * 20) for reason in Reason)
    unit = Console(lambda: replace(SPOT_LOST, status=crowd), health())
    unit.health.component("a" * 60).say(State.DEGRADED, "very " * 60 + "x" * 200)
    unit.health.facts["calibration"] = "long " * 40
    shown = unit.feed(b"status\rmeasure\rwatch\rq" + b"zzz " * 16 + b"\r").decode("ascii")
    assert max(map(len, shown.split("\r\n"))) < 80
    assert shown.count("\n") == shown.count("\r\n")


def test_every_reason_has_its_advice() -> None:
    assert set(ADVICE) == set(Reason)


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

    def test_enter_of_either_kind_ends_it_with_one_prompt(self) -> None:
        for enter in (b"\r", b"\n", b"\r\n"):
            unit = console()
            unit.feed(b"watch\r\n")
            assert unit.feed(enter) == PROMPT

    def test_an_invalid_line_has_its_reasons_and_no_number(self) -> None:
        assert Console(lambda: SPOT_LOST, health()).feed(b"watch\r").splitlines()[-1] == (
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
