"""Self-checks whose history is kept in a real file, by one daemon after the other."""

import json
import math
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from altd.acquisition.self_check.memory import CheckMemory
from altd.measuring.calibration import Calibration
from altd.selfcheck.records import SelfCheck, Similarity, TargetDrift, Verdict
from altd.status.health import Component
from support import evidence
from support.clock import FakeClock

CALIBRATION = evidence.calibration()
FIRST = CALIBRATION.created + timedelta(hours=1)
NAME = "self-checks.json"
SIGMA_PX, RADIUS_PX = 0.003, 330.0


def check(shift_px: float, verdict: Verdict = Verdict.GOOD) -> SelfCheck:
    """Of both targets, each with that shift to the right."""
    to_px = np.array([1.0, 1.0, math.radians(RADIUS_PX), 1e-6 * RADIUS_PX])
    moved = Similarity((376.0, 240.0), (shift_px, 0.0), 0.0, 0.0, np.diag((SIGMA_PX / to_px) ** 2), RADIUS_PX)
    drift = {name: TargetDrift(name, 6, 6, (), similarity=moved, rms_px=0.0) for name in ("front", "rear")}
    return SelfCheck(verdict, drift, {})


class Unit:
    """The memory of one daemon after the other, in one folder."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self.clock = FakeClock()
        self.component = Component("self-check history", self.clock)

    async def run(
        self, *checks: tuple[float, datetime], calibration: Calibration = CALIBRATION, pause_s: float = 600.0
    ) -> str:
        """One daemon that makes these checks; what it says of a drift at its end."""
        memory = CheckMemory(calibration, self.clock)
        memory.keep_in(self.path, self.component)
        for shift_px, time in checks:
            await memory.add(check(shift_px), time)
            await memory.save()
            self.clock.now_ns += round(pause_s * 1e9)
        await memory.end()
        return memory.slow_drift

    async def told_after_days(self, px_a_day: float, days: int = 12) -> int | None:
        """Days of a drift until it is reported, with a start each day; None: never."""
        for day in range(days):
            if await self.run((px_a_day * day, FIRST + timedelta(days=day))):
                return day
        return None

    def days(self) -> int:
        """The number of days in the file."""
        kept = json.loads(self.path.read_bytes())["targets"]["front"]
        return 1 + len(kept["days"])
