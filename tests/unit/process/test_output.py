"""Text from outside on standard output, standard error and in the log, and the log's limit on repetitions."""

import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.cli import altd_here
from support.unit_toml import played_toml

from altd.process.logs import (
    LOG_REPEAT_S,
    MAX_CAUSES,
    MAX_WAITING_LINES,
    RepeatLimit,
    StderrLog,
    logging_to_stderr,
)
from altd.process.standard_streams import print_errors, print_lines

HOSTILE = {
    "\x1b[2J": "\\x1b[2J",
    "\n": "\\n",
    "\r": "\\r",
    "\b": "\\x08",
    "\0": "\\x00",
    "\x7f": "\\x7f",
    "\x85": "\\x85",
    "\x9b31m": "\\x9b31m",
    "\u2028": "\\u2028",
    "\u202e": "\\u202e",
    "\u2066": "\\u2066",
    "\u200b": "\\u200b",
    "\udcff": "\\udcff",
    "\U000e0001": "\\U000e0001",
}
"""Characters that a terminal obeys or hides, or that end a line, and their escapes in Python's notation."""


def logged(*texts: object, times: int = 1) -> list[str]:
    """The lines that the log makes of a record of these texts, and of an error that is being handled."""
    reader, writer = os.pipe()
    log = StderrLog("altd: ", writer)
    error = sys.exc_info() if sys.exc_info()[0] is not None else None
    for _ in range(times):
        log.emit(logging.LogRecord("altd", logging.WARNING, "", 0, "unit A%sB", texts, error))
    log.close()
    os.close(writer)
    with open(reader, "rb") as written:  # noqa: PTH123  a descriptor
        return written.read().decode().split("\n")[:-1]


@pytest.mark.parametrize(("raw", "escape"), HOSTILE.items(), ids=ascii)
@pytest.mark.parametrize("put", [print_lines, print_errors], ids=["standard output", "standard error"])
def test_text_from_outside_stays_in_its_line(
    raw: str, escape: str, put: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    put(f"unit A{raw}B", "next é")
    assert "".join(capsys.readouterr()) == f"unit A{escape}B\nnext é\n"


def test_an_answer_is_not_cut_however_long_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Such as the JSON of `altd status`."""
    print_lines("x" * 100_000)
    assert capsys.readouterr().out == "x" * 100_000 + "\n"


@pytest.mark.parametrize(("raw", "escape"), HOSTILE.items(), ids=ascii)
def test_text_from_outside_forges_no_line_of_the_log(raw: str, escape: str) -> None:
    first, repeated = logged(raw, times=2)
    assert first == f"altd: unit A{escape}B"
    assert repeated.startswith(f"{first} (1 more like it in ")


def test_text_in_a_traceback_forges_no_line_of_the_log() -> None:
    try:
        raise ValueError("broke\naltd: all is well\x1b[2J")
    except ValueError:
        first, *traceback = logged("")
    assert first == "altd: unit AB"
    assert traceback[-2:] == ["  ValueError: broke", "  altd: all is well\\x1b[2J"]
    assert all(line.startswith("  ") for line in traceback)


@pytest.mark.parametrize(
    ("command", "shown_on"),
    [
        (("check-config", "{file}"), "out"),
        (("check-config", "{file}.none"), "err"),
        (("run", "--config", "{file}.none"), "err"),
        (("locate", "{file}", "--format", "csv"), "out"),
        (("locate", "{file}"), "out"),
        (("locate", "{file}"), "err"),
        (("token", "{file}.none", "ann", "--remove"), "err"),
        (("replay", "{file}", "--calibration", "none"), "err"),
        (("calibrate", "{file}", "-o", "none"), "err"),
        (("selfcheck", "{file}", "--calibration", "none"), "err"),
        (("events", "--history", "{file}"), "err"),
        (("status", "--socket", "{file}"), "err"),
        (("record", "--config", "{file}.none", "-o", "none", "--seconds", "1"), "err"),
        (("scan", "--config", "{file}.none", "-o", "none"), "err"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, tuple) else part,
)
def test_a_command_shows_no_control_character_of_a_file_name(
    command: tuple[str, ...], shown_on: str, tmp_path: Path
) -> None:
    """The file name has a line end, ESC, a C1 control character, an override and a byte that is not UTF-8."""
    file = f"{tmp_path}/a\n\x1b[2J\x9b31m\u202e\udcff"
    Path(file).write_text(played_toml("cal\\u001b[2J", "none"))
    said = altd_here(*(word.format(file=file) for word in command))
    lines = (said.out + said.err).split("\n")[:-1]
    assert all(line.isprintable() for line in lines), lines
    assert any("x1b[2J" in line or "u001b[2J" in line for line in getattr(said, shown_on).split("\n")), said


log = logging.getLogger("altd")


@contextlib.contextmanager
def own_stderr() -> Iterator[int]:
    """A pipe in place of descriptor 2; gives the end to read from."""
    reader, writer = os.pipe()
    kept = os.dup(2)
    os.dup2(writer, 2)
    os.close(writer)
    try:
        yield reader
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(reader)


def test_what_the_pipe_does_not_take_is_dropped_and_counted() -> None:
    with own_stderr() as reader, logging_to_stderr(logging.INFO):
        for number in range(3 * MAX_WAITING_LINES):
            log.info("line %d %s", number, "x" * 100)
        said = b""
        while b"dropped lines" not in said:
            said += os.read(reader, 65536)
    lines = said.decode().splitlines()
    (counted,) = [line for line in lines if "dropped lines" in line]
    assert len(lines) - 1 + int(counted.split(": ")[-1].split()[0]) == 3 * MAX_WAITING_LINES


def test_what_was_held_back_is_counted_at_the_end() -> None:
    with own_stderr() as reader:
        with logging_to_stderr(logging.INFO):
            for number in range(1000):
                log.warning("camera front: broke %d times", number)
        said = os.read(reader, 65536)
    assert said.decode().splitlines() == [
        "altd: camera front: broke 0 times",
        f"altd: camera front: broke 0 times (999 more like it in {LOG_REPEAT_S:g} s)",
    ]


class TestRepeatLimit:
    @pytest.fixture
    def limit(self) -> RepeatLimit:
        self.now_s = 100.0
        return RepeatLimit(lambda: self.now_s)

    def note(
        self, limit: RepeatLimit, text: str, name: str = "altd", level: int = logging.WARNING
    ) -> str | None:
        return limit.note(logging.LogRecord(name, level, "", 0, text, None, None))

    def test_a_cause_is_said_once_and_then_with_its_count(self, limit: RepeatLimit) -> None:
        assert self.note(limit, "port 0x7f12 of 80") == ""
        assert self.note(limit, "port 0x7f13 of 81") is None
        assert self.note(limit, "port 0x7f14 of 82") is None
        self.now_s += LOG_REPEAT_S
        assert self.note(limit, "port 0x7f15 of 83") == f" (2 more like it in {LOG_REPEAT_S:g} s)"
        assert self.note(limit, "port 0x7f15 of 83") is None

    def test_causes_do_not_hold_each_other_back(self, limit: RepeatLimit) -> None:
        assert self.note(limit, "a") == self.note(limit, "b") == ""
        assert self.note(limit, "a", name="asyncio") == ""
        assert self.note(limit, "a", level=logging.ERROR) == ""

    def test_ever_new_messages_are_a_flood_too(self, limit: RepeatLimit) -> None:
        texts = [f"message {chr(65 + i // 26)}{chr(65 + i % 26)}" for i in range(500)]
        said = [self.note(limit, text, "uvicorn.error") for text in texts]
        assert sum(note is not None for note in said) == MAX_CAUSES + 1
        assert self.note(limit, "our own") == ""
        self.now_s += LOG_REPEAT_S
        assert limit.due() == [
            f"uvicorn: many different messages ({500 - MAX_CAUSES - 1} more like it in {LOG_REPEAT_S:g} s)"
        ]
        assert limit.due() == []

    def test_what_informs_is_not_held_back(self, limit: RepeatLimit) -> None:
        assert [self.note(limit, "measuring", level=logging.INFO) for _ in range(3)] == ["", "", ""]


def test_a_file_never_gets_the_number_of_a_closed_standard_input() -> None:
    code = (
        "import os; from altd.process.standard_streams import prepare_streams; prepare_streams(); "
        "print(os.fstat(0).st_rdev == os.stat(os.devnull).st_rdev, os.open('/', os.O_RDONLY) > 2)"
    )
    command = ["sh", "-c", 'exec "$0" -c "$1" <&-', sys.executable, code]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "True True\n"
