"""`watch`: a line with every tick until a key ends it, and what counts as a key."""

import pytest

from altd.publish.serial.console import PROMPT, Console
from tools.pages.serial_examples import SPOT_LOST, unit_that_shows

from .conftest import answer, console


@pytest.mark.parametrize("seconds", ["0", "-1", "soon", "nan", "inf", "1e9"])
def test_watch_refuses_what_is_no_interval(seconds: str) -> None:
    assert answer(f"watch {seconds}") == [f"watch needs seconds from 0.1 to 3600, not '{seconds}'"]


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
        assert b"No session to end" in unit.feed(line)
        assert b"no command 'xit'" in unit.feed(b"xit\r")

    def test_enter_of_either_kind_ends_it_with_one_prompt(self) -> None:
        for enter in (b"\r", b"\n", b"\r\n"):
            unit = console()
            unit.feed(b"watch\r\n")
            assert unit.feed(enter) == PROMPT

    def test_an_invalid_line_has_its_reasons_and_no_number(self) -> None:
        assert Console(unit_that_shows(SPOT_LOST)).feed(b"watch\r").splitlines()[-1] == (
            b"08:15:31.125  NOT VALID: front_spot_missing rear_spot_missing"
        )

    def test_nothing_measured_is_a_line_too(self) -> None:
        assert console(None).feed(b"watch\r").splitlines()[-1] == b"no measurement so far"
