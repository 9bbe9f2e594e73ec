"""From frames to measurements of the plate's pose."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from altd.config import Measuring
from altd.instruments.planar.instrument import QUANTITIES, Leds, PlanarCalibration, PlanarInstrument
from altd.instruments.planar.leds import find_leds, led_image
from altd.measuring.frame_chain import FrameChain, Provenance, RestPlace
from altd.measuring.freshness import FreshnessCheck
from altd.measuring.instrument import NO_SOLUTION, Solution
from altd.measuring.pairing import Pair
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, FaultCause, FloatArray, Frame, Measurement, counted
from altd.vision.led_discs import Disc

_MAX_STILL_CHI2_SIGMAS = 6.0
"""Maximum excess of chi-square of LEDs about their mean, in its standard deviations; above it, the plate
moved."""
_MAX_UNUSABLE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class PlateFrame:
    """Content of a frame: its lights, or why they cannot be measured. ``spot`` describes it as text."""

    t_ns: int
    lights: tuple[Disc, ...] | Fault

    @property
    def spot(self) -> str:
        """Finding as text."""
        return str(self.lights) if isinstance(self.lights, Fault) else counted(len(self.lights), "light")


class PlateLocator:
    """Finds the lights in each frame of the camera; one thread calls ``locate`` frame by frame.

    ``identity`` returns the camera that delivers; ``expected`` holds the identities that it must match.
    """

    def __init__(
        self, expected: Sequence[CameraIdentity], identity: Callable[[], CameraIdentity | None]
    ) -> None:
        self._expected, self._identity = expected, identity
        self._freshness = FreshnessCheck()

    def locate(self, frame: Frame) -> PlateFrame:
        """Return the lights of a frame; a fault if it is repeated, unevenly exposed or of another camera."""
        fault = None
        if repeated := self._freshness.repeated(frame):
            fault = Fault(Reason.FRAME_REPEATED, detail=repeated)
        elif frame.changing:
            fault = Fault(Reason.EXPOSURE_CHANGING)
        elif (camera := self._identity()) is not None:
            different = filter(None, (camera.difference_from(expected) for expected in self._expected))
            if said := next(different, None):
                fault = Fault(Reason.WRONG_CAMERA, detail=said, cause=FaultCause.OTHER_CAMERA)
        lights = fault or find_leds(led_image(frame.pixels))
        return PlateFrame(frame.t_ns, lights)


@dataclass(frozen=True, slots=True)
class _Exposure:
    sequence: int
    t_ns: int
    leds: Leds | Fault


class PlanarChain(FrameChain[PlateFrame]):
    """Averages the frames of one pose and solves it; its only state is the window.

    ``measuring`` sets the number of exposures that are averaged, and the number from one measurement to the
    next, counted from the first exposure. No window mixes two poses: it restarts at a frame whose LEDs moved,
    after a gap, and at another ``place`` of ``provenance``. ``expected`` is the camera named in the config,
    in addition to the calibrated one.
    """

    def __init__(
        self,
        camera: str,
        calibration: PlanarCalibration,
        measuring: Measuring,
        provenance: Provenance,
        expected: CameraIdentity | None = None,
    ) -> None:
        self._instrument, self._noise_px = PlanarInstrument(calibration), calibration.frame_noise_px
        self._window, self._every = measuring.window, measuring.every
        self._camera = camera
        cameras = (calibration.camera, expected or CameraIdentity())
        locators = {camera: PlateLocator(cameras, partial(provenance.identity, camera))}
        super().__init__(locators, measuring, provenance, QUANTITIES, (), calibration.simulated)
        self._exposures: deque[_Exposure] = deque()
        self._still: list[Leds] = []
        """LEDs of the exposures at this pose, the newest last."""
        self._place: RestPlace | None = None
        self._last: PlateFrame | None = None
        self._since = 0

    def seen(self) -> dict[str, str]:
        """Last finding of the camera as text."""
        return {} if self._last is None else {self._camera: str(self._last.spot)}

    def figures(self) -> dict[str, float | str | None]:
        """Number of LEDs in the newest frame, for health."""
        newest = self._exposures[-1].leds if self._exposures else None
        return {"leds": len(newest.numbers) if isinstance(newest, Leds) else 0}

    def measure(self, pair: Pair[PlateFrame]) -> Measurement | None:
        """Process the lights of a frame; return the measurement that it completes, if any."""
        sequence, seen = pair.sequence, pair.items[self._camera]
        place, self._place = self._place, self._provenance.place(sequence)
        if self._place != place or sequence <= self._last_sequence:
            self.forget()
        is_next = self._exposures and sequence == self._exposures[-1].sequence + 1
        before = self._still[-1] if self._still and is_next else None
        leds = (
            seen.lights if isinstance(seen.lights, Fault) else self._instrument.identify(seen.lights, before)
        )
        if isinstance(leds, Leds):
            if self._has_moved(leds):
                self.forget()
            self._still = [*self._still, leds][-self._window :]
        while self._exposures and sequence - self._exposures[0].sequence >= self._window:
            self._exposures.popleft()
        self._exposures.append(_Exposure(sequence, seen.t_ns, leds))
        self._last = seen
        self._since += 1
        if self._since < self._every:
            return None
        self._since = 0
        return self._measurement()

    def forget(self) -> None:
        """Clear the window, so that it does not span this moment."""
        self._exposures.clear()
        self._still.clear()
        self._last = None

    def _has_moved(self, leds: Leds) -> bool:
        """Whether the LEDs differ from those of earlier frames by more than their noise."""
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
        solution = NO_SOLUTION
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
                solution = Solution(solved, {})
                faults = (Fault(Reason.EXPOSURES_LOST, detail=f"{lost} in this window"),) if lost else ()
        if not solution.values:
            return self._finished(newest.sequence, newest.t_ns, newest.t_ns, faults)
        t_ns = round(sum(each.t_ns for each in usable) / len(usable))
        return self._finished(newest.sequence, newest.t_ns, t_ns, faults, len(usable), solution)


def mean_leds(exposures: list[Leds]) -> Leds:
    """Mean centre of each LED over the exposures in which it is visible."""
    numbers = sorted({number for leds in exposures for number in leds.numbers})
    sums: FloatArray = np.zeros((len(numbers), 2))
    frames = np.zeros(len(numbers), dtype=np.int64)
    for leds in exposures:
        rows = [numbers.index(number) for number in leds.numbers]
        sums[rows] += leds.centres_px
        frames[rows] += 1
    return Leds(tuple(numbers), sums / frames[:, None], tuple(frames.tolist()))
