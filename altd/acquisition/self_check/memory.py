"""History of the checks, kept in a file so that a unit that restarts every day can detect a slow drift."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TypeVar

from altd.errors import BadInputError
from altd.files.documents import checksum_of, checksummed, parse_checksummed
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.measuring.calibration import Calibration
from altd.ports import Clock
from altd.records import counted
from altd.runtime.threads import DeviceThread
from altd.selfcheck.history import CheckHistory, document_of, history_of
from altd.selfcheck.records import SelfCheck, Verdict
from altd.status.health import Component, State

log = logging.getLogger("altd")

Result = TypeVar("Result")

FORMAT = "altd-self-check-history/1"
SAVE_INTERVAL_S = 300.0
"""Minimum time between two writes: a unit may check itself every 10 s, and writing wears a memory card."""

_MAX_BYTES = 1 << 20
_DISK_TIMEOUT_S = 2.0
"""Maximum time for which the first verdict and the end of the daemon wait for the disk."""
_NO_ANSWER = f"the disk does not answer within {_DISK_TIMEOUT_S:g} s"
_MAX_CLOCK_ERROR = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class HistoryFile:
    """History file of one unit at ``path``; a history is valid for one calibration only."""

    path: Path
    calibration: Calibration

    def load(self) -> CheckHistory:
        """Read the file; return an empty history if it is missing or belongs to another calibration.

        Raises BadInputError.
        """
        if not os.path.lexists(self.path):
            return CheckHistory.empty()
        try:
            document = parse_checksummed(read_file(self.path, _MAX_BYTES), FORMAT)
            del document["format"]
            if document.pop("references", None) != _references_of(self.calibration):
                return CheckHistory.empty()
            return history_of(document, self.calibration.target_names)
        except ValueError as error:
            raise BadInputError(self.path, str(error)) from error

    def save(self, history: CheckHistory) -> None:
        """Write the file completely or not at all; raises BadInputError."""
        references = _references_of(self.calibration)
        write_file(
            self.path, checksummed({"format": FORMAT, "references": references, **document_of(history)})
        )


def _references_of(calibration: Calibration) -> str:
    """Return the checksum of the checks' reference: the calibration's identity and its LED positions."""
    return checksum_of(
        {
            "serial": calibration.unit_serial,
            "created": calibration.created.isoformat(),
            "recording": calibration.recording_sha256,
            "leds_px": {target.name: target.leds_px.tolist() for target in calibration.targets},
        }
    )


class CheckMemory:
    """One daemon's history of its checks. A separate thread waits for the disk."""

    def __init__(self, calibration: Calibration, clock: Clock) -> None:
        self._calibration = calibration
        self._clock = clock
        created = calibration.created
        self._earliest = (created if created.tzinfo else created.replace(tzinfo=UTC)) - _MAX_CLOCK_ERROR
        self._history = CheckHistory.empty()
        self._kept: _Kept | None = None
        self._is_loaded = True
        self._saved_ns: int | None = None
        self._saved_was_bad = False

    def keep_in(self, path: Path, component: Component) -> None:
        """Keep the history in a file from the first check on; ``component`` reports its state."""
        self._kept, self._is_loaded = _Kept(HistoryFile(path, self._calibration), component), False

    async def add(self, check: SelfCheck, time: datetime | None) -> None:
        """Add a check that ended at ``time``; a check without a verdict is ignored.

        If the time is unknown or before the calibration, only the verdict counts and not the drift: the clock
        was not set then.
        """
        if check.verdict is Verdict.UNKNOWN:
            return
        if not self._is_loaded and not await self._load():
            return
        self._history = self._history.with_verdict(check.verdict)
        if time is None or time < self._earliest:
            return
        time_s = time.timestamp()
        if self._history.is_ahead_of(time_s):
            log.warning("self-check history: contains days in the future; they count as the most recent ones")
            self._history = self._history.dated_back(time_s)
        self._history = self._history.with_check(check, time_s)

    async def was_bad(self) -> bool:
        """Whether the last known check with a verdict was bad, before this start or since."""
        if not self._is_loaded:
            await self._load()
        return self._history.was_bad

    @property
    def slow_drift(self) -> str:
        """Slow drift found from all checks together, as text; empty: none."""
        return "; ".join(
            f"{drift.target} drifts by {drift.px_per_day:.3f} px a day, "
            f"{drift.shift_px[0]:+.2f} {drift.shift_px[1]:+.2f} px so far"
            for drift in self._history.slow_drifts
        )

    async def save(self) -> None:
        """Write the history if due; a failed write is reported, and repeated at the next check.

        A change of the verdict to or from bad is written immediately.
        """
        kept, now_ns, was_bad = self._kept, self._clock.monotonic_ns(), self._history.was_bad
        if kept is None or not self._is_loaded:
            return
        if was_bad is self._saved_was_bad:
            if not self._history.targets:
                return
            if self._saved_ns is not None and now_ns - self._saved_ns < SAVE_INTERVAL_S * 1e9:
                return
        if await kept.save(self._history):
            self._saved_ns, self._saved_was_bad = now_ns, was_bad

    async def end(self) -> None:
        """Write the history if due: the end may have come before that; then end the thread."""
        if self._kept is not None:
            await self.save()
            await self._kept.end()

    async def _load(self) -> bool:
        """Load the history once; return False if the disk hangs: the next check tries again."""
        assert self._kept is not None  # noqa: S101  without a file there is nothing to load
        history = await self._kept.load()
        if history is None:
            return False
        self._history, self._is_loaded, self._saved_was_bad = history, True, history.was_bad
        return True


class _Kept:
    """File of a history, accessed with a timeout for the disk."""

    def __init__(self, file: HistoryFile, component: Component) -> None:
        self._file = file
        self._component = component
        self._thread: DeviceThread | None = None
        component.set_state(State.OK, "no check yet")

    async def load(self) -> CheckHistory | None:
        """Return the contents of the file, empty if it is unusable; None: the disk does not respond."""
        try:
            return await self._on_disk(self._file.load)
        except BadInputError as error:
            self._report_fault(f"starts again: {error}")
            return CheckHistory.empty()
        except TimeoutError:
            self._report_fault(f"not read: {_NO_ANSWER}")
            return None

    async def save(self, history: CheckHistory) -> bool:
        """Write the history; return whether that succeeded."""
        try:
            await self._on_disk(partial(self._file.save, history))
        except BadInputError as error:
            self._report_fault(f"not kept: {error}")
            return False
        except TimeoutError:
            self._report_fault(f"not kept: {_NO_ANSWER}")
            return False
        days = max(1 + len(target.days) for target in history.targets.values()) if history.targets else 0
        self._component.set_state(State.OK, f"{counted(days, 'day')} in {self._file.path}")
        return True

    async def end(self) -> None:
        """Wait for a write in progress, and end the thread."""
        if self._thread is not None:
            await self._thread.end(lambda: None, _DISK_TIMEOUT_S)

    async def _on_disk(self, call: Callable[[], Result]) -> Result:
        if self._thread is None:
            self._thread = DeviceThread("self-check history")
        return await self._thread.call(call, within_s=_DISK_TIMEOUT_S)

    def _report_fault(self, sentence: str) -> None:
        if (self._component.state, self._component.message) != (State.DEGRADED, sentence):
            log.warning("self-check history: %s", sentence)
        self._component.set_state(State.DEGRADED, sentence)
