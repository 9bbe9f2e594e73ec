"""How it went: the newest events, and the means of some spans, in the words of a technician."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from altd.history.history import History, NoHistoryError
from altd.history.records import SummaryPoint
from altd.publish.serial.words import WIDTH, hanging
from altd.records import Quantities, Quantity
from altd.status.event_log import Event, EventLog

SHOWN_EVENTS = 12
ROWS = 12
SPANS_S = {"hour": 3600, "day": 86_400, "month": 30 * 86_400}
_TIMES = {"hour": "%H:%M:%S", "day": "%d, %H:%M", "month": "%m-%d, %H:%M"}


@dataclass(frozen=True, slots=True)
class Past:
    """What a daemon remembers; ``now`` is its time of day, None: not known."""

    events: EventLog
    history: History
    now: Callable[[], datetime | None]


def log_text(past: Past) -> str:
    """The newest events, the newest first."""
    events = past.events.after(0)[-SHOWN_EVENTS:]
    return "\n".join(map(_event_line, reversed(events))) or "nothing has happened so far"


async def history_text(past: Past, quantities: Quantities, span: str) -> str:
    """The means of the last hour, day or month in equal steps, the newest last; or why there are none."""
    now = past.now()
    if now is None:
        return "no history: the time of day is not known"
    to_us = int(now.timestamp() * 1e6)
    keys = [quantity.key for quantity in quantities.main]
    try:
        trend = await past.history.trend(max(to_us - SPANS_S[span] * 10**6, 0), to_us, ROWS, keys)
    except (NoHistoryError, ValueError) as error:
        return hanging("", f"no history: {error}", 2).strip()
    if not trend.points:
        return f"nothing was measured in the last {span}"
    head = "".join(f"{f'{quantity.label} {_unit(quantity)}':>10}" for quantity in quantities.main)
    rows = [_row(point, quantities, _TIMES[span]) for point in trend.points]
    return "\n".join([f"{'from (UTC)':<13}{'valid':>6}{head}", *rows])


def _row(point: SummaryPoint, quantities: Quantities, form: str) -> str:
    begun = datetime.fromtimestamp(point.t_us / 1e6, UTC).strftime(form)
    share = f"{100 * point.n_valid // point.n} %" if point.n else "-"
    numbers = ""
    for quantity in quantities.main:
        value = point.values.get(quantity.key)
        numbers += f"{'-':>10}" if value is None else f"{value.mean:10.{quantity.decimals - 1}f}"
    return f"{begun:<13}{share:>6}{numbers} {point.lost_to}"[:WIDTH].rstrip()


def _unit(quantity: Quantity) -> str:
    return quantity.unit.replace("°", "deg")


def _event_line(event: Event) -> str:
    of = f" {event.of}" if event.of else ""
    alike = f" ({event.held_back} alike before it)" if event.held_back else ""
    time = event.time.astimezone(UTC).strftime("%m-%d %H:%M:%S")
    return hanging(time, f"{event.kind}{of}: {event.text}{alike}", 15)
