"""From frames to measurements of a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from altd.config import Measuring, RowSettings
from altd.instruments.row.displacement import BaselineMeans
from altd.instruments.row.instrument import RoundResult, RowInstrument
from altd.instruments.row.measurement import quantities_of, solution_of
from altd.instruments.row.rounds import Observation
from altd.measuring.calibration import Calibration
from altd.measuring.chain import View, spot_locators
from altd.measuring.frame_chain import FrameChain, Provenance
from altd.measuring.pairing import Pair
from altd.measuring.spot_locator import SpotLocator
from altd.records import Frame, Measurement


class ObservationLocator:
    """Locates the spot in each frame of a target's camera; one thread calls ``locate`` frame by frame."""

    def __init__(self, target: str, locator: SpotLocator) -> None:
        self.target, self._locator = target, locator

    def locate(self, frame: Frame) -> Observation:
        """Return the finding of a frame, with the target that was opaque then."""
        of = self._locator.locate(frame)
        return Observation(self.target, frame.opaque, of.sequence, of.t_ns, of.spot, of.breaks)


class RowChain(FrameChain[Observation]):
    """Measures a row of switched targets, one measurement per round. ``means`` is a stored baseline.

    Frames without an opaque target are not measured, because the glasses are settling. A round does not span
    a pause, nor a restart of the cameras' numbers.
    """

    def __init__(
        self,
        views: Sequence[View],
        calibration: Calibration,
        settings: RowSettings,
        measuring: Measuring,
        provenance: Provenance,
        means: BaselineMeans | None = None,
    ) -> None:
        locators = spot_locators(views, calibration, provenance)
        super().__init__(
            {view.camera: ObservationLocator(view.target, locators[view.camera]) for view in views},
            measuring,
            provenance,
            quantities_of(calibration.target_names),
            [view.target for view in views],
            calibration.simulated or (means is not None and means.simulated),
        )
        self._rounds = RowInstrument(calibration, settings, means)
        self._last: Mapping[str, Observation] = {}

    @property
    def baseline(self) -> BaselineMeans | None:
        """Means of the baseline; None while it is not complete."""
        return self._rounds.baseline

    def seen(self) -> dict[str, str] | str:
        """Last finding of the opaque target's camera, as text."""
        last = self._last.items()
        shown = {camera: str(one.spot) for camera, one in last if one.opaque == one.target}
        return shown or "the glasses settle"

    def figures(self) -> dict[str, float | str | None]:
        """Opaque target, for health; None while none has settled."""
        return {"opaque": next((one.opaque for one in self._last.values() if one.opaque), None)}

    def measure(self, pair: Pair[Observation]) -> Measurement | None:
        """Process the findings of one frame set; return the measurement of the round that it ends, if any."""
        if pair.sequence <= self._last_sequence:
            self.forget()
        self._last = pair.items
        shown = [replace(one, sequence=pair.sequence) for one in pair.items.values() if one.opaque]
        ended = [self._rounds.add(one) for one in shown]
        return next((self._of_round(result) for result in ended if result is not None), None)

    def forget(self) -> None:
        """Discard the unfinished round."""
        self._rounds.forget()
        self._last = {}

    def flush(self) -> list[Measurement]:
        """Return the measurements that are still due at the end of a recording."""
        return [*super().flush(), *map(self._of_round, self._rounds.flush())]

    def _of_round(self, of: RoundResult) -> Measurement:
        faults = [*of.status, *(fault for target in of.targets.values() for fault in target.status)]
        return self._finished(of.sequence, of.last_ns, of.t_ns, faults, of.frames, solution_of(of))
