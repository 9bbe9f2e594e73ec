"""The page for a person, with a row for each quantity of the instrument."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path

from altd.records import Quantities, Quantity

_PAGE = Path(__file__).with_name("index.html")


def page_of(quantities: Quantities) -> str:
    """The page as a browser gets it; it shows a decimal less than JSON has."""
    shown = quantities.main
    decimals = {quantity.key: quantity.decimals - 1 for quantity in shown}
    page = _PAGE.read_text(encoding="utf-8")
    page = page.replace("<!-- rows -->", "\n".join(map(_row, shown)))
    return page.replace("{/* decimals */}", json.dumps(decimals))


def _row(quantity: Quantity) -> str:
    label, unit, key = escape(quantity.label), escape(quantity.unit), escape(quantity.key)
    return (
        f'  <tr><th>{label}<td class="value" id="{key}">–<td class="unit">{unit}'
        f'<td class="sigma" id="sigma_{key}"></tr>'
    )
