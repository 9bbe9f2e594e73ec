"""Health of a camera from the reports of its thread; used in the event loop only."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass

from altd.acquisition.auto_exposure.control import Applied, ExposureFigures, Refused
from altd.records import counted
from altd.status.health import CameraTrouble, Component, State, duration

log = logging.getLogger("altd")

STALL_TIMEOUT_S = 0.6
"""Time without a frame or a timeout after which a driver counts as hanging in a call."""
_LOSS_DISPLAY_S = 1.0
"""Duration for which a lost or mistimed frame is reported."""


@dataclass(frozen=True, slots=True)
class Deliveries:
    """Deliveries of a camera so far, by the clock of the component; a new record after each frame.

    ``mistimed`` counts frames whose time cannot be true; ``remark`` gives the reason of the last one.
    ``returned_ns`` is when the driver last returned, ``frame_ns`` when it last returned a frame; before the
    first one, both are the start of acquisition. ``is_fresh``: a frame was delivered since the camera was
    opened and since the last timeout; ``is_late``: the last call timed out.
    """

    frame_ns: int
    returned_ns: int
    frames: int = 0
    lost: int = 0
    mistimed: int = 0
    remark: str = ""
    is_fresh: bool = False
    is_late: bool = False


class CameraReport:
    """Reports a camera's state in a component. ``waits``: the source waits until its frame is taken."""

    def __init__(self, component: Component, waits: bool) -> None:
        self._component = component
        self._waits = waits
        """Whether the source waits for its reader; a missing frame is then no fault."""
        self._is_open = False
        self._known = Deliveries(0, 0)
        self._losses: deque[tuple[int, int]] = deque()
        self._mistimed_ns: int | None = None
        self._automatic: tuple[str, ...] = ()
        self._refusal = ""
        self._logged_refusal = ""
        self._figures: ExposureFigures | None = None

    def opened(self, automatic: tuple[str, ...]) -> None:
        """Note that the camera was opened, with these ``automatic`` modes on; frames make its state OK."""
        self._is_open = True
        self._automatic = automatic
        self._refusal = ""

    def exposure_set(self, outcome: Applied | Refused) -> None:
        """Note whether the camera accepted an exposure setting or keeps the previous one."""
        self._refusal = outcome.complaint if isinstance(outcome, Refused) else ""
        if self._refusal:
            self._component.count("refused_exposures")
            if self._refusal != self._logged_refusal:
                self._logged_refusal = self._refusal
                log.warning("%s: exposure refused: %s", self._component.name, self._refusal)

    def failed(self, deliveries: Deliveries, sentence: str, trouble: CameraTrouble | None) -> None:
        """Report that the camera failed; it is closed, or could not be opened."""
        self.count(deliveries)
        self._is_open = False
        self._losses.clear()
        self._component.set_state(State.FAILED, f"{sentence}; trying again", trouble)
        self._component.count("failures")

    def ended(self, deliveries: Deliveries, sentence: str) -> None:
        """Report that the source has ended."""
        self.count(deliveries)
        self._is_open = False
        self._component.set_state(State.ENDED, sentence)

    def update(self, deliveries: Deliveries) -> None:
        """Report new and missing deliveries, and a driver that does not return."""
        self.count(deliveries)
        if not self._is_open:
            return
        now_ns = self._component.clock.monotonic_ns()
        if now_ns - deliveries.returned_ns > STALL_TIMEOUT_S * 1e9 and not self._waits:
            hangs = "the driver does not return; "
            self._report_silence(deliveries.frame_ns, CameraTrouble.DRIVER_HANGS, hangs)
        elif deliveries.is_late:
            self._report_silence(deliveries.frame_ns, CameraTrouble.NO_FRAMES)
        elif deliveries.is_fresh:
            self._report_delivery(deliveries, now_ns)

    def show(self, figures: ExposureFigures | None) -> None:
        """Publish new exposure figures; figures that were published before continue to age."""
        if figures is None or figures is self._figures:
            return
        self._figures = figures
        observed: dict[str, float | str | None] = {
            "exposure_control": figures.exposure_control,
            "level": figures.level,
        }
        if figures.exposure_ms is not None:
            observed["exposure_ms"] = figures.exposure_ms
        if figures.gain_db is not None:
            observed["gain_db"] = figures.gain_db
        self._component.observe(observed)
        if figures.changes:
            self._component.counters["exposure_changes"] = figures.changes

    def count(self, deliveries: Deliveries) -> None:
        """Count the deliveries since the last count; leave the state unchanged."""
        known, self._known = self._known, deliveries
        now_ns = self._component.clock.monotonic_ns()
        for counter in ("frames", "lost", "mistimed"):
            if more := getattr(deliveries, counter) - getattr(known, counter):
                self._component.count(counter, more)
        if deliveries.lost > known.lost:
            self._losses.append((now_ns, deliveries.lost - known.lost))
        if deliveries.mistimed > known.mistimed:
            self._mistimed_ns = now_ns

    def _report_silence(self, frame_ns: int, trouble: CameraTrouble, why: str = "") -> None:
        self._component.set_state(
            State.DEGRADED,
            lambda now_ns: f"{why}no frame for {duration((now_ns - frame_ns) * 1e-9)}",
            trouble,
        )

    def _report_delivery(self, deliveries: Deliveries, now_ns: int) -> None:
        oldest_ns = now_ns - _LOSS_DISPLAY_S * 1e9
        while self._losses and self._losses[0][0] < oldest_ns:
            self._losses.popleft()
        complaints = []
        if self._losses:
            lost = sum(number for _, number in self._losses)
            complaints.append(f"{counted(lost, 'frame')} lost in the last second")
        if self._mistimed_ns is not None and self._mistimed_ns >= oldest_ns:
            complaints.append(f"not measured: {deliveries.remark}")
        if self._refusal:
            complaints.append(f"exposure refused: {self._refusal}")
        trouble = CameraTrouble.EXPOSURE_REFUSED if self._refusal else None
        if self._automatic:
            trouble = trouble if complaints else CameraTrouble.AUTOMATIC
            complaints.append(f"stays on: {', '.join(self._automatic)}")
        self._component.set_state(State.DEGRADED if complaints else State.OK, "; ".join(complaints), trouble)
