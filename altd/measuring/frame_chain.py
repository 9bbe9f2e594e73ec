"""The chain from frames to measurements that all instruments share, used by ``run`` and ``replay``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Generic, Protocol, TypeVar

from altd.config import Measuring
from altd.measuring.gate import Gate
from altd.measuring.instrument import NO_SOLUTION, Solution
from altd.measuring.pairing import Pair, Pairer
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, Frame, Measurement, NoSpot, Quantities, Spot

_SIMULATED = Fault(Reason.SIMULATED, detail="the calibration was made from simulated frames")


@dataclass(frozen=True, slots=True)
class RestPlace:
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
    place: Callable[[int], RestPlace | None] = lambda sequence: None


class Seen(Protocol):
    """Content of a frame: the spot of a beam (``Located``), or the lights of a plate."""

    @property
    def t_ns(self) -> int:
        """Middle of the exposure."""

    @property
    def spot(self) -> Spot | NoSpot | str:
        """Result for display."""


Item = TypeVar("Item", bound=Seen)
Found = TypeVar("Found", bound=Seen, covariant=True)


class Locator(Protocol[Found]):
    """One camera's part of a chain; one thread calls it, with one frame after the other."""

    def locate(self, frame: Frame) -> Found:
        """Return the content of a frame."""


class FrameChain(ABC, Generic[Item]):
    """Pairs frames, detects silence, and checks and finishes measurements; an instrument supplies the rest.

    ``locators`` return the content of a frame, by camera; ``measure`` turns those of a frame set into a
    measurement. Every measurement reports the origin of the frames, from ``provenance``, and whether the
    calibration is of simulated frames.

    ``push`` runs all steps. A daemon runs the three steps on separate threads: ``pairer`` makes frame sets,
    ``locators`` locate what they show, and ``add`` processes the results. The steps share only the figures
    that ``pairer`` counts.
    """

    def __init__(
        self,
        locators: Mapping[str, Locator[Item]],
        measuring: Measuring,
        provenance: Provenance,
        quantities: Quantities,
        targets: Sequence[str],
        is_simulated: bool,
    ) -> None:
        self.locators = locators
        self.pairer: Pairer[Frame] = Pairer(
            tuple(locators), measuring.pair_by, measuring.max_skew_ns, measuring.max_lag_ns
        )
        self.quantities = quantities
        self.silent_after_s = measuring.silent_after_s
        """Time without a frame after which a camera is silent, s."""
        self._silent_after_ns = round(measuring.silent_after_s * 1e9)
        self._provenance = provenance
        self._targets = tuple(targets)
        self._calibration_origin = (_SIMULATED,) if is_simulated else ()
        self._gate = Gate()
        self._last_sequence = 0
        self._last_ns: int | None = None
        self._now_ns = 0
        self.frame_sets = 0
        """Number of frame sets that were paired or given up, each later than the previous one."""

    @abstractmethod
    def seen(self) -> Mapping[str, str] | str:
        """Return the last finding of each target or camera as text; a sentence if there is none."""

    @abstractmethod
    def figures(self) -> Mapping[str, float | str | None]:
        """Return figures for health; None: not known."""

    @abstractmethod
    def measure(self, pair: Pair[Item]) -> Measurement | None:
        """Process the contents of a frame set; return the measurement that it completes, if any."""

    @abstractmethod
    def forget(self) -> None:
        """Drop what was collected for the next measurement: no measurement spans this moment."""

    def push(self, frame: Frame) -> list[Measurement]:
        """Process one frame; return the measurements that it completes. LED exposures are not measured."""
        return self._measured(self.pairer.add(frame.camera, frame.sequence, frame.t_ns, frame))

    def flush(self) -> list[Measurement]:
        """Settle frames that still wait for a partner, at the end of a recording; return measurements."""
        return self._measured(self.pairer.flush())

    def _measured(self, pairs: Sequence[Pair[Frame]]) -> list[Measurement]:
        measurements = (self.add(pair.converted(self.located)) for pair in pairs)
        return [measurement for measurement in measurements if measurement is not None]

    def located(self, frame: Frame) -> Item:
        """Return the content of one frame."""
        return self.locators[frame.camera].locate(frame)

    def add(self, pair: Pair[Item]) -> Measurement | None:
        """Process the contents of a frame set; start a new window after a silence or a step back in time."""
        self._now_ns = max(item.t_ns for item in pair.all_items)
        since_last_ns = 1 if self._last_ns is None else pair.t_ns - self._last_ns
        if not 0 < since_last_ns <= self._silent_after_ns:
            self.forget()
        self.frame_sets += since_last_ns > 0
        measurement = self.measure(pair)
        self._last_sequence, self._last_ns = pair.sequence, pair.t_ns
        return measurement

    def silence(self, t_ns: int) -> Measurement:
        """Start a new window; return the invalid measurement of an instant at which no camera delivers."""
        self._now_ns = t_ns
        self.forget()
        of = self._targets or (None,)
        silent = [Fault(Reason.CAMERA_SILENT, target, "no frame comes") for target in of]
        return self._finished(self._last_sequence, t_ns, t_ns, silent)

    def _finished(
        self,
        sequence: int,
        newest_ns: int,
        t_ns: int,
        faults: Iterable[Fault],
        frames: int = 0,
        solution: Solution = NO_SOLUTION,
    ) -> Measurement:
        """Return a measurement with the faults of its origin; if a check fails, without its numbers.

        ``sequence`` and ``newest_ns`` are those of the last exposure, ``t_ns`` is the mean time of ``frames``
        exposures. Without ``solution`` it has no numbers, even of targets with good spots: half a beam is no
        result.
        """
        return self._gate.admit(
            Measurement(
                sequence=sequence,
                t_ns=t_ns,
                time=self._provenance.utc(t_ns),
                frames=frames,
                quantities=self.quantities,
                values=solution.values,
                targets=solution.targets or dict.fromkeys(self._targets),
                status=(*faults, *self._origin_faults()),
                last_exposure_ns=newest_ns,
                motions=solution.motions,
                joint=solution.joint,
                cross_check=solution.cross_check,
            )
        )

    def _origin_faults(self) -> list[Fault]:
        """Return one fault per reason; the frames' fault replaces that of the calibration."""
        faults = {fault.reason: fault for fault in (*self._calibration_origin, *self._provenance.origins())}
        return [faults[reason] for reason in sorted(faults)]
