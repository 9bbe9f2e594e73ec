"""What the cameras saw during a scan: the spots at its nodes, the frame LEDs, and print or none."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from altd.calibration.result import Progress
from altd.reasons import Reason
from altd.recording.reader import Recording
from altd.recording.table import Row
from altd.records import FloatArray, Frame, NoSpot, Spot
from altd.vision.flat import Flat
from altd.vision.leds import locate_leds
from altd.vision.localise import locate, shows_print
from altd.vision.settings import SpotSettings

_SAME_NODE_MM = 0.5
"""Exposures whose stage positions round to the same half millimetre belong to one node."""


@dataclass(slots=True)
class Node:
    """The exposures at one node: stage positions mm, spots and their sigmas px, and why others have none."""

    positions_mm: list[tuple[float, float]] = field(default_factory=list)
    spots_px: list[tuple[float, float]] = field(default_factory=list)
    sigmas_px: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    located: list[Row] = field(default_factory=list)
    """The rows that the spots come from."""

    @property
    def usable(self) -> bool:
        """Whether most of its exposures have a spot."""
        return len(self.spots_px) > len(self.complaints)

    @property
    def key(self) -> tuple[int, int]:
        """Which node it is."""
        return node_key(self.positions_mm[0])

    @property
    def position_mm(self) -> tuple[float, float]:
        """The mean of the stage's positions."""
        x_mm, y_mm = np.mean(self.positions_mm, axis=0).tolist()
        return x_mm, y_mm

    def refuse(self, why: str) -> None:
        """Take its exposures out of use."""
        self.spots_px.clear()
        self.sigmas_px.clear()
        self.located.clear()
        self.complaints.append(why)


@dataclass(slots=True)
class Seen:
    """What a target's camera saw during the scan."""

    nodes: dict[tuple[int, int], Node] = field(default_factory=dict)
    leds: list[FloatArray] = field(default_factory=list)
    leds_dropped: tuple[str, ...] = ()
    """The frame LEDs of the last pair that shine and could not be located, in words."""

    @property
    def usable(self) -> list[Node]:
        """The nodes that can be used."""
        return [node for node in self.nodes.values() if node.usable]

    @property
    def refused(self) -> list[Node]:
        """The nodes that cannot be used."""
        return [node for node in self.nodes.values() if not node.usable]

    @property
    def leds_px(self) -> FloatArray:
        """Mean LED positions (n, 2) over the reference pairs that show the usual number of LEDs."""
        if not self.leds:
            return np.empty((0, 2))
        usual = int(np.median([len(pair) for pair in self.leds]))
        same = [pair for pair in self.leds if len(pair) == usual]
        return np.mean(same, axis=0) if same and usual else np.empty((0, 2))


@dataclass(frozen=True, slots=True)
class Job:
    """One target of a scan and how its spots are localised."""

    recording: Recording
    name: str
    z_mm: float
    localiser: SpotSettings
    flat: Flat | None

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the target's pictures, px."""
        camera = self.recording.header.cameras[self.name]
        return camera.width, camera.height

    @property
    def rows(self) -> Iterator[Row]:
        """The target's frames."""
        return self.recording.rows.of(self.name)

    @property
    def frames(self) -> int:
        """How many they are."""
        return self.recording.rows.count.get(self.name, 0)


def look(job: Job, progress: Progress) -> Seen:
    """Localise the spots of all nodes and the LEDs of all reference pairs in one camera's frames."""
    seen = Seen()
    dark: Frame | None = None
    for done, row in enumerate(job.rows, start=1):
        frame = job.recording.frame(row)
        if row.position_mm is not None:
            if not row.leds_on:
                _take_node(seen, frame, row, row.position_mm, job)
        elif not row.leds_on:
            dark = frame
        elif dark is not None:  # LED reference exposures come in pairs: off, then on
            leds = locate_leds(frame, dark)
            seen.leds.append(np.array([(spot.u_px, spot.v_px) for spot in leds.spots]).reshape(-1, 2))
            seen.leds_dropped = leds.dropped
        progress(done, job.frames)
    return seen


def first_rows(job: Job) -> list[Row]:
    """The first exposure of each node."""
    first: dict[tuple[int, int], Row] = {}
    for row in job.rows:
        if row.position_mm is not None and not row.leds_on:
            first.setdefault(node_key(row.position_mm), row)
    return list(first.values())


def first_frames(job: Job) -> Iterator[Frame]:
    """The first exposure of each node, seen."""
    return (job.recording.frame(row) for row in first_rows(job))


def printed_nodes(job: Job) -> tuple[int, int]:
    """At how many of how many nodes the first exposure shows a spot on print."""
    shown = [shows_print(frame, job.localiser) for frame in first_frames(job)]
    return sum(shown), len(shown)


def node_key(position_mm: tuple[float, float]) -> tuple[int, int]:
    """Which node a stage's position belongs to."""
    x_mm, y_mm = position_mm
    return round(x_mm / _SAME_NODE_MM), round(y_mm / _SAME_NODE_MM)


def node_spot(frame: Frame, localiser: SpotSettings, flat: Flat | None) -> Spot | NoSpot:
    """The spot at a node. One that the border of the picture cuts has a profile where it has no moment."""
    spot = locate(frame, localiser, flat)
    if isinstance(spot, NoSpot) and spot.reason is Reason.CUT_BY_EDGE and localiser.method != "profile":
        return locate(frame, replace(localiser, method="profile"), flat)
    return spot


def _take_node(seen: Seen, frame: Frame, row: Row, position_mm: tuple[float, float], job: Job) -> None:
    node = seen.nodes.setdefault(node_key(position_mm), Node())
    node.positions_mm.append(position_mm)
    spot = node_spot(frame, job.localiser, job.flat)
    if isinstance(spot, NoSpot):
        detail = f" ({spot.detail})" if spot.detail else ""
        node.complaints.append(f"{spot.reason} in {row.file}{detail}")
    else:
        node.spots_px.append((spot.u_px, spot.v_px))
        node.sigmas_px.append(math.hypot(spot.sigma_px, spot.excess_px))
        node.located.append(row)
