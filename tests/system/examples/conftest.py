"""The checks of all Modbus clients of ``examples/``."""

import functools
from pathlib import Path

import pytest
from support import example_clients as clients
from support.example_clients import Judge

LANGUAGES = ("python", "c", "structured text", "node-red")


@pytest.fixture(params=LANGUAGES)
def judge(request: pytest.FixtureRequest, tmp_path: Path) -> Judge:
    judges: dict[str, Judge] = {
        "python": clients.by_python,
        "c": functools.partial(clients.by_c, tmp_path),
        "structured text": clients.by_structured_text,
        "node-red": clients.by_node_red,
    }
    return judges[request.param]
