"""Where the stage put the beam in a scan that is measured: at which node, and how far off it was found."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from altd.calibration.scan_nodes import node_key
from altd.errors import BadInputError
from altd.measuring.chain import Place
from altd.recording.frames_table import Row
from altd.recording.header import FRAMES_FILE
from altd.recording.reader import Recording
from altd.records import Measurement

MAX_WINDOW = 1000
"""Exposures; a node that has more is measured by its last ones."""
_MAX_REMEMBERED = 4 * MAX_WINDOW
"""Exposures that a measurement may still speak of."""
_MAX_BEHIND = MAX_WINDOW
"""Rows of one camera that may follow the other's latest: then that one is not forgotten while it waits."""


@dataclass(frozen=True, slots=True)
class _Exposure:
    """At which stay of the stage, counted from 0, and where that put the beam."""

    stay: int
    position_mm: tuple[float, float]
    row: Row


class _Stays:
    """Counts the stays of the stage at its nodes, row by row. Remembers the last exposures."""

    def __init__(self) -> None:
        self.exposures: dict[int, _Exposure] = {}
        self._last: _Exposure | None = None

    def see(self, row: Row) -> _Exposure | None:
        """Take a row; None for what is no exposure at a node, as those of the LED reference pairs."""
        if row.position_mm is None or row.leds_on:
            return None
        if (known := self.exposures.get(row.sequence)) is not None:
            return known
        last = self._last
        is_there = last is not None and node_key(row.position_mm) == node_key(last.position_mm)
        stay = 0 if last is None else last.stay + (not is_there)
        self._last = self.exposures[row.sequence] = _Exposure(stay, row.position_mm, row)
        if len(self.exposures) > _MAX_REMEMBERED:
            del self.exposures[next(iter(self.exposures))]
        return self._last


class ScanPositions:
    """The positions of a scan's exposures while it is measured.

    Nodes are told apart as ``altd calibrate`` does. ``cameras`` are those that are measured. ``window`` is
    how many exposures are averaged; None: all of a stay at a node, which gives one measurement each. Raises
    BadInputError where two rows of one exposure contradict each other, where rows are far out of order, and
    when no row has a position.
    """

    def __init__(self, recording: Recording, cameras: Collection[str], window: int | None) -> None:
        self._window = window
        self._stays = _Stays()
        lengths = _lengths(recording, cameras)
        self._lengths = None if window is not None else lengths

    @property
    def is_by_node(self) -> bool:
        """Whether a stay is averaged as a whole."""
        return self._window is None

    def see(self, row: Row) -> bool:
        """Take a row; whether it is to be measured."""
        return self._stays.see(row) is not None

    def place(self, sequence: int) -> Place | None:
        """Where an exposure was made whose row was seen."""
        exposure = self._stays.exposures.get(sequence)
        if exposure is None:
            return None
        of_all = None if self._lengths is None else min(self._lengths[exposure.stay], MAX_WINDOW)
        return Place(exposure.stay, of_all)

    def known_mm(self, sequence: int) -> tuple[float, float]:
        """The mean of the positions (x, y) that a window up to this exposure can reach."""
        exposures = self._stays.exposures
        reach = range(sequence, sequence - (self._window or MAX_WINDOW), -1)
        stay = exposures[sequence].stay
        reached = [exposures[n].position_mm for n in reach if n in exposures and exposures[n].stay == stay]
        count = len(reached)
        return sum(x_mm for x_mm, _ in reached) / count, sum(y_mm for _, y_mm in reached) / count

    def by_node(self, measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        """The last measurement of each stay, where a stay is averaged as a whole; else all of them."""
        if not self.is_by_node:
            yield from measurements
            return
        last: Measurement | None = None
        last_stay = 0
        for measurement in measurements:
            stay = self._stays.exposures[measurement.sequence].stay
            if last is not None and stay != last_stay:
                yield last
            last, last_stay = measurement, stay
        if last is not None:
            yield last


def _lengths(recording: Recording, cameras: Collection[str]) -> list[int]:
    """How many exposures each stay of the stage has."""
    stays, lengths = _Stays(), list[int]()
    place = recording.path / FRAMES_FILE
    latest: Row | None = None
    since_latest = 0
    for row in recording.rows:
        if row.camera not in cameras:
            continue
        if latest is None or row.sequence > latest.sequence:
            latest, since_latest = row, 0
        since_latest += 1
        if since_latest > _MAX_BEHIND:
            raise BadInputError(
                f"{place}: row {row.number}",
                f"is out of the order of time: sequence {row.sequence} long after {latest.sequence}",
            )
        before = len(lengths)
        is_new = row.sequence not in stays.exposures
        exposure = stays.see(row)
        if exposure is None:
            continue
        if exposure.position_mm != row.position_mm:
            raise BadInputError(
                f"{place}: row {row.number}",
                f"x_mm, y_mm are not those of the same exposure in row {exposure.row.number}",
            )
        if exposure.stay == before:
            lengths.append(0)
        lengths[exposure.stay] += is_new
    if not lengths:
        raise BadInputError(place, "is of a scan, and no row has a position")
    return lengths
