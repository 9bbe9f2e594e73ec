"""The files of the page for a person; the page itself knows the quantities of the instrument."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from altd.records import Quantities, Quantity

_FOLDER = Path(__file__).with_name("page_files")

_TYPES = {".js": "text/javascript", ".css": "text/css"}
"""What is served of the folder; licences and the page's frame are not."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page may run and load nothing but its own unit's files and answers (Content Security Policy 3)."""


@dataclass(frozen=True, slots=True)
class PageFile:
    """A file of the page, as it is served."""

    media_type: str
    content: bytes


def page_of(quantities: Quantities) -> str:
    """The page as a browser gets it. A person sees a decimal less than JSON has."""
    page = (_FOLDER / "index.html").read_text(encoding="utf-8")
    document = json.dumps([_facts(quantity, quantities) for quantity in quantities.of_unit])
    # the only letters that end a script element, which knows no entities
    return page.replace("{/* quantities */}", document.replace("<", "\\u003c"))


def page_files() -> Mapping[str, PageFile]:
    """The page's scripts and styles, by their paths below ``/page/``."""
    return {
        path.relative_to(_FOLDER).as_posix(): PageFile(_TYPES[path.suffix], path.read_bytes())
        for path in sorted(_FOLDER.rglob("*"))
        if path.suffix in _TYPES
    }


def _facts(quantity: Quantity, quantities: Quantities) -> dict[str, object]:
    return {
        "key": quantity.key,
        "label": quantity.label,
        "unit": quantity.unit,
        "meaning": quantity.meaning,
        "decimals": quantity.decimals - 1,
        "is_also": quantity.is_also,
        "is_shown": quantity in quantities.shown,
    }
