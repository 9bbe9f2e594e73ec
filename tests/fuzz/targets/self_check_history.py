"""Files that might be a history of self-checks, with a checksum that fits to reach what is behind it."""

import json
import math
from functools import cache
from typing import Any

import numpy as np
from fuzz.folder import folder, one_line
from fuzz.spoil import spoilt_and_sealed
from support import evidence

from altd.acquisition.self_check.memory import HistoryFile
from altd.errors import BadInputError
from altd.selfcheck.history import DAY_S, CheckHistory
from altd.selfcheck.records import SelfCheck, Similarity, TargetDrift, Verdict

NAME = "self_check_history"
NOW_S = 1.8e9


def _with_a_check(history: CheckHistory, time_s: float, shift_px: float) -> CheckHistory:
    moved = Similarity((376.0, 240.0), (shift_px, 0.0), 0.0, 0.0, np.diag([1e-5, 1e-5, 1e-6, 1.0]), 330.0)
    drift = TargetDrift("front", 6, 6, (), similarity=moved, rms_px=0.0)
    return history.with_check(SelfCheck(Verdict.GOOD, {"front": drift}, {}), time_s)


@cache
def _valid() -> dict[str, Any]:
    path, history = folder(NAME) / "valid.json", CheckHistory.empty()
    for day in range(12):
        history = _with_a_check(history, NOW_S + (day - 12) * DAY_S, 0.02 * day)
    HistoryFile(path, evidence.calibration()).save(history)
    document: dict[str, Any] = json.loads(path.read_bytes())
    del document["checksum"]
    return document


EXAMPLES = spoilt_and_sealed(_valid)


def check(example: bytes) -> None:
    """A history that is taken takes further days, tells drifts in finite numbers and can be kept again."""
    path = folder(NAME) / "kept.json"
    path.write_bytes(example)
    file = HistoryFile(path, evidence.calibration())
    try:
        history = file.load()
    except BadInputError as error:
        one_line(error)
        return
    for day in range(3):
        for drift in history.slow_drifts:
            assert math.isfinite(drift.px_per_day)
            assert all(map(math.isfinite, (*drift.shift_px, drift.turn_deg, drift.scale_ppm)))
        history = _with_a_check(history, NOW_S + day * DAY_S, 0.0)
    file.save(history)
    file.load()
