"""A place for the files of one process' examples: in memory where the computer has that, gone at its end."""

import functools
import tempfile
from pathlib import Path

MEMORY = Path("/dev/shm")


@functools.cache
def _made() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="altd-fuzz-", dir=MEMORY if MEMORY.is_dir() else None)


def folder(name: str) -> Path:
    """The folder of a target, made when it is not there."""
    path = Path(_made().name) / name
    path.mkdir(exist_ok=True)
    return path


def one_line(error: Exception) -> None:
    """The message about a bad file: one line, of limited length."""
    text = str(error)
    assert text.isprintable(), text
    assert len(text) < 10_000
