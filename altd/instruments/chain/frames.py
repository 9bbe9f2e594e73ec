"""From frames to measurements of a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from altd.config import ChainSettings, Measuring
from altd.instruments.chain.displacement import BaselineMeans
from altd.instruments.chain.instrument import Chain, RoundResult
from altd.instruments.chain.measurement import as_measurement, quantities_of
from altd.instruments.chain.rounds import Observation
from altd.measuring.calibration import Calibration
from altd.measuring.chain import Provenance, View, calibration_faults
from altd.measuring.gate import Gate
from altd.measuring.pairing import Pair, Pairer
from altd.measuring.spot_locator import SpotLocator
from altd.reasons import Reason
from altd.records import Fault, Frame, Measurement


class ObservationLocator:
    """Locates the spot in each frame of a target's camera; one thread calls ``locate`` frame by frame."""

    def __init__(self, target: str, locator: SpotLocator) -> None:
        self.target, self._locator = target, locator

    def locate(self, frame: Frame) -> Observation:
        """Return the finding of a frame, with the target that was opaque then."""
        of = self._locator.locate(frame)
        return Observation(self.target, frame.opaque, of.sequence, of.t_ns, of.spot, of.breaks, of.camera)


class RowChain:
    """Measures a row of switched targets, one measurement per round. ``means`` is a stored baseline.

    Frames without an opaque target are not measured, because the glasses are settling. ``push`` runs the
    whole chain; a daemon runs ``pairer``, ``locators`` and ``add`` in separate threads.
    """

    def __init__(
        self,
        views: Sequence[View],
        calibration: Calibration,
        settings: ChainSettings,
        measuring: Measuring,
        provenance: Provenance,
        means: BaselineMeans | None = None,
    ) -> None:
        self.quantities = quantities_of(calibration.target_names)
        self._rounds = Chain(calibration, settings, means)
        self._measuring, self._provenance = measuring, provenance
        is_simulated = calibration.simulated or (means is not None and means.simulated)
        self._calibration_origin = calibration_faults(is_simulated)
        cameras = tuple(view.camera for view in views)
        self.pairer: Pairer[Frame] = Pairer(
            cameras, measuring.pair_by, measuring.max_skew_ns, measuring.max_lag_ns
        )
        targets = {target.name: target for target in calibration.targets}
        self.locators: Mapping[str, ObservationLocator] = {
            view.camera: ObservationLocator(
                view.target,
                SpotLocator(
                    view.camera,
                    targets[view.target],
                    partial(provenance.identity, view.camera),
                    view.expected,
                    calibration.other_place_of,
                ),
            )
            for view in views
        }
        self.frame_sets = 0
        """Number of frame sets processed."""
        self._last: Mapping[str, Observation] = {}
        self._last_sequence = self._last_ns = 0
        self._gate = Gate()

    @property
    def silent_after_s(self) -> float:
        """Time without a frame after which a camera is silent, s."""
        return self._measuring.silent_after_s

    @property
    def baseline(self) -> BaselineMeans | None:
        """Means of the baseline; None while it is not complete."""
        return self._rounds.baseline

    def seen(self) -> dict[str, str] | str:
        """Last finding of the opaque target's camera, as text."""
        shown = {one.camera: str(one.spot) for one in self._last.values() if one.opaque == one.target}
        return shown or "the glasses settle"

    def figures(self) -> dict[str, float | str | None]:
        """Opaque target, for health; None while none has settled."""
        return {"opaque": next((one.opaque for one in self._last.values() if one.opaque), None)}

    def push(self, frame: Frame) -> Measurement | None:
        """Process one frame; return the measurement of a round, or None."""
        return self._take(self.locators[frame.camera].locate(frame))

    def add(self, pair: Pair[Observation]) -> Measurement | None:
        """Process the findings of one frame set; late frames are not measured.

        A round does not span a pause, nor a restart of the cameras' numbers.
        """
        since_last_s = (pair.t_ns - self._last_ns) * 1e-9
        if pair.sequence <= self._last_sequence or not 0.0 < since_last_s <= self.silent_after_s:
            self._rounds.forget()
        self.frame_sets += 1
        self._last, self._last_ns = pair.items, pair.t_ns
        measured = [self._take(replace(one, sequence=pair.sequence)) for one in pair.items.values()]
        return next(filter(None, measured), None)

    def flush(self) -> list[Measurement]:
        """Return the measurements that are still due at the end of a recording."""
        return [self._measurement(result) for result in self._rounds.flush()]

    def silence(self, t_ns: int) -> Measurement:
        """Return the measurement of a moment at which no camera delivers."""
        self._rounds.forget()
        self._last = {}
        silent = tuple(Fault(Reason.CAMERA_SILENT, target) for target in self._targets)
        return Measurement(
            sequence=self._last_sequence,
            t_ns=t_ns,
            time=self._provenance.utc(t_ns),
            frames=0,
            quantities=self.quantities,
            values={},
            targets=dict.fromkeys(self._targets),
            status=(*silent, *self._origins()),
        )

    def _take(self, observation: Observation) -> Measurement | None:
        self._last_sequence = observation.sequence
        if not observation.opaque:
            return None
        result = self._rounds.add(observation)
        return None if result is None else self._measurement(result)

    def _measurement(self, result: RoundResult) -> Measurement:
        time = self._provenance.utc(result.t_ns)
        return self._gate.admit(as_measurement(result, self.quantities, time, self._origins()))

    def _origins(self) -> tuple[Fault, ...]:
        faults = {fault.reason: fault for fault in (*self._calibration_origin, *self._provenance.origins())}
        return tuple(faults[reason] for reason in sorted(faults))

    @property
    def _targets(self) -> tuple[str, ...]:
        return tuple(locator.target for locator in self.locators.values())
