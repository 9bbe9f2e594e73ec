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

MAX_UNITS = 100_000


class Refusal(StrEnum):
    """Reason why a message is refused."""

    RATE = "rate"
    CRC = "crc"
    SCHEMA = "schema"
    UNIT = "unit"
    DATABASE = "database"


class Intake:
    """Checks the messages of all units; a unit that floods is refused before its messages are parsed."""

    def __init__(self, topic: str) -> None:
        self._levels = topic.split("/")
        self._tokens: dict[str, tuple[float, float]] = {}

    def unit_of(self, topic: str) -> str:
        """Serial number in a topic; empty: it is not the topic of a unit's outbox."""
        levels = topic.split("/")
        if levels[:-2] != self._levels or levels[-1] != "outbox":
            return ""
        unit = unquote(levels[-2])
        is_canonical = quote(unit, safe="") == levels[-2]  # an access list compares the written names
        return unit if unit.isprintable() and is_canonical else ""

    def check(self, topic: str, payload: bytes, now_s: float) -> Batch | Refusal:
        """Return the batch of a message, or the reason of its refusal; ``now_s`` is monotonic."""
        unit = self.unit_of(topic)
        if not self._has_token(unit, now_s):
            return Refusal.RATE
        if not is_sealed(payload):
            return Refusal.CRC
        try:
            batch = Batch.model_validate_json(payload)
        except ValidationError:
            return Refusal.SCHEMA
        return batch if batch.serial == unit else Refusal.UNIT

    def _has_token(self, unit: str, now_s: float) -> bool:
        if len(self._tokens) > MAX_UNITS:
            self._tokens.clear()
        tokens, then_s = self._tokens.get(unit, (BURST, now_s))
        tokens = min(tokens + (now_s - then_s) * RATE_HZ, BURST)
        has_token = tokens >= 1
        self._tokens[unit] = tokens - has_token, now_s
        return has_token
