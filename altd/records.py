"""The nouns that travel from camera to publisher: frozen, slotted, units in their names.

Conventions (pixel origin, frames, signs, invalid values) are those of ``docs/conventions.md``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from altd.reasons import Reason, Scope

FloatArray = npt.NDArray[np.float64]
"""Vectors, matrices and covariances of the measuring chain."""

ComplexArray = npt.NDArray[np.complex128]
"""Waves and their amplitudes."""

PixelArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A frame's grey values, (rows, columns)."""


class Origin(StrEnum):
    """How frames came to be: light fell on a camera, or a simulator computed them.

    It travels with them: into recordings and calibrations, and what comes of simulated frames says so.
    """

    CAMERA = "camera"
    SIMULATED = "simulated"


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Which camera this is, as its driver tells; None: not known."""

    serial: str | None = None
    model: str | None = None
    driver: str | None = None

    def difference_from(self, expected: CameraIdentity) -> str:
        """What tells this camera from the expected one, in words; empty when nothing does.

        What one of the two does not know tells nothing, and another driver names cameras otherwise.
        """
        if None not in (self.driver, expected.driver) and self.driver != expected.driver:
            return ""
        for what in ("serial", "model"):
            is_, should_be = getattr(self, what), getattr(expected, what)
            if None not in (is_, should_be) and is_ != should_be:
                return f"its {what} is {is_!r}, expected {should_be!r}"
        return ""


@dataclass(frozen=True, slots=True)
class Fault:
    """One reason with the target it concerns (None: the whole unit) and a sentence for people."""

    reason: Reason
    target: str | None = None
    detail: str = ""

    def __str__(self) -> str:
        """The code that travels on the wires, such as ``front_spot_missing``."""
        return f"{self.target}_{self.reason}" if self.target else str(self.reason)


def origin_faults(origins: Mapping[str, Origin], played: Iterable[str] = ()) -> tuple[Fault, ...]:
    """The warnings that frames of these cameras bring into each measurement; ``played`` play a recording."""
    by_reason = {
        Reason.PLAYBACK: ("a recording is played", sorted(played)),
        Reason.SIMULATED: (
            "simulated frames",
            sorted(name for name, origin in origins.items() if origin is Origin.SIMULATED),
        ),
    }
    return tuple(
        Fault(reason, detail=f"{what}: {', '.join(names)}")
        for reason, (what, names) in by_reason.items()
        if names
    )


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One exposure of one camera.

    ``pixels`` is read-only, (rows, columns), uint8 or uint16 with ``bits`` significant bits;
    ``t_ns`` is the middle of the exposure on the monotonic clock; ``sequence`` counts the camera's exposures,
    those too that were lost. ``exposure_ms`` and ``gain_db`` are what the camera tells, else what it was set
    to, else None.
    ``changing``: exposure or gain was being set anew, nobody knows which of the two this frame has.
    ``playthrough`` counts how often a recording was played before: its pictures come again by intent.
    """

    camera: str
    sequence: int
    t_ns: int
    pixels: PixelArray
    bits: int = 8
    leds_on: bool = False
    exposure_ms: float | None = None
    gain_db: float | None = None
    changing: bool = False
    playthrough: int = 0

    @property
    def full_scale(self) -> int:
        """The largest grey value that a pixel can take."""
        return (1 << self.bits) - 1


@dataclass(frozen=True, slots=True)
class SpotShape:
    """The shape of a spot, E = peak · exp(−q^order), q = ½ (a du² + 2 b du dv + c dv²); a, b, c in 1/px²."""

    a: float
    b: float
    c: float
    order: float


@dataclass(frozen=True, slots=True)
class Spot:
    """A laser spot in one frame: centroid, its noise, 1/e² diameter, peak over background in counts.

    ``excess_px`` is the standard deviation, in u and in v, that light which one spot does not explain, and a
    picture that moved, add to that of a good spot; averaging does not reduce it. ``shape`` is None where no
    profile was fitted.
    """

    u_px: float
    v_px: float
    sigma_px: float
    diameter_px: float
    peak: float
    excess_px: float = 0.0
    shape: SpotShape | None = None

    def __str__(self) -> str:
        """For the technician who aims the beam."""
        return (
            f"spot at u {self.u_px:.1f} v {self.v_px:.1f} px, diameter {self.diameter_px:.0f} px, "
            f"peak {self.peak:.0f} counts"
        )


@dataclass(frozen=True, slots=True)
class NoSpot:
    """Why a frame gives no spot."""

    reason: Reason
    detail: str = ""

    def __str__(self) -> str:
        """For the technician who looks for what is wrong."""
        return f"{self.reason}, {self.detail}" if self.detail else str(self.reason)

    def fault(self, target: str) -> Fault:
        """The reason as a fault of the target, or of the whole unit where it concerns all of it."""
        return Fault(self.reason, target if self.reason.scope is Scope.TARGET else None, self.detail)


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """What the cameras saw at one instant: a spot, or the reason why there is none, per target.

    ``t_ns`` is the mean of the frames' times; a target that is not in ``behind_ns`` was exposed just then,
    another so much later.
    """

    sequence: int
    t_ns: int
    spots: Mapping[str, Spot | NoSpot]
    behind_ns: Mapping[str, int] = field(default_factory=dict)

    def faults(self) -> tuple[Fault, ...]:
        """Why this exposure cannot be used; empty when every target has its spot."""
        return tuple(spot.fault(target) for target, spot in self.spots.items() if isinstance(spot, NoSpot))


@dataclass(frozen=True, slots=True, eq=False)
class MeanSpots:
    """The mean spots of a window of exposures.

    ``px`` (targets, 2) holds u, v in the order of ``targets``; ``covariance_px2`` (2 · targets, 2 · targets)
    is that of the means, u and v of one target after the other: vibration moves all spots together.
    ``shapes`` holds the mean shape of each target's spots, None where one was not fitted, ``excess_px`` what
    averaging does not reduce of the sigma of each; the covariance holds it. ``t_ns`` is the mean time
    of the ``frames`` exposures that were averaged; ``lost`` were not usable.
    """

    targets: tuple[str, ...]
    px: FloatArray
    covariance_px2: FloatArray
    t_ns: int
    frames: int
    lost: int
    shapes: tuple[SpotShape | None, ...] = ()
    excess_px: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TargetPoint:
    """Where the beam meets one target, mm in the unit frame.

    ``jacobian_mm_per_px`` is d(x, y)/d(u, v) there; ``covariance_mm2`` (2 × 2) is what print, speckle and
    the map leave uncertain, without the scatter of the spot.
    """

    x_mm: float
    y_mm: float
    jacobian_mm_per_px: FloatArray
    covariance_mm2: FloatArray


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number that an instrument publishes.

    ``key`` names it in JSON and ends in the unit, ``label`` on screens; ``decimals`` are those of JSON, a
    person sees one less. ``has_sigma``: its standard deviation is published too. ``is_optional``: a valid
    measurement may be without it. ``is_also`` is the key of the quantity that this one is in another unit.
    """

    key: str
    label: str
    unit: str
    meaning: str
    decimals: int
    has_sigma: bool = True
    is_optional: bool = False
    is_also: str = ""


@dataclass(frozen=True, slots=True)
class Quantities:
    """What a kind of unit publishes: of the unit as a whole, and of each of its targets."""

    instrument: str
    of_unit: tuple[Quantity, ...]
    of_target: tuple[Quantity, ...] = ()

    @property
    def main(self) -> tuple[Quantity, ...]:
        """Those of the unit that every valid measurement has, each in one unit."""
        return tuple(each for each in self.of_unit if not (each.is_also or each.is_optional))


@dataclass(frozen=True, slots=True)
class Value:
    """A quantity's value with its standard deviation (1 sigma); None: it has none of its own."""

    value: float
    sigma: float | None = None


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the unit says about one window of exposures.

    ``sequence`` is that of the window's last exposure, ``t_ns`` the middle of the exposures that were
    averaged and ``time`` the same instant in UTC (None where the source of the frames does not know it).
    ``values`` holds the values of ``quantities`` by their keys, those that are known; it is empty when the
    measurement is invalid, and ``status`` then holds at least one reason that is not a warning. ``targets``
    holds the values of each target of the unit, None where not known.
    ``last_exposure_ns`` is the time of the window's last exposure; None: ``t_ns`` is.
    """

    sequence: int
    t_ns: int
    time: datetime | None
    frames: int
    quantities: Quantities
    values: Mapping[str, Value]
    targets: Mapping[str, Mapping[str, Value] | None]
    status: tuple[Fault, ...] = ()
    last_exposure_ns: int | None = None

    @property
    def light_ns(self) -> int:
        """When the newest light fell of which this tells."""
        return self.t_ns if self.last_exposure_ns is None else self.last_exposure_ns

    def without_numbers(self, status: tuple[Fault, ...]) -> Measurement:
        """The same moment, invalid for these reasons."""
        return replace(self, values={}, targets=dict.fromkeys(self.targets), status=status)

    @property
    def valid(self) -> bool:
        """Whether the numbers may be used."""
        return bool(self.values)

    def number(self, key: str) -> float | None:
        """The value of a quantity; None: not known."""
        value = self.values.get(key)
        return None if value is None else value.value

    def sigma(self, key: str) -> float | None:
        """The standard deviation of a quantity; None: not known."""
        value = self.values.get(key)
        return None if value is None else value.sigma


def utc_text(time: datetime) -> str:
    """ISO 8601 in UTC with milliseconds and ``Z``."""
    return time.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
