"""The command line as a person calls it: a process with its output and its exit status."""

import importlib
import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import Any
from unittest import mock


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def objects(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.splitlines()]


def altd(*arguments: object, stdin: str = "", module: str = "altd.cli", timeout_s: float = 200) -> Outcome:
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, arguments)],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def altd_here(*arguments: object, stdin: str = "", module: str = "altd.cli") -> Outcome:
    """The same without a process of its own, which takes half a second to start; logs are not part of it."""
    main = importlib.import_module(f"{module}.__main__").main
    given = io.TextIOWrapper(io.BytesIO(stdin.encode()), "utf-8")
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace") for _ in range(2))
    with redirect_stdout(out), redirect_stderr(err), mock.patch("sys.stdin", given):
        status = main([str(argument) for argument in arguments])
    return Outcome(status, _text_of(out), _text_of(err))


def _text_of(written: io.TextIOWrapper) -> str:
    written.seek(0)  # flushes, too
    return written.buffer.read().decode().replace("\r\n", "\n")


def refusal(outcome: Outcome) -> str:
    """The one line on stderr of a command that refused its input: status 2, no output, no traceback."""
    assert outcome.status == 2, outcome
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    return lines[0]


def unreadable(outcome: Outcome) -> str:
    """The one line on stderr about an image that cannot be read; it has a row too, which gives the reason."""
    assert outcome.status == 2, outcome
    assert [row["reason"] for row in outcome.objects].count("unreadable") == 1
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    return lines[0]
