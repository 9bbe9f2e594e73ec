"""A made-up unit after a minute: x climbs, ten seconds of it were lost."""

from __future__ import annotations

from typing import Any

from support.daemon_documents import CHECK, DUSTY, SPOT_MISSING, TARGETS, invalid, measurement, status

from altd.instruments.beam.instrument import QUANTITIES
from altd.terminal.canvas import Canvas
from altd.terminal.documents import SelfCheckDocument, StatusDocument, TargetsDocument, reading_of
from altd.terminal.knowledge import Knowledge
from altd.terminal.screen import View, draw

LAST_S = 1059.0


def hear(knowledge: Knowledge, document: dict[str, Any], now_s: float) -> None:
    knowledge.set_reading(reading_of(document, QUANTITIES), now_s)


def after_a_minute() -> Knowledge:
    """At ``LAST_S`` the front spot is at x 35, y -27.5 mm; each second before, 3 mm to the left."""
    knowledge = Knowledge()
    knowledge.set_documents(SelfCheckDocument.checked(CHECK), TargetsDocument.checked(TARGETS))
    for second in range(60):
        back = second - 59
        place = {"x_mm": 35.0123 + 3 * back, "y_mm": -27.5}
        lost = 20 <= second < 30
        document = (
            invalid("rear_spot_missing") if lost else measurement(x_mm=35.0123 + 0.1 * back, front=place)
        )
        hear(knowledge, document, 1000.0 + second)
    state = status(SPOT_MISSING, DUSTY, signal="out_of_specification")
    knowledge.set_status(StatusDocument.checked(state), LAST_S)
    return knowledge


def screen(
    knowledge: Knowledge,
    now_s: float,
    rows: int = 24,
    columns: int = 80,
    *,
    utf8: bool = False,
    page: int = 0,
) -> str:
    canvas = Canvas(rows, columns, is_utf8=utf8)
    draw(knowledge, now_s, View(page), canvas)
    return canvas.text()
