"""The chain of an instrument that averages spots: from the frames of its targets to measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from altd.config import Measuring
from altd.measuring.averaging import FrameSetWindow, Window
from altd.measuring.calibration import Calibration
from altd.measuring.frame_chain import FrameChain, Provenance, RestPlace
from altd.measuring.instrument import Instrument
from altd.measuring.light_balance import LightBalance
from altd.measuring.motion_memory import MotionMemory
from altd.measuring.pairing import Pair
from altd.measuring.sampling import MIN_EXPOSURES, SamplingCheck, ScatterMemory
from altd.measuring.spot_locator import Located, SpotLocator
from altd.measuring.synchrony import SynchronyCheck
from altd.measuring.view_check import shift_fault
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, FaultCause, FrameSet, MeanSpots, Measurement, NoSpot, Spot

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


def spot_locators(
    views: Sequence[View], calibration: Calibration, provenance: Provenance, is_switched: bool = False
) -> dict[str, SpotLocator]:
    """Return the locators of the targets' spots, by camera; ``is_switched`` as in ``SpotLocator``."""
    targets = {target.name: target for target in calibration.targets}
    return {
        view.camera: SpotLocator(
            view.camera,
            targets[view.target],
            partial(provenance.identity, view.camera),
            view.expected,
            calibration.other_place_of,
            is_switched,
        )
        for view in views
    }


_UNKNOWN = Provenance()


class MeasuringChain(FrameChain[Located]):
    """Averages the spots of the frames, maps them and fits the beam; pure but for its memory of the window.

    ``switched`` is the window of a unit with a switched front target: a frame set shows only the opaque
    target, and one without an opaque target is not measured. None: each frame set shows all targets.
    ``correct`` removes a known drift of the cameras from the mean spots, before they are mapped.
    """

    locators: Mapping[str, SpotLocator]

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
        self._target_of = {view.camera: view.target for view in views}
        self._is_switched = switched is not None
        super().__init__(
            spot_locators(views, calibration, provenance, self._is_switched),
            measuring,
            provenance,
            instrument.quantities,
            tuple(self._target_of.values()),
            calibration.simulated,
        )
        self._instrument = instrument
        self._is_of_now = measuring.output == "now"
        self._scatter = ScatterMemory()
        self._window = switched or FrameSetWindow(
            self._targets, measuring.window, measuring.every, self._scatter
        )
        self._last_place: RestPlace | None = None
        self._view_status = {camera: locator.view for camera, locator in self.locators.items()}
        self._synchrony = SynchronyCheck(self._targets)
        self._sampling = SamplingCheck()
        lights = {target.name: target.spot.light for target in calibration.targets}
        self._light_balance = LightBalance([lights[target] for target in self._targets])
        self._changed_light: tuple[float, ...] = ()
        self._motion_memory = MotionMemory()
        self._correct = correct
        self._breaks_in_window = dict.fromkeys(self._target_of, 0)
        self._last_spots: dict[str, Spot | NoSpot] = {}
        self._last_skew_ns: int | None = None
        """Skew of the last frame set; None if it had too few frames to determine it."""
        self._last_frame_ns: dict[str, int] = {}

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
        first = next(iter(self.locators))
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
        return {camera for camera in self.locators if self._last_frame_ns.get(camera, oldest_ns) <= oldest_ns}

    def measure(self, pair: Pair[Located]) -> Measurement | None:
        """Process the spots of one frame set; return the measurement that it completes, if any."""
        for located in pair.all_items:
            self._last_frame_ns[located.camera] = located.t_ns
            if located.is_shown and not located.leds_on:
                self._last_spots[self._target_of[located.camera]] = located.spot
            self._view_status[located.camera] = located.view
        if self._is_skipped(pair):
            self._window.skip(pair.sequence)
            return None
        return self._after(self._frame_set(pair))

    def forget(self) -> None:
        """Clear the window and what is known of the cameras' synchronism: they may have been restarted."""
        self._window.forget()
        self._synchrony.restart()

    def silence(self, t_ns: int) -> Measurement:
        """Clear the window; return the invalid measurement of an instant at which no camera delivers."""
        self._last_skew_ns = None
        self._last_frame_ns.clear()
        self._last_spots = dict.fromkeys(self._targets, _SILENT)
        self._changed_light = ()
        return super().silence(t_ns)

    def _is_skipped(self, pair: Pair[Located]) -> bool:
        """Return whether frame LEDs were lit, or LEDs or targets switched, in any frame of a frame set.

        Such a frame set continues the time, so it leaves no gap in which anything may have happened. It is
        not part of the window, whose length is counted by the frame sets' numbers.
        """
        opaque = {located.opaque for located in pair.all_items}
        is_settling = self._is_switched and (len(opaque) > 1 or "" in opaque)
        return is_settling or any(located.leds_on for located in pair.items.values())

    def _frame_set(self, pair: Pair[Located]) -> FrameSet:
        """Return the spots of one instant.

        Clears the window at a new place and after a break in a camera's frames (``Located.breaks``).
        """
        spots: dict[str, Spot | NoSpot] = {}
        if (place := self._provenance.place(pair.sequence)) != self._last_place:
            self._last_place = place
            self._window.begin(place.window if place else None)
        self._last_skew_ns = None if len(pair.items) == 1 < len(self.locators) else pair.skew_ns
        for camera, target in self._target_of.items():
            if camera in pair.items:
                located = pair.items[camera]
                spots[target] = located.spot
                if located.breaks != self._breaks_in_window[camera]:
                    self._breaks_in_window[camera] = located.breaks
                    self._window.forget()
            else:
                spots[target] = self._last_spots[target] = self._why_missing(pair.missing[camera])
        rows_ns = {camera: located.behind_ns for camera, located in pair.items.items()}
        mean_ns = round(sum(rows_ns.values()) / max(len(rows_ns), 1))
        behind_ns = {
            self._target_of[camera]: late_ns + rows_ns.get(camera, mean_ns) - mean_ns
            for camera, late_ns in pair.behind_ns.items()
        }
        return FrameSet(pair.sequence, pair.t_ns + mean_ns, spots, behind_ns, pair.all_items[0].opaque)

    def _why_missing(self, reason: Reason) -> NoSpot:
        """Return the reason; ``out_of_step`` gets the known figures of the cameras' synchronism as detail."""
        if reason is not Reason.OUT_OF_STEP:
            return _SILENT
        known = {name: value for name, value in self.step().items() if value is not None}
        return NoSpot(reason, ", ".join(f"{name} {value:g}" for name, value in known.items()))

    def _after(self, frame_set: FrameSet) -> Measurement | None:
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
        span_s = mean.motion.span_s if mean.motion else 0.0
        motions = self._motion_memory.add(mean.t_ns, frame_set.t_ns, span_s, solution.motions)
        solution = replace(solution, motions=motions, joint=self._motion_memory.joined(solution.joint))
        published = solution.with_motion_in_sigma() if self._is_of_now else solution
        if published is None:
            return self._invalid(frame_set, spots.t_ns, (_MOTION_UNKNOWN,))
        return self._finished(frame_set.sequence, frame_set.t_ns, spots.t_ns, lost, mean.frames, published)

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

    def _invalid(self, newest: FrameSet, t_ns: int, faults: tuple[Fault, ...]) -> Measurement:
        return self._finished(newest.sequence, newest.t_ns, t_ns, faults)
