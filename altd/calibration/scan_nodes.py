"""Spots at the nodes of a scan, frame LEDs, and whether there is print, from the cameras' frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from altd.calibration.result import Progress
from altd.calibration.target_frames import FrameRow, TargetFrames
from altd.mapping.nodes import Fiducials
from altd.reasons import Reason
from altd.records import FloatArray, Frame, NoSpot, Spot
from altd.vision.flat import Flat
from altd.vision.frame_leds import locate_leds
from altd.vision.localise import is_patterned_spot, locate
from altd.vision.settings import SpotSettings

Item = TypeVar("Item")

MAX_KEPT_BYTES = 96 << 20
"""Maximum size of cached items: 2,000 ordinary nodes, 45 kB each. Items beyond it are made again from their
frame at each request, which takes time instead of memory."""


class NodeCache(Generic[Item]):
    """One item per node that yields one; ``nodes`` are the numbers of these nodes."""

    def __init__(
        self,
        nodes: int,
        make: Callable[[int], Item | None],
        bytes_of: Callable[[Item], int],
        kept_bytes: int = MAX_KEPT_BYTES,
    ) -> None:
        """``make`` returns the item of a node by its number, the same at each call."""
        self.nodes: list[int] = []
        self._make = make
        self._kept: dict[int, Item] = {}
        left = kept_bytes
        for node in range(nodes):
            item = make(node)
            if item is None:
                continue
            self.nodes.append(node)
            size = bytes_of(item)
            if size <= left:
                left -= size
                self._kept[node] = item

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, at: int) -> Item:
        """The item of the node ``nodes[at]``."""
        node = self.nodes[at]
        item = self._kept.get(node)
        if item is None:
            item = self._make(node)
        if item is None:
            raise ValueError(f"node {node} no longer yields a spot: its frame was changed")
        return item

    def __iter__(self) -> Iterator[Item]:
        return (self[at] for at in range(len(self)))


_NODE_TOLERANCE_MM = 0.5
"""Exposures whose stage positions round to the same half millimetre belong to one node."""


@dataclass(slots=True)
class NodeVisit:
    """One recording's exposures at a node.

    Stage positions in mm, spots and their sigmas in px with their frames, and complaints on other frames.
    """

    positions_mm: list[tuple[float, float]] = field(default_factory=list)
    spots_px: list[tuple[float, float]] = field(default_factory=list)
    sigmas_px: list[float] = field(default_factory=list)
    located: list[FrameRow] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    @property
    def is_usable(self) -> bool:
        """Whether most of its exposures have a spot."""
        return len(self.spots_px) > len(self.complaints)

    @property
    def spot_px(self) -> FloatArray:
        """Mean (2,) of its spots."""
        mean: FloatArray = np.mean(self.spots_px, axis=0)
        return mean

    @property
    def deviations_px(self) -> FloatArray:
        """The distance of each spot (n, 2) from their mean."""
        deviations: FloatArray = np.array(self.spots_px) - self.spot_px
        return deviations


@dataclass(slots=True)
class ScanNode:
    """The exposures at one node, by the number of the recording."""

    visits: dict[int, NodeVisit] = field(default_factory=dict)
    refusal: str | None = None
    """Reason why the node is not used although it has spots; None: not refused."""

    @property
    def good_visits(self) -> dict[int, NodeVisit]:
        """The usable visits, by the number of the recording."""
        return {} if self.refusal else {n: visit for n, visit in self.visits.items() if visit.is_usable}

    @property
    def good(self) -> list[NodeVisit]:
        """The usable visits."""
        return list(self.good_visits.values())

    @property
    def is_usable(self) -> bool:
        """Whether the node has usable visits."""
        return bool(self.good)

    @property
    def key(self) -> tuple[int, int]:
        """Key of the node by its first stage position, see ``node_key``."""
        return node_key(next(iter(self.visits.values())).positions_mm[0])

    @property
    def position_mm(self) -> tuple[float, float]:
        """Mean stage position over the usable visits; over all visits if none is usable."""
        visits = self.good or self.visits.values()
        positions_mm = [position_mm for visit in visits for position_mm in visit.positions_mm]
        x_mm, y_mm = np.mean(positions_mm, axis=0).tolist()
        return x_mm, y_mm

    @property
    def exposures(self) -> int:
        """Number of usable spots."""
        return sum(len(visit.spots_px) for visit in self.good)

    @property
    def spot_px(self) -> FloatArray:
        """Mean (2,) of its usable spots."""
        mean: FloatArray = np.mean([spot for visit in self.good for spot in visit.spots_px], axis=0)
        return mean

    @property
    def sigma_px(self) -> float:
        """Root mean square sigma of its spots, by their own noise and light."""
        sigmas_px = [sigma for visit in self.good for sigma in visit.sigmas_px]
        return float(np.sqrt(np.mean(np.square(sigmas_px))))

    @property
    def complaint(self) -> str:
        """Reason why the node cannot be used."""
        return self.refusal or next(why for visit in self.visits.values() for why in visit.complaints)


@dataclass(slots=True)
class ScannedTarget:
    """Spots at nodes, and frame LEDs, from the scans of a target."""

    nodes: dict[tuple[int, int], ScanNode] = field(default_factory=dict)
    leds: list[FloatArray] = field(default_factory=list)
    leds_dropped: tuple[str, ...] = ()
    """Descriptions of the frame LEDs of the last pair that shine but could not be located."""

    @property
    def usable(self) -> list[ScanNode]:
        """The usable nodes."""
        return [node for node in self.nodes.values() if node.is_usable]

    @property
    def refused(self) -> list[ScanNode]:
        """The nodes that cannot be used."""
        return [node for node in self.nodes.values() if not node.is_usable]

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
    """One target's scans and how its spots are localised."""

    frames: TargetFrames
    localiser: SpotSettings
    flat: Flat | None
    fiducials: Fiducials | None = None
    """Of the print, if a flat learnt in service has taken the place of its model."""

    @property
    def name(self) -> str:
        """Name of the target."""
        return self.frames.name


def locate_nodes(job: Job, progress: Progress) -> ScannedTarget:
    """Localise the spots of all nodes and the LEDs of all reference pairs in one target's frames."""
    scanned = ScannedTarget()
    dark: tuple[int, Frame] | None = None
    total = len(job.frames)
    for done, frame_row in enumerate(job.frames, start=1):
        row, frame = frame_row.row, frame_row.frame()
        if row.position_mm is not None:
            if not row.leds_on:
                _add_exposure(scanned, frame, frame_row, row.position_mm, job)
        elif not row.leds_on:
            dark = frame_row.number, frame
        elif dark is not None and dark[0] == frame_row.number:  # LED reference pairs: off, then on
            leds = locate_leds(frame, dark[1])
            scanned.leds.append(np.array([(spot.u_px, spot.v_px) for spot in leds.spots]).reshape(-1, 2))
            scanned.leds_dropped = leds.rejected
        progress(done, total)
    return scanned


def first_of_nodes(job: Job) -> list[FrameRow]:
    """The first exposure of each node."""
    first: dict[tuple[int, int], FrameRow] = {}
    for frame_row in job.frames:
        if frame_row.row.position_mm is not None and not frame_row.row.leds_on:
            first.setdefault(node_key(frame_row.row.position_mm), frame_row)
    return list(first.values())


def first_frames(job: Job) -> Iterator[Frame]:
    """The first exposure of each node, decoded."""
    return (frame_row.frame() for frame_row in first_of_nodes(job))


def printed_nodes(job: Job) -> tuple[int, int]:
    """Number of nodes whose first exposure shows a spot on print, and number of all nodes."""
    shown = [is_patterned_spot(frame, job.localiser) for frame in first_frames(job)]
    return sum(shown), len(shown)


def node_key(position_mm: tuple[float, float]) -> tuple[int, int]:
    """Key of the node that a stage's position belongs to."""
    x_mm, y_mm = position_mm
    return round(x_mm / _NODE_TOLERANCE_MM), round(y_mm / _NODE_TOLERANCE_MM)


def node_spot(frame: Frame, localiser: SpotSettings, flat: Flat | None) -> Spot | NoSpot:
    """Locate the spot at a node; a spot cut by the picture's border has no moment, but may have a profile."""
    spot = locate(frame, localiser, flat)
    if isinstance(spot, NoSpot) and spot.reason is Reason.CUT_BY_EDGE and localiser.method != "profile":
        return locate(frame, replace(localiser, method="profile"), flat)
    return spot


def _add_exposure(
    scanned: ScannedTarget, frame: Frame, frame_row: FrameRow, position_mm: tuple[float, float], job: Job
) -> None:
    node = scanned.nodes.setdefault(node_key(position_mm), ScanNode())
    visit = node.visits.setdefault(frame_row.number, NodeVisit())
    visit.positions_mm.append(position_mm)
    spot = node_spot(frame, job.localiser, job.flat)
    if isinstance(spot, NoSpot):
        detail = f" ({spot.detail})" if spot.detail else ""
        visit.complaints.append(f"{spot.reason} in {job.frames.file_of(frame_row)}{detail}")
    else:
        visit.spots_px.append((spot.u_px, spot.v_px))
        visit.sigmas_px.append(math.hypot(spot.sigma_px, spot.excess_px))
        visit.located.append(frame_row)
