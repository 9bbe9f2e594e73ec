"""The reader: the Python of ``docs/proof.md``, taken out of the page; nothing of altd is in it."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

PAGE = Path(__file__).parents[2] / "docs" / "proof.md"


def reader() -> Any:
    """What the page's code defines: ``Check``, ``from_block``, ``from_telegram``, ``from_json``."""
    found = re.search(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    if found is None:
        raise ValueError(f"{PAGE}: no Python on it")
    names: dict[str, Any] = {}
    exec(compile(found[1], str(PAGE), "exec"), names)  # noqa: S102  a page of this project
    return SimpleNamespace(**names)
