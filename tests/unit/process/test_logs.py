"""The log's limit on repetitions, and what standard error gets; with a daemon: ``tests/system/process``."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator

import pytest

from altd.process.logs import LOG_REPEAT_S, MAX_CAUSES, MAX_WAITING_LINES, RepeatLimit, logging_to_stderr

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
        said = [
            self.note(limit, f"message {chr(65 + i // 26)}{chr(65 + i % 26)}", "uvicorn.error")
            for i in range(500)
        ]
        assert sum(note is not None for note in said) == MAX_CAUSES + 1
        assert self.note(limit, "our own") == ""
        self.now_s += LOG_REPEAT_S
        assert limit.due() == [
            f"uvicorn: many different messages ({500 - MAX_CAUSES - 1} more like it in {LOG_REPEAT_S:g} s)"
        ]
        assert limit.due() == []

    def test_what_informs_is_not_held_back(self, limit: RepeatLimit) -> None:
        assert [self.note(limit, "measuring", level=logging.INFO) for _ in range(3)] == ["", "", ""]
