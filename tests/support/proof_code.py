"""The code of ``docs/proof/check.py``, as a reader of the page copies it."""

import re
from types import SimpleNamespace
from typing import Any

from support.places import DOCS


def python() -> Any:
    """The definitions of the file."""
    path = DOCS / "proof" / "check.py"
    source = path.read_text(encoding="utf-8")
    assert "altd" not in re.findall(r"^(?:import|from) (\w+)", source, re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(source, str(path), "exec"), names)
    return SimpleNamespace(**names)
