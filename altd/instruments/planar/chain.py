"""Frames in, measurements of the plate's pose out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from altd.instruments.planar.instrument import Leds, PlanarInstrument
from altd.instruments.planar.leds import find_leds, led_image
from altd.measuring.freshness import FreshnessCheck
from altd.measuring.gate import Gate
from altd.reasons import Reason
from altd.records import Fault, FloatArray, Frame, Measurement, Value

_MAX_STILL_CHI2_SIGMAS = 6.0
"""LEDs that are farther from their mean than this are those of a plate that moved."""
_MAX_UNUSABLE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class _Exposure:
    sequence: int
    t_ns: int
    leds: Leds | Fault


class PlanarChain:
    """Finds LEDs, averages the frames of one pose and solves it; pure but for its memory of the window.

    ``window`` is the number of exposures that are averaged, ``every`` that from one measurement to the next,
    counted from the first exposure. No window mixes two poses: it begins again with a frame whose LEDs moved,
    or whose known pose is another one. ``origins`` are the faults that each measurement carries.
    """

    def __init__(
        self,
        instrument: PlanarInstrument,
        frame_noise_px: float,
        window: int,
        every: int,
        origins: tuple[Fault, ...] = (),
        utc: Callable[[int], datetime | None] = lambda t_ns: None,
    ) -> None:
        self._instrument, self._noise_px = instrument, frame_noise_px
        self._window, self._every = window, every
        self._origins, self._utc = origins, utc
        self._exposures: deque[_Exposure] = deque()
        self._still: list[Leds] = []
        """The LEDs of the exposures at this pose, the newest last."""
        self._known_pose: tuple[float, float, float] | None = None
        self._since = 0
        self._freshness = FreshnessCheck()
        self._gate = Gate()

    def add(self, frame: Frame, known_pose: tuple[float, float, float] | None = None) -> Measurement | None:
        """Take one frame; returns the measurement that it completes. ``known_pose`` only ends a window."""
        before = self._still[-1] if self._still else None
        if self._exposures and frame.sequence != self._exposures[-1].sequence + 1:
            before = None
        leds: Leds | Fault
        if repeated := self._freshness.repeated(frame):
            leds = Fault(Reason.FRAME_REPEATED, detail=repeated)
        else:
            leds = self._instrument.identify(find_leds(led_image(frame.pixels)), before)
        has_moved = known_pose != self._known_pose
        if isinstance(leds, Leds):
            has_moved = has_moved or self._has_moved(leds)
        if has_moved:
            self._exposures.clear()
            self._still.clear()
        self._known_pose = known_pose
        if isinstance(leds, Leds):
            self._still = [*self._still, leds][-self._window :]
        while self._exposures and frame.sequence - self._exposures[0].sequence >= self._window:
            self._exposures.popleft()
        self._exposures.append(_Exposure(frame.sequence, frame.t_ns, leds))
        self._since += 1
        if self._since < self._every:
            return None
        self._since = 0
        return self._gate.admit(self._measurement())

    def _has_moved(self, leds: Leds) -> bool:
        """Whether the LEDs are elsewhere than in the frames before, beyond their noise."""
        if not self._still:
            return False
        mean = mean_leds(self._still)
        common = [number for number in leds.numbers if number in mean.numbers]
        if not common:
            return True
        rows = [mean.numbers.index(number) for number in common]
        off = leds.centres_px[[leds.numbers.index(number) for number in common]] - mean.centres_px[rows]
        variance = self._noise_px**2 * (1.0 + 1.0 / np.array([mean.frames[row] for row in rows]))
        chi2, degrees = float((off**2 / variance[:, None]).sum()), 2 * len(common)
        return chi2 > degrees + _MAX_STILL_CHI2_SIGMAS * math.sqrt(2.0 * degrees)

    def _measurement(self) -> Measurement:
        newest = self._exposures[-1]
        usable = [each for each in self._exposures if isinstance(each.leds, Leds)]
        lost = len(self._exposures) - len(usable)
        faults: tuple[Fault, ...] = ()
        values: dict[str, Value] = {}
        if isinstance(newest.leds, Fault):
            faults = (newest.leds,)
        elif lost > _MAX_UNUSABLE_SHARE * len(self._exposures):
            faults = tuple(each.leds for each in self._exposures if isinstance(each.leds, Fault))[-1:]
        else:
            leds = mean_leds([each.leds for each in usable if isinstance(each.leds, Leds)])
            solved = self._instrument.solve(leds)
            if isinstance(solved, Fault):
                faults = (solved,)
            else:
                values = solved
                faults = (Fault(Reason.EXPOSURES_LOST, detail=f"{lost} in this window"),) if lost else ()
        t_ns = round(sum(each.t_ns for each in usable) / len(usable)) if values else newest.t_ns
        return Measurement(
            sequence=newest.sequence,
            t_ns=t_ns,
            time=self._utc(t_ns),
            frames=len(usable) if values else 0,
            quantities=self._instrument.quantities,
            values=values,
            targets={},
            status=faults + self._origins,
            last_exposure_ns=newest.t_ns,
        )


def mean_leds(exposures: list[Leds]) -> Leds:
    """The mean centre of each LED over the exposures in which it is seen."""
    numbers = sorted({number for leds in exposures for number in leds.numbers})
    sums: FloatArray = np.zeros((len(numbers), 2))
    frames = np.zeros(len(numbers), dtype=np.int64)
    for leds in exposures:
        rows = [numbers.index(number) for number in leds.numbers]
        sums[rows] += leds.centres_px
        frames[rows] += 1
    return Leds(tuple(numbers), sums / frames[:, None], tuple(frames.tolist()))
