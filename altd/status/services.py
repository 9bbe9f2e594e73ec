"""Requests of an interface beside the measurement: calibration, pictures, recordings, checks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from altd.status.event_log import EventKind, EventLog

Provider = TypeVar("Provider")


class _Service(Generic[Provider]):
    """``unavailable`` says why it is not available; empty from ``open`` on."""

    error: ClassVar[type[Exception]]

    def __init__(self, unavailable: str) -> None:
        self.unavailable = unavailable
        self._provider: Provider | None = None

    def open(self, provider: Provider) -> None:
        """From now on it can be asked for."""
        self.unavailable, self._provider = "", provider

    @property
    def provider(self) -> Provider:
        """Its provider; raises ``error`` where there is none."""
        if self._provider is None:
            raise self.error(self.unavailable)
        return self._provider


class NoCalibrationFileError(Exception):
    """The file cannot be given, or is not the one that belongs to this unit; the sentence says why."""


class NoReportError(Exception):
    """There is no report on the loaded calibration; the sentence says why."""


class CalibrationFiles(Protocol):
    """Reader of the files of a calibration."""

    @property
    def name(self) -> str:
        """The calibration file's name."""

    async def calibration(self) -> bytes:
        """The file as it was loaded; raises NoCalibrationFileError."""

    async def check_report(self) -> None:
        """Raise NoReportError where there is no report on the loaded calibration."""

    async def report(self) -> bytes:
        """The report, a page of HTML; raises NoReportError."""


class CalibrationService:
    """``summary``, of plain JSON types, is empty and ``files`` None until the calibration is there."""

    def __init__(self) -> None:
        self.summary: Mapping[str, Any] = {}
        self.files: CalibrationFiles | None = None

    def open(self, summary: Mapping[str, Any], files: CalibrationFiles) -> None:
        """From now on there is a calibration."""
        self.summary, self.files = summary, files


Points = tuple[tuple[float, float], ...]
"""u, v in px of the frame."""


class NoPictureError(Exception):
    """There is no picture; the sentence says why."""


@dataclass(frozen=True, slots=True)
class TargetView:
    """The constant part of a target's pictures: the frame's size, px, and what its calibration knows.

    ``outline`` bounds the area in which a spot is measured, ``leds`` are the frame LEDs' references.
    ``middle`` is the place x = y = 0 of the unit frame, ``x_axis`` and ``y_axis`` how far one millimetre
    along x and y goes there, u and v in px.
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
        """As plain JSON types."""
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
    """One frame as JPEG, with what was found in this very frame. ``t_ns`` is the middle of its exposure.

    ``width`` and ``height`` are the JPEG's own, px; ``spot`` is None where none was found, ``why`` says why
    not; ``number`` grows from picture to picture of a camera.
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
        """The targets, in beam order."""

    async def newer(self, seen: dict[str, int]) -> Sequence[Picture]:
        """The newest picture of each target that is newer than the number that was ``seen`` of it.

        Waits until there is one. Raises NoPictureError when it cannot be made.
        """


class PictureService(_Service[PictureMaker]):
    """The newest picture of each target, for people to look at."""

    error = NoPictureError


class NotKeptError(Exception):
    """A request that cannot be met; the sentence says why."""


class NoExposureError(NotKeptError):
    """There is nothing to keep: the cameras delivered nothing, which they say themselves."""


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording on the unit's disk. ``start`` is UTC, ISO 8601; empty where it is not known.

    ``why`` is the code of the cause, with the target or component that it is of, or the user that asked.
    """

    name: str
    why: str
    start: str
    seconds: float
    exposures: int
    bytes: int
    is_marked: bool

    def as_object(self) -> dict[str, object]:
        """As plain JSON types."""
        return {
            "name": self.name,
            "why": self.why,
            "start": self.start or None,
            "seconds": round(self.seconds, 3),
            "exposures": self.exposures,
            "bytes": self.bytes,
            "marked": self.is_marked,
        }


class RecordingKeeper(Protocol):
    """Writer of recordings; each call raises NotKeptError."""

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """The recordings, the newest first."""

    async def keep(self, why: str) -> KeptRecording:
        """Write the last seconds."""

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """A marked recording is never removed to make room."""

    async def files(self, name: str) -> Sequence[str]:
        """The files of a recording, by their paths in it, ``recording.json`` the last."""

    async def content(self, name: str, file: str) -> bytes | None:
        """One of them; None: it is gone."""


class RecordingService(_Service[RecordingKeeper]):
    """The recordings that the unit has kept, and one of the last seconds on request."""

    error = NotKeptError

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """The recordings, the newest first."""
        return () if self._provider is None else self._provider.recordings


class NoSelfCheckError(Exception):
    """The unit cannot check itself; the sentence says why."""


@dataclass(frozen=True, slots=True)
class SelfCheckReport:
    """The report of one check: its number since the start, a sentence for people, and plain JSON types."""

    number: int
    sentence: str
    document: Mapping[str, object]


class SelfCheckService:
    """``unavailable`` says why there is no self-check; empty once there is one.

    Requests go to it and are noted in ``events``.
    """

    def __init__(self, events: EventLog) -> None:
        self.unavailable = "this unit has no frame LEDs that the daemon switches"
        self.latest: SelfCheckReport | None = None
        self.ended_ns: int | None = None
        """When it was published."""
        self.waiting = 0
        """The clients that wait for a report."""
        self._begun = 0
        self._events = events
        self._on_request: Callable[[], None] = lambda: None
        self._changed = asyncio.Event()

    def open(self, on_request: Callable[[], None]) -> None:
        """From now on checks can be asked for."""
        self.unavailable, self._on_request = "", on_request

    def begin(self) -> int:
        """A check begins; returns its number."""
        self._begun += 1
        return self._begun

    def publish(self, report: SelfCheckReport) -> None:
        """A check has ended."""
        self.latest, self.ended_ns = report, self._events.clock.monotonic_ns()
        self._changed.set()
        self._changed = asyncio.Event()

    def ask(self, by: str = "") -> int:
        """Ask for a check, which comes within seconds; returns its number. Raises NoSelfCheckError.

        ``by`` is who asks, for the events.
        """
        if self.unavailable:
            raise NoSelfCheckError(self.unavailable)
        self._events.note(EventKind.REQUEST, "a self-check was asked for", by)
        self._on_request()
        return self._begun + 1

    async def report(self, number: int) -> SelfCheckReport:
        """The report of check ``number``, or of one after it, once it has ended."""
        self.waiting += 1
        try:
            while self.latest is None or self.latest.number < number:
                await self._changed.wait()
            return self.latest
        finally:
            self.waiting -= 1
