"""Archive of diagnostics for a technician to send to an expert, made on request or by ``altd diagnose``.

Each part is limited in size and time. The archive lists unavailable parts and contains all others.
"""

from __future__ import annotations

import asyncio
import csv
import io
import json
import zipfile
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial

from starlette.requests import Request
from starlette.responses import Response

from altd.errors import one_line
from altd.history.history import History
from altd.history.reader import MAX_ROWS, Reader
from altd.history.records import SummaryPoint
from altd.history.schema import MINUTES
from altd.publish.http.guard import Guard
from altd.publish.http.metrics import Metrics
from altd.publish.http.past import Past, event_of
from altd.publish.http.recordings import Download, Downloads, head_of, saved_as, sent_whole
from altd.publish.http.stream import time_of
from altd.runtime.threads import SingleCall, call_in_thread
from altd.status.measurement_json import as_object_now
from altd.status.models import self_check_of, status_of, targets_of
from altd.status.unit import DiagnosticPart, PublishedUnit

ZIP = "application/zip"
MAX_PART_BYTES = 16_000_000
"""Maximum size of a part before compression; longer parts are cut, and the archive reports it."""

MAX_EVENT_PAGES = 4
"""Maximum number of pages of the newest events, ``MAX_ROWS`` events each."""

_PART_TIMEOUT_S = 20.0
_DAY_S = 86_400
_EVENT_DAYS = 31
_US = 10**6
_README = "README.txt"
_WITHOUT_LOG = "no picture, and no log: on the unit itself `journalctl -u altd` shows that"
JOURNAL = "journal.txt"
"""Part with the log of the service."""
_NO_TIME = datetime.fromtimestamp(0, UTC)
"""Time of an archive if the clock has no UTC."""
_FIRST_ZIP_TIME, _LAST_ZIP_TIME = (1980, 1, 1, 0, 0, 0), (2107, 12, 31, 23, 59, 58)
_SUMMARY_PARTS = {"": "mean", "sigma_": "sigma", "min_": "low", "max_": "high"}
"""Prefixes of the columns, as of ``altd export``, and the attributes of ``SummaryValue`` in them."""


@dataclass(frozen=True, slots=True)
class Part:
    """A file of the archive; ``make`` returns its content."""

    name: str
    meaning: str
    make: Callable[[], Awaitable[bytes]]


class Diagnostics:
    """Diagnostics of one unit, for clients that may see pictures."""

    def __init__(
        self, unit: PublishedUnit, past: Past, metrics: Metrics, guard: Guard, downloads: Downloads
    ) -> None:
        self._unit = unit
        self._past = past
        self._metrics = metrics
        self._guard = guard
        self._downloads = downloads
        self._further: dict[str, SingleCall] = {}
        """The threads of the further parts by name: one that hangs is not asked again and delays no other."""

    async def archive(self, request: Request) -> Response:
        """Return the zip archive."""
        self._guard.check_may_look(request)
        if request.method == "HEAD":
            return head_of(ZIP)

        async def made() -> Response:
            now = self._past.now() or _NO_TIME
            serial = self._unit.facts.serial
            content = await archive_of(self._parts(now), serial, now)
            return sent_whole(content, ZIP, saved_as(archive_name(serial, now)))

        return Download(self._downloads, made)

    def _parts(self, now: datetime) -> Iterator[Part]:
        unit = self._unit
        status = "state of each part of the unit"
        yield part_of("status.json", status, lambda: _json(status_of(unit.view()).as_object()))
        yield part_of("measurement.json", "the latest measurement", self._measurement)
        yield part_of("self-check.json", "the last self-check", self._self_check)
        targets = "the targets, and where each is measured"
        yield part_of("targets.json", targets, lambda: _json(targets_of(unit.targets).as_object()))
        calibration = "content of the calibration"
        yield part_of("calibration.json", calibration, self._calibration)
        yield part_of("metrics.txt", "all numbers as Prometheus gets them", self._metrics.text)
        yield from history_parts(self._past.history, now)
        for part in unit.diagnostics:
            yield further_part(part, self._further.setdefault(part.name, SingleCall("diagnostics")))

    def _measurement(self) -> bytes:
        view = self._unit.view()
        if view.measurement is None:
            raise LookupError("nothing was measured since the unit started")
        return _json(as_object_now(view.measurement, view.age_s))

    def _calibration(self) -> bytes:
        figures = self._unit.calibration
        return _json({} if figures is None else figures.as_object())

    def _self_check(self) -> bytes:
        view = self._unit.view()
        if view.self_check is None:
            raise LookupError(view.no_self_check or "there was no self-check since the unit started")
        return _json(self_check_of(view.self_check.check, view.self_check).as_object())


async def archive_of(parts: Iterable[Part], serial: str, now: datetime) -> bytes:
    """Return the archive of these parts of a unit; ``now`` is in UTC."""
    files: dict[str, bytes] = {}
    said: list[str] = []
    missing: list[str] = []
    for part in parts:
        try:
            async with asyncio.timeout(_PART_TIMEOUT_S):
                content = await part.make()
        except TimeoutError:
            missing.append(f"{part.name}: it took longer than {_PART_TIMEOUT_S:g} s")
        except Exception as error:  # any error while making a part costs this part only
            missing.append(one_line(f"{part.name}: {str(error) or type(error).__name__}"))
        else:
            files[part.name] = _cut(content)
            cut = f" (its first {MAX_PART_BYTES} bytes)" if len(content) > MAX_PART_BYTES else ""
            said.append(f"{part.name}: {part.meaning}{cut}")
    files = {_README: _readme(one_line(serial), now, said, missing), **files}
    return await call_in_thread(partial(_zipped, files, now), "diagnostics archive")


def archive_name(serial: str, now: datetime) -> str:
    """Return the name of the archive of a unit; ``now`` is in UTC."""
    return f"altd-{serial or 'unit'}-{now:%Y%m%dT%H%M%SZ}.zip"


def history_parts(history: History, now: datetime) -> Iterator[Part]:
    """Yield the parts with the events and the trend before ``now``."""
    end_us = round(now.timestamp()) * _US + _US
    events_from = end_us - _EVENT_DAYS * _DAY_S * _US
    yield Part(
        "events.jsonl",
        f"events of the last {_EVENT_DAYS} days, one per line, the newest first, at most "
        f"{MAX_EVENT_PAGES * MAX_ROWS}",
        lambda: history.ask(lambda reader: _events(reader, events_from, end_us)),
    )
    trend_from = end_us - _DAY_S * _US
    yield Part(
        "trend.csv",
        "the last day, a row a minute, its columns as `altd export` names them",
        lambda: history.ask(lambda reader: _trend(reader, trend_from, end_us)),
    )


def further_part(part: DiagnosticPart, calls: SingleCall) -> Part:
    """Return a part that is made in the thread of ``calls``."""
    return Part(part.name, part.meaning, partial(calls.call, part.make))


def part_of(name: str, meaning: str, make: Callable[[], bytes]) -> Part:
    """Return a part that is made at once, in the event loop."""

    async def made() -> bytes:
        return make()

    return Part(name, meaning, made)


def _json(document: Mapping[str, object]) -> bytes:
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


def _events(reader: Reader, from_us: int, to_us: int) -> bytes:
    """Return the newest events of this time as JSON lines, the newest first."""
    lines: list[str] = []
    before = None
    for _ in range(MAX_EVENT_PAGES):
        found = reader.events(from_us, to_us, limit=MAX_ROWS, before=before)
        lines += (json.dumps(event_of(event).as_object(), allow_nan=False) for event in found)
        if len(found) < MAX_ROWS:
            break
        before = found[-1].id
    return "".join(f"{line}\n" for line in lines).encode()


def _trend(reader: Reader, from_us: int, to_us: int) -> bytes:
    """Return the minutes of this time as CSV; unknown values are empty."""
    text = io.StringIO()
    keys = list(reader.summarised)
    table = csv.writer(text, lineterminator="\n")
    names = (prefix + key for key in keys for prefix in _SUMMARY_PARTS)
    table.writerow(["time", "n", "n_valid", "worst", "worst_cause", "lost_to", *names])
    table.writerows(_row(point, keys) for point in reader.summaries(MINUTES, from_us, to_us))
    return text.getvalue().encode()


def _row(point: SummaryPoint, keys: Iterable[str]) -> list[object]:
    values = [point.values.get(key) for key in keys]
    return [
        time_of(point.t_us),
        point.n,
        point.n_valid,
        point.worst,
        point.worst_code,
        point.lost_to,
        *(getattr(value, part, None) for value in values for part in _SUMMARY_PARTS.values()),
    ]


def _cut(content: bytes) -> bytes:
    """Return the content, cut at the last line end within ``MAX_PART_BYTES`` if it is longer."""
    if len(content) <= MAX_PART_BYTES:
        return content
    return content[: content.rfind(b"\n", 0, MAX_PART_BYTES) + 1]


def _readme(serial: str, now: datetime, said: Sequence[str], missing: Sequence[str]) -> bytes:
    has_log = any(line.startswith(f"{JOURNAL}: ") for line in said)
    without = "and no picture" if has_log else _WITHOUT_LOG
    if any(line.startswith("pictures/") for line in said):
        without = "and no log"
    lines = [
        f"Diagnostics of the unit {serial or 'of unknown serial number'}, made at "
        f"{now:%Y-%m-%dT%H:%M:%SZ} (UTC). They hold no password, token or key, {without}.",
        "",
        *said,
    ]
    if missing:
        lines += ["", "Not in it:", *missing]
    return ("\n".join(lines) + "\n").encode("utf-8", "backslashreplace")


def _zipped(files: Mapping[str, bytes], now: datetime) -> bytes:
    whole = io.BytesIO()
    made = min(max(now.timetuple()[:6], _FIRST_ZIP_TIME), _LAST_ZIP_TIME)
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, made)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return whole.getvalue()
