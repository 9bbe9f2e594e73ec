"""What happens to the cameras in the tunnel, done to them here: how soon it is said, how soon it is over."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.live.watch import Watch

_SAID_WITHIN_S = 5.0
_BACK_WITHIN_S = 30.0


@dataclass(frozen=True, slots=True)
class Recovery:
    """One fault. Times are those of a reader of the stream.

    ``invalid_after_s`` counts from the fault, ``valid_after_s`` from the camera's return; the slowest answer
    of Modbus is that of the whole time between fault and recovery.
    """

    fault: str
    reasons: tuple[str, ...]
    invalid_after_s: float
    health: str
    valid_after_s: float
    modbus_slowest_ms: float
    modbus_said_invalid: bool


def measure_fault(
    watch: Watch,
    fault: str,
    camera: str,
    strike: Callable[[], object],
    mend: Callable[[], float],
    lasts_s: float,
) -> Recovery:
    """Strike, wait, mend, and see it through; ``mend`` returns when the camera was back, monotonic s."""
    watch.first(lambda seen: seen.valid, time.monotonic(), _BACK_WITHIN_S)
    struck_s = time.monotonic()
    strike()
    invalid = watch.first(lambda seen: not seen.valid, struck_s, _SAID_WITHIN_S)
    time.sleep(max(lasts_s - (time.monotonic() - struck_s), 0.0))
    health = watch.status()["components"][f"camera {camera}"]
    back_s = mend()
    valid = watch.first(lambda seen: seen.valid, max(back_s, invalid.arrived_s), _BACK_WITHIN_S)
    polled = watch.polled
    answers = [
        (took_s, status)
        for asked_s, took_s, status in zip(polled.asked_s, polled.took_s, polled.status, strict=False)
        if struck_s <= asked_s <= valid.arrived_s
    ]
    return Recovery(
        fault=fault,
        reasons=tuple(sorted(invalid.reasons)),
        invalid_after_s=invalid.arrived_s - struck_s,
        health=f"{health['state']}: {health['message']}",
        valid_after_s=valid.arrived_s - back_s,
        modbus_slowest_ms=1e3 * max(took_s for took_s, _ in answers),
        modbus_said_invalid=any(not status & 1 for _, status in answers),
    )
