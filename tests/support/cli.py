"""The command line as a person calls it: a process with its output and its exit status."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import pytest

from altd.cli.main import main


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def objects(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.splitlines()]


def altd(*arguments: object, stdin: str = "", module: str = "altd.cli") -> Outcome:
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, arguments)],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


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


def refusal_of(*arguments: object, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that refuses its input, without a process of its own."""
    status = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return refusal(Outcome(status, printed.out, printed.err))
