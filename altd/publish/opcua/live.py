"""Converts the daemon's lines to values with their freshness, time and status."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Set
from datetime import UTC, datetime, timedelta
from typing import Any

from altd.publish.opcua.nodes import OF_PLACE, UnitNodes
from altd.publish.opcua.quality import Status, status_of, status_of_sensor
from altd.publish.opcua.start import Start
from altd.publish.opcua.types import OF_JOINT, VARIABLES
from altd.status.proof import crc32

LINK_TIMEOUT_S = 2.0
"""Time without a line until the unit's state is unknown; the daemon sends one at least every 0.5 s."""

_CLOCK_MS = 0xFFFF_FFFF
"""Modulus of ``clock_ms`` and of counters in registers (``altd.status.proof``)."""


class LiveUnit:
    """Receives lines and writes nodes. Its own clock determines what is stale, whatever the lines contain.

    A line contains its time of sending, by the monotonic clock that both processes share. A measurement is
    stale ``stale_after_s`` after it was first sent, however often it is repeated. So a line that waited in
    the pipe while this process was held up has its true age.
    """

    def __init__(
        self,
        nodes: UnitNodes,
        start: Start,
        monotonic_ns: Callable[[], int],
        utc: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._nodes = nodes
        self._start = start
        self._monotonic_ns = monotonic_ns
        self._utc = utc
        self._published = -1
        self._first_sent_ns = self._sent_ns = 0
        self._numbers_known = self._linked = False
        self.lines_refused = 0
        """Number of lines that are damaged or not from this run of the daemon."""

    async def take(self, line: bytes) -> None:
        """Process a measurement, or the unit's state."""
        document = self._document(line)
        if document is None:
            self.lines_refused += 1
            return
        self._sent_ns = self._start.started_ns + self._sent_ms(document["clock_ms"]) * 1_000_000
        if not self._is_within(self._sent_ns, LINK_TIMEOUT_S):
            return
        self._linked = True
        if "causes" in document:
            now = self._utc()
            await self._nodes.write("health", document["number"], Status.GOOD, now, now)
            causes = [cause["code"] for cause in document["causes"]]
            await self._nodes.write("causes", causes, Status.GOOD, now, now)
        elif "sequence" in document:
            await self._measurement(document)

    async def withdraw_stale(self) -> None:
        """Withdraw values that became stale; to be called several times a second, and before a read."""
        if self._numbers_known and not self._is_within(self._first_sent_ns, self._start.stale_after_s):
            self._numbers_known = False
            await self._take_back(self._nodes.keys - (VARIABLES.keys() | {"health"}) | {"valid"})
        if self._linked and not self._is_within(self._sent_ns, LINK_TIMEOUT_S):
            self._linked = False
            await self._take_back(self._nodes.keys)

    async def _measurement(self, document: Mapping[str, Any]) -> None:
        if document["published"] != self._published:
            self._published, self._first_sent_ns = document["published"], self._sent_ns
        is_fresh = self._is_within(self._first_sent_ns, self._start.stale_after_s)
        self._numbers_known = is_fresh
        text, now, write = document["time"], self._utc(), self._nodes.write
        source = None if text is None else datetime.fromisoformat(text)
        statuses = self._statuses(document)
        for quantity in self._start.quantities.of_unit:
            key, status, at = quantity.key, statuses[quantity.place], source
            if quantity.is_from_sensor or (quantity.is_optional and not quantity.place):
                said = document.get("sensors", {}).get(key)
                status = status_of_sensor(said, status) if is_fresh else status
                at = now - timedelta(
                    seconds=self._since_s(self._first_sent_ns) + ((said or {}).get("age_s") or 0)
                )
            await self._write_numbers(key, document, status, at, now)
        for key in OF_JOINT.keys() & self._nodes.keys:
            numbers = [math.nan if each is None else each for row in document[key] for each in row]
            known = numbers if any(map(math.isfinite, numbers)) else None
            await write(key, known, _known(known, statuses[""]), source, now)
        is_good = is_fresh and statuses[""] is not Status.UNCERTAIN_SIMULATED_VALUE
        of_valid = Status.GOOD if is_good else statuses[""]
        await write("valid", document["valid"], of_valid, source, now)
        for target, said in self._targets(document).items():
            place = f"targets.{target}"
            for quantity in self._start.quantities.of_target:
                await self._write_numbers(f"{place}.{quantity.key}", said, statuses[target], source, now)
            for key in OF_PLACE if self._start.quantities.has_places else ():
                await write(f"{place}.{key}", said[key], of_valid, source, now)
        await write("sequence", document["sequence"] % _CLOCK_MS, Status.GOOD, source, now)
        await write("frames", document["frames"], Status.GOOD, source, now)
        await write("status", document["status"], Status.GOOD, source, now)
        age_s = document["age_s"]
        age_ms = None if age_s is None else round(1000 * (age_s + self._since_s(self._sent_ns)))
        of_age = Status.BAD_WAITING_FOR_INITIAL_DATA if age_ms is None else Status.GOOD
        await write(
            "age_ms", None if age_ms is None else max(min(age_ms, 2**31 - 1), -(2**31)), of_age, now, now
        )

    def _targets(self, document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
        """The part of a measurement for each target."""
        is_row = self._start.quantities.has_places
        of = document["targets"] if is_row else document
        return {target: of.get(target, {"valid": False, "status": []}) for target in self._start.targets}

    def _statuses(self, document: Mapping[str, Any]) -> dict[str, Status]:
        """Status of the unit's numbers (empty key), and of the numbers of each target."""
        targets, is_row = self._targets(document), self._start.quantities.has_places
        if not self._numbers_known:
            return dict.fromkeys(("", *targets), Status.BAD_NO_COMMUNICATION)

        def status(of: Mapping[str, Any], place: str | None) -> Status:
            is_valid = document["valid"] and of.get("valid", not is_row)
            return status_of(is_valid, document["status"], targets, document["time"] is not None, place)

        of_unit = status(document, "" if is_row else None)
        return {"": of_unit} | {
            target: status(said, target) if is_row else of_unit for target, said in targets.items()
        }

    async def _write_numbers(
        self, key: str, said: Mapping[str, Any], status: Status, at: datetime | None, now: datetime
    ) -> None:
        """Write a quantity with its sigmas; ``said`` contains them under the last part of ``key``."""
        of = key.rpartition(".")[2]
        for node, value in (
            (key, said.get(of)),
            (f"{key}.sigma", said.get("sigma", {}).get(of)),
            (f"{key}.sigma_now", said.get("sigma_now", {}).get(of)),
        ):
            if node in self._nodes.keys:
                await self._nodes.write(node, value, _known(value, status), at, now)

    async def _take_back(self, keys: Set[str]) -> None:
        now = self._utc()
        for key in keys:
            await self._nodes.write(key, None, Status.BAD_NO_COMMUNICATION, now, now)

    def _document(self, line: bytes) -> dict[str, Any] | None:
        """Parse a line; None if it is damaged or not from this run of the daemon."""
        checked, _, crc = line.rstrip(b"\n").rpartition(b', "crc32": "')
        if crc != b'%08X"}' % crc32(checked):
            return None
        document: dict[str, Any] = json.loads(line)
        return document if document["session"] == self._start.session else None

    def _sent_ms(self, clock_ms: int) -> int:
        """Milliseconds from the start of the daemon until a line was sent; ``clock_ms`` wraps to 0."""
        running_ms = (self._monotonic_ns() - self._start.started_ns) // 1_000_000
        return running_ms - (running_ms - clock_ms) % _CLOCK_MS

    def _since_s(self, t_ns: int) -> float:
        return (self._monotonic_ns() - t_ns) * 1e-9

    def _is_within(self, t_ns: int, seconds: float) -> bool:
        return self._since_s(t_ns) <= seconds


def _known(value: object, status: Status) -> Status:
    """Status of a value; a missing value is Bad, even in a good measurement."""
    return Status.BAD if value is None and not status.is_bad else status
