"""Undetectable disturbances of a unit: the physical limits that depend on the unit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from benchmarks.campaign.units import UnitSpec

_RECORDED_RADIUS_MM = 6.0


@dataclass(frozen=True, slots=True)
class Subject:
    """Properties that determine the limits: 1/e² radius of the spots, and whether flats were recorded."""

    radius_mm: float
    has_flat: bool

    @classmethod
    def of(cls, spec: UnitSpec | None) -> Subject:
        """Properties of a simulated unit, or of the recorded one (None), which has no flat."""
        if spec is None:
            return cls(_RECORDED_RADIUS_MM, False)
        wide_mm, high_mm = spec.config.laser.diameters_mm
        return cls(math.sqrt(wide_mm * high_mm) / 2, spec.flat)

    @property
    def stretch_known_to(self) -> float:
        """Three sigmas of the difference in stretch between two targets' spots.

        Print and surface texture make a spot's stretch scatter by 0.2 % without a flat and by 0.06 % with
        one; targets that are not quite parallel add 0.1 %.
        """
        of_nodes = 0.0006 if self.has_flat else 0.002
        return 3 * math.sqrt(2 * of_nodes**2 + 0.001**2)


Undetectable = Callable[[Subject], str]
"""Reason why it cannot be detected on a unit; empty if it can."""


def always_detectable(subject: Subject) -> str:
    """Empty reason: it can be detected on every unit."""
    return ""


def _wherever(hides: Callable[[Subject], bool], reason: str) -> Undetectable:
    return lambda subject: reason if hides(subject) else ""


def near_on_one(share: float, far_mm: float) -> Undetectable:
    """A second spot on one target, merged with the first: a shift, except for the stretch p (1 − p) d²/4."""

    def hides(subject: Subject) -> bool:
        p, d = share / (1 + share), 2 * far_mm / subject.radius_mm
        return d <= 1.2 and p * (1 - p) * d * d / 4 <= subject.stretch_known_to

    return _wherever(
        hides,
        "a second light within 0.6 of the spot's 1/e² radius that stretches it by less than 0.9 % (0.4 % "
        "with a flat) looks like a shift, where it is there from the start or adds less than 5 % of the "
        "light. Error: share × distance, up to 0.5 mm",
    )


def near_on_both(far_mm: float) -> Undetectable:
    """A second spot beside both spots: equivalent to a laser of another shape, while the spots merge."""
    return _wherever(
        lambda subject: 2 * far_mm / subject.radius_mm <= 1.0,
        "a second light beside both spots within half their 1/e² radius looks like a laser of another "
        "shape. Error: share × distance, up to 1.5 mm for two equal spots 3 mm apart",
    )


def on_a_plate(cameras: frozenset[str]) -> Undetectable:
    """The view of a plain plate has moved, alone or with the window's view, whose shift may be small."""
    return _wherever(
        lambda subject: not subject.has_flat and "rear" in cameras,
        "a plain plate without a recorded flat has no features that show its camera's pose. Error: up to "
        "1° or 1 %, 0.5 mm on the plate, 0.1°. The frame LEDs show it (`altd selfcheck`)",
    )


def by_a_step_of_the_print(shift_px: float) -> Undetectable:
    """The view has moved by about the pitch of the print's dots."""
    return _wherever(
        lambda subject: shift_px >= 3.3,
        "a print shifted by one step of its dots (4 to 5 px, 0.9 mm) looks the same",
    )


def merged_on_a_plate(cameras: frozenset[str], far_px: float) -> Undetectable:
    """A plain plate appears doubled by less than half a spot's radius."""
    return _wherever(
        lambda subject: "front" not in cameras and far_px <= 0.6 * 4.7 * subject.radius_mm,
        "on a plain plate a picture doubled by less than half a spot looks like a shift. Error: "
        "share × distance, up to 2 mm. Surface texture is too faint to show it",
    )


def two_lamps_like_a_laser(widths_mm: Iterable[float]) -> Undetectable:
    """Two lamps without an edge, at two places that one beam can hit."""
    are_like = all(3 <= width_mm < 18 for width_mm in widths_mm)
    return _wherever(
        lambda subject: are_like,
        "two lamps without an edge, 3 to 18 mm wide, at two places that one beam can hit, look like its "
        "spots",
    )
