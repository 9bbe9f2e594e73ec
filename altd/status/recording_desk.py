"""Where an interface reads which recordings the unit has kept, and asks for one of the last seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


class NotKeptError(Exception):
    """What was asked for cannot be done; the sentence says why."""


class NoExposureError(NotKeptError):
    """There is nothing to keep: the cameras delivered nothing, which they say themselves."""


@dataclass(frozen=True, slots=True)
class KeptRecording:
    """A recording on the unit's disk. ``start`` is UTC, ISO 8601; empty where it is not known.

    ``why`` is the code of the cause, with the target or component that it is of, or who asked.
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
    """Who writes recordings; each call raises NotKeptError."""

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """What there is, the newest first."""

    async def keep(self, why: str) -> KeptRecording:
        """Write the last seconds."""

    async def mark(self, name: str, is_marked: bool) -> KeptRecording:
        """A marked recording is never removed to make room."""

    async def files(self, name: str) -> Sequence[str]:
        """The files of a recording, by their paths in it, ``recording.json`` the last."""

    async def content(self, name: str, file: str) -> bytes | None:
        """One of them; None: it is gone."""


class RecordingDesk:
    """``unavailable`` says why nothing is kept; empty once there is a keeper."""

    def __init__(self) -> None:
        self.unavailable = "this unit keeps no frames"
        self._keeper: RecordingKeeper | None = None

    def open(self, keeper: RecordingKeeper) -> None:
        """From now on recordings can be asked for."""
        self.unavailable, self._keeper = "", keeper

    @property
    def recordings(self) -> Sequence[KeptRecording]:
        """What there is, the newest first."""
        return () if self._keeper is None else self._keeper.recordings

    @property
    def keeper(self) -> RecordingKeeper:
        """Who writes them; raises NotKeptError when there is nobody."""
        if self._keeper is None:
            raise NotKeptError(self.unavailable)
        return self._keeper
