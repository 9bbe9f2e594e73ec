"""Operating hours of a unit over its life, in a file of the service's folder."""

from __future__ import annotations

import logging
import math
import os
from contextlib import suppress
from pathlib import Path

from altd.errors import BadInputError
from altd.files.documents import checksummed, parse_checksummed
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.runtime.threads import DeviceThread
from altd.status.health import Component, State
from altd.status.proof import unit_number

log = logging.getLogger("altd")

_FORMAT = "altd-operating-time/1"
SAVE_INTERVAL_S = 60.0
"""Interval of writes: the most that a power cut loses."""
_MAX_BYTES = 1 << 12
_DISK_TIMEOUT_S = 2.0


def file_in(folder: Path, serial: str) -> Path:
    """Return the file of the unit with this serial number; a backup has it by the end of its name."""
    return folder / f"operating-time-{unit_number(serial):08X}.json"


def read_seconds(path: Path) -> float:
    """Return the operating time in a file, 0.0 if its folder has none; raises BadInputError."""
    if path.parent.is_dir() and not os.path.lexists(path):
        return 0.0
    try:
        seconds = parse_checksummed(read_file(path, _MAX_BYTES), _FORMAT).get("seconds")
        if not isinstance(seconds, float) or not 0.0 <= seconds < math.inf:
            raise ValueError("seconds: must be a number from 0.0")
        return seconds
    except ValueError as error:
        raise BadInputError(path, str(error)) from error


def has_more(path: Path, than: Path) -> bool:
    """Return whether a file has at least the operating time of another; False if one cannot be read."""
    with suppress(BadInputError):
        return read_seconds(path) >= read_seconds(than)
    return False


def write_seconds(path: Path, seconds: float) -> None:
    """Write the operating time, unless the file has more; raises BadInputError."""
    write_file(path, checksummed({"format": _FORMAT, "seconds": max(round(seconds, 1), read_seconds(path))}))


class OperatingTime:
    """Counts the time for which a unit's daemon runs, by the monotonic clock, on top of that in its file.

    A file that cannot be read is left as it is, and the count is not known. One that cannot be written costs
    the time since the last write when the daemon ends. ``component`` reports both.
    """

    def __init__(self, path: Path, component: Component) -> None:
        self._path, self.component, self._clock = path, component, component.clock
        self._started_ns = self._clock.monotonic_ns()
        self._before_s: float | None = None

    def hours(self) -> float | None:
        """Return the operating hours up to now; None: not known."""
        return None if self._before_s is None else (self._before_s + self._running_s) / 3600.0

    @property
    def _running_s(self) -> float:
        return (self._clock.monotonic_ns() - self._started_ns) * 1e-9

    async def run(self) -> None:
        """Read the file, then write it at intervals until cancelled, and at the end."""
        thread = DeviceThread("operating time")
        try:
            while True:
                await self._keep(thread)
                await self._clock.sleep(SAVE_INTERVAL_S)
        finally:
            await thread.end(self._last, _DISK_TIMEOUT_S)

    async def _keep(self, thread: DeviceThread) -> None:
        try:
            if self._before_s is None:
                self._before_s = await thread.call(read_seconds, self._path, within_s=_DISK_TIMEOUT_S)
            now_s = self._before_s + self._running_s
            await thread.call(write_seconds, self._path, now_s, within_s=_DISK_TIMEOUT_S)
        except (BadInputError, TimeoutError) as error:
            why = str(error) or f"the disk does not answer within {_DISK_TIMEOUT_S:g} s"
            sentence = f"{'not known' if self._before_s is None else 'not kept'}: {why}"
            if self.component.message != sentence:
                log.warning("operating time: %s", sentence)
            self.component.set_state(State.DEGRADED, sentence)
        else:
            self.component.set_state(State.OK)

    def _last(self) -> None:
        if self._before_s is not None:
            try:
                write_seconds(self._path, self._before_s + self._running_s)
            except BadInputError as error:
                log.warning("operating time: not kept: %s", error)
