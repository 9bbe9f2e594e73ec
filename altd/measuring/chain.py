"""Measuring chain from frames to measurements, shared by ``run`` and ``replay``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial

from altd.config import Measuring
from altd.measuring.averaging import FrameSetWindow, Window
from altd.measuring.calibration import Calibration
from altd.measuring.gate import Gate
from altd.measuring.instrument import Instrument
from altd.measuring.light_balance import LightBalance
from altd.measuring.motion_memory import MotionMemory
from altd.measuring.pairing import Pair, Pairer
from altd.measuring.sampling import MIN_EXPOSURES, SamplingCheck, ScatterMemory
from altd.measuring.spot_locator import Located, SpotLocator
from altd.measuring.synchrony import SynchronyCheck
from altd.measuring.view_check import shift_fault
from altd.reasons import Reason
from altd.records import (
    CameraIdentity,
    Fault,
    FaultCause,
    Frame,
    FrameSet,
    MeanSpots,
    Measurement,
    NoSpot,
    Spot,
)
from altd.records.spots import Motion

_SILENT = NoSpot(Reason.CAMERA_SILENT, "no frame comes")
_SCATTER_UNKNOWN = Fault(
    Reason.WARMING_UP, detail=f"{MIN_EXPOSURES} exposures at uneven times are needed first"
)
_MOTION_UNKNOWN = Fault(Reason.WARMING_UP, detail="how the beam moves is not known yet")


@dataclass(frozen=True, slots=True)
class View:
    """A target and its camera.

    ``expected`` is the identity required of the camera in addition to the calibrated one; None: any.
    """

    target: str
    camera: str
    expected: CameraIdentity | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Place at which the beam rested, in a recording that contains it; no window mixes two places.

    ``window`` is the number of frame sets averaged there; None: the configured number.
    """

    number: int
    window: int | None = None


@dataclass(frozen=True, slots=True)
class Provenance:
    """Data about frames that their pixels do not contain: source, and time and place of exposure.

    ``origins`` returns the faults that every measurement must carry because of the current source,
    ``identity`` the camera that a name refers to now (None: not known), ``utc`` the time of day of a ``t_ns``
    (None: not known), ``place`` the place at which a sequence number was exposed (None: not known).
    """

    origins: Callable[[], Iterable[Fault]] = tuple
    identity: Callable[[str], CameraIdentity | None] = lambda camera: None
    utc: Callable[[int], datetime | None] = lambda t_ns: None
    place: Callable[[int], Place | None] = lambda sequence: None


_UNKNOWN = Provenance()


class MeasuringChain:
    """Pairs frames, locates spots, averages, maps and fits the beam; pure but for its memory of the window.

    Every measurement reports the origin of the frames, from ``provenance``, and whether the calibration is of
    simulated frames.

    ``switched`` is the window of a unit with a switched front target: a frame set shows only the opaque
    target, and one without an opaque target is not measured. None: each frame set shows all targets.
    ``correct`` removes a known drift of the cameras from the mean spots, before they are mapped.

    ``push`` runs all steps. A daemon runs the three steps on separate threads: ``pairer`` makes frame sets,
    ``locators`` locate the spots, by camera, and ``add`` processes the results. The steps share only the
    figures that ``pairer`` counts.
    """

    def __init__(  # noqa: PLR0913  the parts of a unit
        self,
        views: Sequence[View],
        calibration: Calibration,
        measuring: Measuring,
        instrument: Instrument,
        provenance: Provenance = _UNKNOWN,
        switched: Window | None = None,
        correct: Callable[[MeanSpots], MeanSpots] | None = None,
    ) -> None:
        self._views = {view.camera: view for view in views}
        self._targets = tuple(view.target for view in views)
        self._calibration = {target.name: target for target in calibration.targets}
        self._measuring = measuring
        self._instrument = instrument
        self._silent_after_ns = round(measuring.silent_after_s * 1e9)
        self._is_of_now = measuring.output == "now"
        self.pairer: Pairer[Frame] = Pairer(
            tuple(self._views),
            measuring.pair_by,
            measuring.max_skew_ns,
            measuring.max_lag_ns,
        )
        self._is_switched = switched is not None
        self._scatter = ScatterMemory()
        self._window = switched or FrameSetWindow(
            self._targets, measuring.window, measuring.every, self._scatter
        )
        self._provenance = provenance
        self._calibration_origin = calibration_faults(calibration.simulated)
        self._last_place: Place | None = None
        self.locators: Mapping[str, SpotLocator] = {
            view.camera: SpotLocator(
                view.camera,
                self._calibration[view.target],
                partial(provenance.identity, view.camera),
                view.expected,
                calibration.other_place_of,
                self._is_switched,
            )
            for view in views
        }
        self._view_status = {camera: locator.view for camera, locator in self.locators.items()}
        self._synchrony = SynchronyCheck(self._targets)
        self._sampling = SamplingCheck()
        self._light_balance = LightBalance([self._calibration[target].spot.light for target in self._targets])
        self._changed_light: tuple[float, ...] = ()
        self._motion_memory = MotionMemory()
        self._gate = Gate()
        self._correct = correct
        self._breaks_in_window = dict.fromkeys(self._views, 0)
        self._last_frame_set: FrameSet | None = None
        self._last_spots: dict[str, Spot | NoSpot] = {}
        self._last_skew_ns: int | None = None
        """Skew of the last frame set; None if it had too few frames to determine it."""
        self._now_ns = 0
        self._last_frame_ns: dict[str, int] = {}
        self.frame_sets = 0
        """Number of frame sets that were paired or given up, each later than the previous one."""

    @property
    def silent_after_s(self) -> float:
        """Time without a frame after which a camera is silent, s."""
        return self._measuring.silent_after_s

    def seen(self) -> dict[str, str]:
        """Return the last finding of each target as text, for the technician who aims the beam."""
        return {
            target: str(self._last_spots[target]) for target in self._targets if target in self._last_spots
        }

    def figures(self) -> dict[str, float | str | None]:
        """Return sampling, synchronism, spots, light and views, for health."""
        return {"sampling": self._sampling.found} | self.step() | self.spots() | self.light() | self.views()

    def step(self) -> dict[str, float | None]:
        """Return the cameras' synchronism: skew of the last frame set, and the lags that were subtracted, ms.

        None: not known, because a frame is missing or a camera is silent.
        """
        first = next(iter(self._views))
        lags = {
            f"lag_{camera}_ms": None if {first, camera} & self._silent() else round(lag_ns * 1e-6, 2)
            for camera, lag_ns in list(self.pairer.lags_ns.items())[1:]
        }
        skew_ns = None if self._silent() else self._last_skew_ns
        return {"skew_ms": None if skew_ns is None else round(skew_ns * 1e-6, 2), **lags}

    def spots(self) -> dict[str, float]:
        """Return diameter (1/e², px) and peak (counts) of each target's newest spot, if there is one."""
        known = {target: spot for target, spot in self._last_spots.items() if isinstance(spot, Spot)}
        diameters = {f"diameter_{target}_px": round(spot.diameter_px, 1) for target, spot in known.items()}
        return diameters | {f"peak_{target}": round(spot.peak, 1) for target, spot in known.items()}

    def light(self) -> dict[str, float]:
        """Return the share by which each target's light changed relative to the first one's, where known."""
        changed = zip(self._targets[1:], self._changed_light[1:], strict=False)
        return {f"light_changed_{target}": round(share, 3) for target, share in changed}

    def views(self) -> dict[str, float | str]:
        """Return whether the cameras are the calibrated ones, for health."""
        return {
            name: figure
            for status in self._view_status.values()
            for name, figure in status.figures(self._now_ns).items()
        }

    def _silent(self) -> set[str]:
        """Return the cameras that have delivered no frame for the time after which a camera is silent."""
        oldest_ns = self._now_ns - self._silent_after_ns
        return {camera for camera in self._views if self._last_frame_ns.get(camera, oldest_ns) <= oldest_ns}

    def push(self, frame: Frame) -> list[Measurement]:
        """Process one frame; return the measurements that it completes. LED exposures are not measured."""
        return self._measured(self.pairer.add(frame.camera, frame.sequence, frame.t_ns, frame))

    def flush(self) -> list[Measurement]:
        """Settle frames that still wait for a partner, at the end of a recording; return measurements."""
        return self._measured(self.pairer.flush())

    def _measured(self, pairs: Sequence[Pair[Frame]]) -> list[Measurement]:
        measurements = (self.add(pair.of(self.located)) for pair in pairs)
        return [measurement for measurement in measurements if measurement is not None]

    def located(self, frame: Frame) -> Located:
        """Return the spot in one frame, or why there is none."""
        return self.locators[frame.camera].locate(frame)

    def add(self, pair: Pair[Located]) -> Measurement | None:
        """Process the located frames of one frame set; return the measurement that it completes, if any."""
        self._now_ns = max(located.t_ns for located in pair.all_items)
        for located in pair.all_items:
            self._last_frame_ns[located.camera] = located.t_ns
            if located.is_shown and not located.leds_on:
                self._last_spots[self._views[located.camera].target] = located.spot
            self._view_status[located.camera] = located.view
        if self._is_skipped(pair):
            return None
        measurement = self._after(self._frame_set(pair))
        return None if measurement is None else self._gate.admit(measurement)

    def silence(self, t_ns: int) -> Measurement:
        """Clear the window; return the invalid measurement of an instant at which no camera delivers."""
        self._window.forget()
        self._last_skew_ns = None
        self._last_frame_ns.clear()
        self._now_ns = t_ns
        last = FrameSet(self._last_frame_set.sequence if self._last_frame_set else 0, t_ns, {})
        silent = _SILENT
        self._last_spots = dict.fromkeys(self._targets, silent)
        self._changed_light = ()
        return self._invalid(last, t_ns, tuple(silent.fault(target) for target in self._targets))

    def _is_skipped(self, pair: Pair[Located]) -> bool:
        """Return whether frame LEDs were lit, or LEDs or targets switched, in any frame of a frame set.

        Such a frame set continues the time, so it leaves no gap in which anything may have happened. It is
        not part of the window, whose length is counted by the frame sets' numbers.
        """
        opaque = {located.opaque for located in pair.all_items}
        is_settling = self._is_switched and (len(opaque) > 1 or "" in opaque)
        if not is_settling and not any(located.leds_on for located in pair.items.values()):
            return False
        last = self._last_frame_set
        if last is None or pair.t_ns > last.t_ns:
            self.frame_sets += 1
            self._last_frame_set = FrameSet(pair.sequence, pair.t_ns, {})
            self._window.skip(pair.sequence)
        return True

    def _frame_set(self, pair: Pair[Located]) -> FrameSet:
        """Return the spots of one instant.

        Clears the window at a new place and after a break in a camera's frames (``Located.breaks``).
        """
        spots: dict[str, Spot | NoSpot] = {}
        if (place := self._provenance.place(pair.sequence)) != self._last_place:
            self._last_place = place
            self._window.begin(place.window if place else None)
        self._last_skew_ns = None if len(pair.items) == 1 < len(self._views) else pair.skew_ns
        for camera, view in self._views.items():
            if camera in pair.items:
                located = pair.items[camera]
                spots[view.target] = located.spot
                if located.breaks != self._breaks_in_window[camera]:
                    self._breaks_in_window[camera] = located.breaks
                    self._window.forget()
            else:
                missing = self._why_missing(pair.missing[camera])
                spots[view.target] = self._last_spots[view.target] = missing
        behind_ns = {self._views[camera].target: late_ns for camera, late_ns in pair.behind_ns.items()}
        return FrameSet(pair.sequence, pair.t_ns, spots, behind_ns, pair.all_items[0].opaque)

    def _why_missing(self, reason: Reason) -> NoSpot:
        """Return the reason; ``out_of_step`` gets the known figures of the cameras' synchronism as detail."""
        if reason is not Reason.OUT_OF_STEP:
            return _SILENT
        known = {name: value for name, value in self.step().items() if value is not None}
        return NoSpot(reason, ", ".join(f"{name} {value:g}" for name, value in known.items()))

    def _after(self, frame_set: FrameSet) -> Measurement | None:
        last = self._last_frame_set
        since_last_ns = 1 if last is None else frame_set.t_ns - last.t_ns
        if not 0 < since_last_ns <= self._silent_after_ns:
            self._window.forget()
            self._synchrony.restart()
        self.frame_sets += since_last_ns > 0
        self._last_frame_set = frame_set
        self._sampling.add(frame_set.t_ns)
        unsynchronised = "" if self._is_switched else self._synchrony.inspect(frame_set)
        mean = self._window.add(frame_set)
        if mean is None:
            return None
        if not isinstance(mean, MeanSpots):
            return self._invalid(frame_set, frame_set.t_ns, mean)
        if unsynchronised:
            fault = Fault(Reason.OUT_OF_STEP, detail=unsynchronised, cause=FaultCause.LATE_PICTURES)
            return self._invalid(frame_set, mean.t_ns, (fault,))
        if (shifted := shift_fault(self._view_status.values())) is not None:
            return self._invalid(frame_set, mean.t_ns, (shifted,))
        if (mean := self._with_unseen(mean)) is None:
            return self._invalid(frame_set, frame_set.t_ns, (_SCATTER_UNKNOWN,))
        self._changed_light = self._light_balance.changed_light(mean)
        mean = replace(mean, changed_light=self._changed_light)
        spots = mean.at_newest() if self._is_of_now else mean
        if spots is None:
            return self._invalid(frame_set, mean.t_ns, (_MOTION_UNKNOWN,))
        solution = self._instrument.solve(self._correct(spots) if self._correct else spots)
        if isinstance(solution, Fault):
            return self._invalid(frame_set, spots.t_ns, (solution,))
        self._light_balance.update(mean)
        lost = (Fault(Reason.EXPOSURES_LOST, detail=f"{mean.lost} in this window"),) if mean.lost else ()
        measurement = Measurement(
            sequence=frame_set.sequence,
            t_ns=spots.t_ns,
            time=self._provenance.utc(spots.t_ns),
            frames=mean.frames,
            quantities=self._instrument.quantities,
            values=solution.values,
            targets=solution.targets,
            status=lost + self._origin_faults(),
            last_exposure_ns=frame_set.t_ns,
            motions=self._motions(mean, frame_set.t_ns, solution.motions),
        )
        if not self._is_of_now:
            return measurement
        return measurement.with_motion_in_sigma() or self._invalid(frame_set, spots.t_ns, (_MOTION_UNKNOWN,))

    def _with_unseen(self, mean: MeanSpots) -> MeanSpots | None:
        """Return the mean spots with the scatter and the lags that this window alone does not show.

        None: the scatter is not known yet.
        """
        if self._is_switched:
            return mean
        if excess := self._sampling.excess(mean.frames):
            widened = self._scatter.widened(mean, excess)
            if widened is None:
                return None
            mean = replace(widened, is_even=self._sampling.found is None)
        return self._synchrony.with_lag_in_sigma(mean)

    def _motions(
        self, mean: MeanSpots, newest_ns: int, of_window: Mapping[str, Motion]
    ) -> Mapping[str, Motion]:
        """Return the motion of the quantities, extended by that of earlier windows."""
        span_s = mean.motion.span_s if mean.motion else 0.0
        return self._motion_memory.add(mean.t_ns, newest_ns, span_s, of_window)

    def _invalid(self, frame_set: FrameSet, t_ns: int, faults: tuple[Fault, ...]) -> Measurement:
        """Return a measurement without numbers, even of targets with good spots: half a beam is no result."""
        return Measurement(
            sequence=frame_set.sequence,
            t_ns=t_ns,
            time=self._provenance.utc(t_ns),
            frames=0,
            quantities=self._instrument.quantities,
            values={},
            targets=dict.fromkeys(self._targets),
            status=faults + self._origin_faults(),
            last_exposure_ns=frame_set.t_ns,
        )

    def _origin_faults(self) -> tuple[Fault, ...]:
        """Return one fault per reason; the frames' fault replaces that of the calibration."""
        faults = {fault.reason: fault for fault in (*self._calibration_origin, *self._provenance.origins())}
        return tuple(faults[reason] for reason in sorted(faults))


def calibration_faults(is_simulated: bool) -> tuple[Fault, ...]:
    """Return the faults that a calibration adds to each measurement; ``is_simulated``: simulated frames."""
    if not is_simulated:
        return ()
    return (Fault(Reason.SIMULATED, detail="the calibration was made from simulated frames"),)
