"""Requests of an interface beside the measurement: calibration, pictures, recordings, checks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import ClassVar, Generic, Protocol, TypeVar

from altd.selfcheck.records import SelfCheck
from altd.status.answer import Answer
from altd.status.event_log import EventKind, EventLog

Provider = TypeVar("Provider")


class _Service(Generic[Provider]):
    """A service; ``unavailable`` gives the reason why it is not available, and is empty after ``open``."""

    error: ClassVar[type[Exception]]

    def __init__(self, unavailable: str) -> None:
        self.unavailable = unavailable
        self._provider: Provider | None = None

    def open(self, provider: Provider) -> None:
        """Make the service available."""
        self.unavailable, self._provider = "", provider

    @property
    def provider(self) -> Provider:
        """Provider of the service; raises ``error`` if there is none."""
        if self._provider is None:
            raise self.error(self.unavailable)
        return self._provider


class NoCalibrationFileError(Exception):
    """The file cannot be returned, or does not belong to this unit; the message gives the reason."""


class NoReportError(Exception):
    """There is no report on the loaded calibration; the message gives the reason."""


class CalibrationFiles(Protocol):
    """Reader of the files of a calibration."""

    @property
    def name(self) -> str:
        """Name of the calibration file."""

    async def calibration(self) -> bytes:
        """Return the file as it was loaded; raises NoCalibrationFileError."""

    async def check_report(self) -> None:
        """Raise NoReportError if there is no report on the loaded calibration."""

    async def report(self) -> bytes:
        """Return the report, an HTML page; raises NoReportError."""


Points = tuple[tuple[float, float], ...]
"""Points (u, v), px of the frame."""


class NoPictureError(Exception):
    """There is no picture; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class TargetView:
    """Constant part of a target's pictures: the frame's size, px, and data of the calibration.

    ``outline`` limits the area in which a spot is measured, ``leds`` are the frame LEDs' reference positions.
    ``middle`` is the position of x = y = 0 of the unit frame; ``x_axis`` and ``y_axis`` are the displacements
    there of one millimetre along x and y. All are u and v in px.
    """

    target: str
    camera: str
    width: int
    height: int
    outline: Points
    leds: Points
    middle: tuple[float, float]
    x_axis: tuple[float, float]
    y_axis: tuple[float, float]

    def as_object(self) -> dict[str, object]:
        """Return the view as plain JSON types."""
        return {
            "target": self.target,
            "width": self.width,
            "height": self.height,
            "outline": [list(point) for point in self.outline],
            "leds": [list(point) for point in self.leds],
            "middle": list(self.middle),
            "x_axis": list(self.x_axis),
            "y_axis": list(self.y_axis),
        }


@dataclass(frozen=True, slots=True)
class SpotContour:
    """A spot's 1/e² contour: an ellipse about (u_px, v_px), its major axis turned from u to v."""

    u_px: float
    v_px: float
    semi_major_px: float
    semi_minor_px: float
    turn_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One frame as JPEG, with the results of this very frame. ``t_ns`` is the middle of its exposure.

    ``width`` and ``height`` are those of the JPEG, px. ``spot`` is None if none was found, ``why`` gives the
    reason; ``number`` increases with each picture of a camera.
    """

    target: str
    number: int
    sequence: int
    t_ns: int
    width: int
    height: int
    spot: SpotContour | None
    why: str
    leds_on: bool
    jpeg: bytes


class PictureMaker(Protocol):
    """Maker of pictures."""

    @property
    def views(self) -> Sequence[TargetView]:
        """Targets in beam order."""

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        """Return the newest picture of each target whose number is larger than in ``seen``.

        Waits until there is one. Raises NoPictureError if it cannot be made.
        """


class PictureService(_Service[PictureMaker]):
    """The newest picture of each target, for people to look at."""

    error = NoPictureError


class NotKeptError(Exception):
    """The request cannot be met; the message gives the reason."""


class NoExposureError(NotKeptError):
    """There is nothing to keep: the cameras delivered nothing, which they report themselves."""


class KeptRecording(Answer):
    """Frames of the last seconds, kept on the unit."""

    name: str
    why: str
    """Code of the cause with its target or component, or the user that requested the recording."""
    start: str | None
    """Time of its first frame, UTC; null: not known."""
    seconds: float
    exposures: int
    bytes: int
    """Size on the unit's disk, bytes."""
    marked: bool
    """Whether the recording is kept when space is needed."""


class RecordingKeeper(Protocol):
    """Writer of recordings; each call raises NotKeptError."""

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """Recordings, the newest first."""

    async def keep(self, why: str) -> KeptRecording:
        """Write the last seconds."""

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """Mark or unmark a recording; a marked one is never removed to make room."""

    async def files(self, name: str) -> Sequence[str]:
        """Return the files of a recording as paths relative to it, ``recording.json`` last."""

    async def content(self, name: str, file: str) -> bytes | None:
        """Return the content of one file; None: it no longer exists."""


class RecordingService(_Service[RecordingKeeper]):
    """Recordings that the unit has kept, and recording of the last seconds on request."""

    error = NotKeptError

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """Recordings, the newest first."""
        return () if self._provider is None else self._provider.recordings


class NoSelfCheckError(Exception):
    """The unit cannot check itself; the message gives the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class SelfCheckReport:
    """Report of one check: its number since the start, its result, its cause, and when it ended.

    ``exposures_lost`` is the number of exposures that the measurement lost to it.
    """

    number: int
    check: SelfCheck
    cause: str
    time: datetime | None = None
    exposures_lost: int = 0
    ended_ns: int = 0
    """Time at which it was published."""


class SelfCheckService:
    """Self-checks; ``unavailable`` gives the reason why there are none, and is empty after ``open``.

    Requests are passed to the self-check and noted in ``events``.
    """

    def __init__(self, events: EventLog) -> None:
        self.unavailable = "this unit has no frame LEDs that the daemon switches"
        self.latest: SelfCheckReport | None = None
        self.waiting = 0
        """Number of clients that wait for a report."""
        self._begun = 0
        self._events = events
        self._on_request: Callable[[], None] = lambda: None
        self._changed = asyncio.Event()

    def open(self, on_request: Callable[[], None]) -> None:
        """Make self-checks available."""
        self.unavailable, self._on_request = "", on_request

    def begin(self) -> int:
        """Begin a check; returns its number."""
        self._begun += 1
        return self._begun

    def publish(self, report: SelfCheckReport) -> None:
        """Publish the report of a check that has ended."""
        self.latest = replace(report, ended_ns=self._events.clock.monotonic_ns())
        self._changed.set()
        self._changed = asyncio.Event()

    def ask(self, by: str = "") -> int:
        """Request a check, which begins within seconds; returns its number. Raises NoSelfCheckError.

        ``by`` is the requester, for the events.
        """
        if self.unavailable:
            raise NoSelfCheckError(self.unavailable)
        self._events.note(EventKind.REQUEST, "a self-check was asked for", by)
        self._on_request()
        return self._begun + 1

    async def report(self, number: int) -> SelfCheckReport:
        """Return the report of check ``number``, or of a later one, once it has ended."""
        self.waiting += 1
        try:
            while self.latest is None or self.latest.number < number:
                await self._changed.wait()
            return self.latest
        finally:
            self.waiting -= 1
