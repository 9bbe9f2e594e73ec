"""Faults of the cameras as in the tunnel: the time to their detection and to the recovery."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.live.watch import Watch

_DETECTION_TIMEOUT_S = 5.0
_RECOVERY_TIMEOUT_S = 30.0


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
    inject: Callable[[], object],
    restore: Callable[[], float],
    lasts_s: float,
) -> Recovery:
    """Inject a fault, restore, wait for recovery; ``restore`` returns the time of its return, s."""
    watch.first(lambda seen: seen.valid, time.monotonic(), _RECOVERY_TIMEOUT_S)
    injected_s = time.monotonic()
    inject()
    invalid = watch.first(lambda seen: not seen.valid, injected_s, _DETECTION_TIMEOUT_S)
    time.sleep(max(lasts_s - (time.monotonic() - injected_s), 0.0))
    health = watch.status()["components"][f"camera {camera}"]
    restored_s = restore()
    valid = watch.first(lambda seen: seen.valid, max(restored_s, invalid.arrived_s), _RECOVERY_TIMEOUT_S)
    polled = watch.polled
    answers = [
        (took_s, status)
        for asked_s, took_s, status in zip(polled.asked_s, polled.took_s, polled.status, strict=False)
        if injected_s <= asked_s <= valid.arrived_s
    ]
    return Recovery(
        fault=fault,
        reasons=tuple(sorted(invalid.reasons)),
        invalid_after_s=invalid.arrived_s - injected_s,
        health=f"{health['state']}: {health['message']}",
        valid_after_s=valid.arrived_s - restored_s,
        modbus_slowest_ms=1e3 * max(took_s for took_s, _ in answers),
        modbus_said_invalid=any(not status & 1 for _, status in answers),
    )
