"""The code of ``docs/proof.md`` as a reader of the page gets it: taken out of the page."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

from support.places import DOCS


def python() -> Any:
    """What the Python of the page defines."""
    page = (DOCS / "proof.md").read_text(encoding="utf-8")
    found = re.search(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert found is not None
    source = found[1]
    assert "altd" not in re.findall(r"^(?:import|from) (\w+)", source, re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(source, "docs/proof.md", "exec"), names)
    return SimpleNamespace(**names)
