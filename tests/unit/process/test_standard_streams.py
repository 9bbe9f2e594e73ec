"""Text from outside on standard output, on standard error and in the log."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from support.cli import altd_here
from support.unit_toml import played_toml

from altd.process.logs import StderrLog
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
