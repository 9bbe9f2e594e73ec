"""Check of a broker's message: a batch that verifies, or the reason of its refusal."""

from __future__ import annotations

from enum import StrEnum
from urllib.parse import quote, unquote

from pydantic import ValidationError

from altd.status.outbox import Batch
from altd.status.proof import is_sealed

MAX_BYTES = 64 << 10
"""Maximum size of a message; the broker does not deliver larger ones."""

RATE_HZ, BURST = 20.0, 200.0
"""Maximum rate and burst of a unit's messages in one instance; a unit that catches up sends 10 a second."""

SECONDS_RATE_HZ, SECONDS_BURST = 2.0, 31 * 86_400.0
"""The same for its seconds: it measures 1 a second, and catches up with at most 31 days.

A hostile unit can store twice the seconds of another one, and these days again at each start of an instance.
"""

DATABASE_RATE_HZ, DATABASE_BURST = 1 / 60.0, 3.0
"""Maximum rate and burst of a unit's batches that the database refuses; above it, its messages are not read.

Each of them costs the other units some transactions more.
"""

MAX_UNITS = 100_000


class RefusalReason(StrEnum):
    """Reason why a message is refused."""

    RATE = "rate"
    CRC = "crc"
    SCHEMA = "schema"
    UNIT = "unit"
    DATABASE = "database"


class _Limit:
    """Token bucket of each unit."""

    def __init__(self, rate_hz: float, burst: float) -> None:
        self._rate_hz = rate_hz
        self._burst = burst
        self._tokens: dict[str, tuple[float, float]] = {}

    def left(self, unit: str, now_s: float) -> float:
        """Return the tokens that the unit has now."""
        tokens, then_s = self._tokens.get(unit, (self._burst, now_s))
        return min(tokens + (now_s - then_s) * self._rate_hz, self._burst)

    def admits(self, unit: str, number: int, now_s: float) -> bool:
        """Take a number of tokens, if the unit has as many."""
        if len(self._tokens) > MAX_UNITS:
            self._tokens.clear()
        tokens = self.left(unit, now_s)
        is_admitted = tokens >= number
        self._tokens[unit] = tokens - is_admitted * number, now_s
        return is_admitted


class Intake:
    """Checks the messages of all units; a unit that floods is refused before its messages are parsed."""

    def __init__(self, topic: str) -> None:
        self._levels = topic.split("/")
        self._messages = _Limit(RATE_HZ, BURST)
        self._seconds = _Limit(SECONDS_RATE_HZ, SECONDS_BURST)
        self._database = _Limit(DATABASE_RATE_HZ, DATABASE_BURST)

    def unit_of(self, topic: str) -> str:
        """Serial number in a topic; empty: it is not the topic of a unit's outbox."""
        levels = topic.split("/")
        if levels[:-2] != self._levels or levels[-1] != "outbox":
            return ""
        unit = unquote(levels[-2])
        is_canonical = quote(unit, safe="") == levels[-2]  # an access list compares the written names
        return unit if unit.isprintable() and is_canonical else ""

    def check(self, topic: str, payload: bytes, now_s: float) -> Batch | RefusalReason:
        """Return the batch of a message, or the reason of its refusal; ``now_s`` is monotonic."""
        unit = self.unit_of(topic)
        if not self._messages.admits(unit, 1, now_s):
            return RefusalReason.RATE
        if self.is_held(unit, now_s):
            return RefusalReason.DATABASE
        if not is_sealed(payload):
            return RefusalReason.CRC
        try:
            batch = Batch.model_validate_json(payload)
        except ValidationError:
            return RefusalReason.SCHEMA
        if batch.serial != unit:
            return RefusalReason.UNIT
        return batch if self._seconds.admits(unit, max(len(batch.rows), 1), now_s) else RefusalReason.RATE

    def note_database_refusal(self, unit: str, now_s: float) -> None:
        """Count a batch of the unit that the database refused."""
        self._database.admits(unit, 1, now_s)

    def is_held(self, unit: str, now_s: float) -> bool:
        """Whether the database refused so many batches of the unit that its messages are not read now."""
        return self._database.left(unit, now_s) < 1
