"""Measurements over time, combined into a limited number of bins for a drawing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

MAX_BINS = 2000
"""Maximum number of bins: more than a drawing can show."""
_MAX_GAP_PERIODS = 3.0
"""Maximum distance of two connected bins, in usual distances; a larger one is a gap."""


@dataclass(slots=True)
class Bin:
    """Consecutive measurements, combined into one.

    ``low`` and ``high`` are the lowest value − sigma and the highest value + sigma of each quantity and
    ``total`` its sum; only valid measurements are in them. ``codes`` contains the codes of all measurements.
    """

    first_s: float
    last_s: float
    count: int = 1
    valid: int = 0
    total: dict[str, float] = field(default_factory=dict)
    low: dict[str, float] = field(default_factory=dict)
    high: dict[str, float] = field(default_factory=dict)
    codes: dict[str, None] = field(default_factory=dict)

    @property
    def middle_s(self) -> float:
        """Position on the time axis."""
        return (self.first_s + self.last_s) / 2

    def mean(self, quantity: str) -> float:
        """Mean of a quantity over the valid measurements."""
        return self.total[quantity] / self.valid

    def take(self, later: Bin) -> None:
        """Merge the next bin into this one."""
        self.last_s = later.last_s
        self.count += later.count
        self.codes |= later.codes
        if not later.valid:
            return
        for name, total in later.total.items():
            self.total[name] = self.total.get(name, 0.0) + total
            self.low[name] = min(self.low.get(name, later.low[name]), later.low[name])
            self.high[name] = max(self.high.get(name, later.high[name]), later.high[name])
        self.valid += later.valid


@dataclass(frozen=True, slots=True)
class Drawn:
    """A quantity of a drawing: its axis label, and the key of its sigma."""

    label: str
    sigma_key: str


class PlotHistory:
    """Takes the objects of measurements, one after the other, and keeps at most ``MAX_BINS`` bins of them.

    ``quantities`` are the quantities that are kept, by their keys.
    """

    def __init__(self, quantities: Mapping[str, Drawn]) -> None:
        self.quantities = quantities
        self.bins: list[Bin] = []
        self._per_bin = 1

    def add(self, t_s: float, document: Mapping[str, Any]) -> None:
        """Add a measurement's object (``status.measurement_json``) with the time of its last exposure."""
        new = Bin(t_s, t_s, codes=dict.fromkeys(document["status"]))
        if document["valid"]:
            new.valid = 1
            for name, drawn in self.quantities.items():
                value, sigma = document[name], document["sigma"][drawn.sigma_key]
                new.total[name], new.low[name], new.high[name] = value, value - sigma, value + sigma
        if self.bins and self.bins[-1].count < self._per_bin:
            self.bins[-1].take(new)
        else:
            self.bins.append(new)
        if len(self.bins) > MAX_BINS:
            self._halve()

    def _halve(self) -> None:
        self._per_bin *= 2
        for earlier, later in zip(self.bins[::2], self.bins[1::2], strict=False):
            earlier.take(later)
        del self.bins[1::2]

    @property
    def period_s(self) -> float:
        """Usual (median) distance of two bins; 1 if there are fewer than two."""
        starts = [of.first_s for of in self.bins]
        gaps = sorted(later - earlier for earlier, later in pairwise(starts))
        return gaps[len(gaps) // 2] if gaps and gaps[len(gaps) // 2] > 0 else 1.0

    def runs(self) -> Iterator[list[Bin]]:
        """Yield the bins with valid measurements, as runs without a gap."""
        yield from self._without_gaps(lambda of: of.valid > 0)

    def spans_s(self, code: str | None) -> list[tuple[float, float]]:
        """Spans in which ``code`` was reported; None: spans in which a measurement was valid."""
        half_s = self.period_s / 2
        runs = self._without_gaps(lambda of: of.valid > 0 if code is None else code in of.codes)
        return [(run[0].first_s - half_s, run[-1].last_s + half_s) for run in runs]

    def codes(self) -> list[str]:
        """The distinct reasons, in the order of their first occurrence."""
        return list(dict.fromkeys(code for of in self.bins for code in of.codes))

    def _without_gaps(self, wanted: Callable[[Bin], bool]) -> Iterator[list[Bin]]:
        farthest_s = _MAX_GAP_PERIODS * self.period_s
        run: list[Bin] = []
        for of in self.bins:
            if run and (not wanted(of) or of.first_s - run[-1].last_s > farthest_s):
                yield run
                run = []
            if wanted(of):
                run.append(of)
        if run:
            yield run
