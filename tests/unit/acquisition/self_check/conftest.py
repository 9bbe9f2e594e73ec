"""Common parts of the tests of the history of self-checks."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.remembered_checks import Unit


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    return Unit(tmp_path)


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture) -> Iterator[list[str]]:
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("altd").addHandler(handler)
    yield said
    logging.getLogger("altd").removeHandler(handler)
