"""The parser in C on the same bad line: sanitizers find nothing, and it reads the same as that in Python."""

import atexit
import functools
import tempfile
from pathlib import Path

from fuzz.targets import telegram
from support.telegram_cases import ReaderInC, Variant, read_by_python

NAME = "telegram_c"
EXAMPLES = telegram.EXAMPLES


@functools.cache
def _reader() -> ReaderInC:
    with tempfile.TemporaryDirectory() as folder:
        reader = ReaderInC(Path(folder))
    atexit.register(reader.end)
    return reader


def check(example: Variant) -> None:
    """All readings and what was lost are the same."""
    in_c, in_python = _reader().read(example), read_by_python(example, 1000)
    assert (in_c.readings, in_c.lost) == (in_python.readings, in_python.lost)
