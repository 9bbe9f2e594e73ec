"""Identity of the unit, its targets, and the controller's signs and offsets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from altd.errors import escaped
from altd.files.table import Millimetres, Name, OffsetDegrees, Table, complaint
from altd.recording.header import TargetHeader, UnitHeader
from altd.records import GLASS_INDEX, Glass
from altd.records.limits import ALUMINIUM_PER_K


def _printable(serial: str) -> str:
    if not serial.isprintable():
        raise complaint(((), f"{escaped(serial)} has a character that is not printable"))
    return serial


class Unit(Table):
    """Identity of the unit."""

    serial: Annotated[str, Field(min_length=1, max_length=64), AfterValidator(_printable)]
    """Serial number, printable; must be that of the calibration."""
    calibration: Path
    """Path of the calibration file."""
    instrument: Literal["beam", "chain", "planar"] = "beam"
    """`beam`: the Active Laser Target; `chain`: a row of switched glass targets (`chain.md`); `planar`: one
    camera before a plate with LEDs (`planar.md`)."""
    kind: Literal["machine", "desk"] = "machine"
    """`desk`: a unit of webcams on a desk (`desk.md`), named so in status, page and identification; checks of
    parts that it does not have do not apply. No limit differs."""


class RowSettings(Table):
    """A row of switched glass targets on one beam, with `instrument = "chain"`."""

    stable: Annotated[tuple[Name, ...], Field(max_length=16)] = ()
    """Targets that do not move: they show the movement of the beam. Use at least two, far apart."""
    baseline_rounds: Annotated[int, Field(ge=1, le=1000)] = 5
    """Number of rounds in the baseline."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 4
    """Exposures of each target in a round."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Settling time of the glasses after switching, s. Before each switching, a random time of up to half of
    it is added."""
    baseline: Path | None = None
    """File of the baseline (`altd baseline`). The daemon makes it if it is missing. Default: in the service's
    own folder."""
    alarm_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Displacement from which a place has an alarm, mm; none: no alarm."""
    alarm_mm_per_day: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Speed of the last day from which a place has an alarm, mm/day; none: no alarm."""
    transmission: Annotated[float, Field(gt=0, le=1)] = 0.73
    """Share of the beam's power behind a clear glass."""
    laser_mw: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Power of the laser on the first target, mW."""
    min_mw: Annotated[float, Field(gt=0, le=1000)] = 0.02
    """Power that a target needs, mW."""


_OnPlate = Annotated[float, Field(ge=-10_000, le=10_000)]


class Plate(Table):
    """The plate before the camera, for `altd record`."""

    leds_mm: Annotated[tuple[tuple[_OnPlate, _OnPlate], ...], Field(min_length=5, max_length=64)]
    """Positions of the LEDs in the plate's frame, mm; in the camera's view, x is to the right and y up."""
    disc_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Diameter of an LED, mm; none: measured in the pictures."""

    @model_validator(mode="after")
    def _check_leds(self) -> Self:
        for number, place in enumerate(self.leds_mm):
            if (first := self.leds_mm.index(place)) < number:
                said = f"{list(place)} is already the place of leds_mm.{first}; choose another"
                raise complaint((("leds_mm",), said))
        return self


class Target(Table):
    """One target on the beam, in beam order."""

    name: Name
    """Name in the calibration and in all outputs; not a key of the measurement object."""
    z_mm: Millimetres
    """Distance from the front target's printed surface, along the beam, mm."""
    camera: Name
    """Name of its camera under ``[cameras]``."""
    glass_mm: Annotated[float, Field(ge=0, le=100)] | None = None
    """Thickness of the glass behind the printed surface, mm; 0: no glass; none: as calibrated. Glass
    displaces a slanted beam."""
    glass_index: Annotated[float, Field(ge=1, le=3)] | None = None
    """Refractive index of that glass at the laser's wavelength; 1.52 if only the thickness is given."""
    switched: bool = False
    """With `instrument = "beam"`: an electro-active glass, opaque for its own spot, clear for those behind
    (`chain.md`). All targets of a row are switched."""

    @model_validator(mode="after")
    def _check_glass(self) -> Self:
        if self.glass_index is not None and self.glass_mm is None:
            raise complaint(
                (("glass_index",), "there is no glass_mm; possible: with glass_mm, or without both")
            )
        return self

    @property
    def glass(self) -> Glass | None:
        """Glass behind the printed surface; None: not stated."""
        return None if self.glass_mm is None else Glass(self.glass_mm, self.glass_index or GLASS_INDEX)


def target_headers(targets: Iterable[Target]) -> tuple[TargetHeader, ...]:
    """Return a config's targets as in the header of a recording of its cameras."""
    return tuple(
        TargetHeader(
            name=of.name,
            z_mm=of.z_mm,
            camera=of.camera,
            glass_mm=of.glass_mm,
            glass_index=of.glass.index if of.glass else None,
            switched=of.switched or None,
        )
        for of in targets
    )


def unit_header(serial: str, targets: Sequence[Target]) -> UnitHeader:
    """Return the unit of a config; the distance is for readers that do not support ``targets``."""
    distance_mm = targets[-1].z_mm - targets[0].z_mm if targets else 0.0
    return UnitHeader(serial=serial, target_distance_mm=distance_mm or None)


_PpmPerK = Annotated[float, Field(ge=-100, le=100)]
_SigmaPpmPerK = Annotated[float, Field(gt=0, le=100)]


class Expansion(Table):
    """Linear thermal expansion (`budget.md`). A known one is corrected, one of 0 is in sigma alone."""

    distance_ppm_per_k: _PpmPerK = 0.0
    """Growth of the distances between the targets, ppm/K."""
    distance_sigma_ppm_per_k: _SigmaPpmPerK = 1e6 * ALUMINIUM_PER_K
    """Standard uncertainty of it; aluminium's expansion if nothing is known."""
    view_ppm_per_k: _PpmPerK = 0.0
    """Growth of the part of a target that a pixel sees, ppm/K, as the camera moves away. Not with
    `compensate`."""
    view_sigma_ppm_per_k: _SigmaPpmPerK = 1e6 * ALUMINIUM_PER_K
    """Standard uncertainty of it."""

    @property
    def is_corrected(self) -> bool:
        """Whether an expansion is known."""
        return bool(self.distance_ppm_per_k or self.view_ppm_per_k)


class Installation(Table):
    """Sign and zero for the controller: sign first, then offset."""

    reference_plane_mm: Millimetres = 0.0
    """Plane z of the displacement, mm."""
    sign_x: Literal[-1, 1] = 1
    """-1 reverses the axis."""
    sign_y: Literal[-1, 1] = 1
    sign_yaw: Literal[-1, 1] = 1
    sign_pitch: Literal[-1, 1] = 1
    offset_x_mm: Millimetres = 0.0
    """Offset, added after the sign."""
    offset_y_mm: Millimetres = 0.0
    offset_yaw_deg: OffsetDegrees = 0.0
    offset_pitch_deg: OffsetDegrees = 0.0
    thermometer: Name | None = None
    """Thermometer on the frame between the targets, a name in ``[[thermometers]]``: with the calibration's
    temperature, its expansion is corrected, or enters sigma."""
    expansion: Expansion = Expansion()

    @model_validator(mode="after")
    def _check_thermometer(self) -> Self:
        if self.expansion.is_corrected and self.thermometer is None:
            raise complaint((("expansion",), "is corrected by a thermometer; add installation.thermometer"))
        return self

    @property
    def signs(self) -> dict[str, Literal[-1, 1]]:
        """Sign of each quantity of the beam, by its key."""
        return {
            "x_mm": self.sign_x,
            "y_mm": self.sign_y,
            "yaw_deg": self.sign_yaw,
            "pitch_deg": self.sign_pitch,
        }


_Sigma = Annotated[float, Field(ge=0, le=45)]


class MachinePoint(Table):
    """A point of the machine, whose distance from the beam is published."""

    name: Name
    """Name in all outputs, as in `NAME_right_mm`."""
    x_mm: Millimetres
    """Place of the point from the middle of the front target, along the machine's axes, mm: to the right."""
    y_mm: Millimetres
    """The same, up."""
    z_mm: Millimetres
    """The same, along the beam: negative behind the front target, towards the total station."""
    sigma_mm: Annotated[float, Field(ge=0, le=1000)]
    """Standard uncertainty of each of the three, mm."""


class Machine(Table):
    """The machine that carries the unit, and its points (`machine.md`)."""

    roll_deg: Annotated[float, Field(ge=-180, le=180)] | None = None
    """Roll of the unit as surveyed, degrees, where no inclinometer is fitted."""
    roll_sigma_deg: _Sigma | None = None
    """Standard uncertainty of ``roll_deg``, degrees; needed with it."""
    beam_inclination_mm_per_m: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    """Inclination of the beam, mm/m, positive if it rises: the direction of the vertical depends on it."""
    beam_inclination_sigma_mm_per_m: Annotated[float, Field(gt=0, le=100)] | None = None
    """Standard uncertainty of it as surveyed, mm/m: with an inclinometer of two axes, the beam is compared
    with it (`inclinometer.md`); none: with its mean over the first ten minutes."""
    mount_yaw_deg: OffsetDegrees = 0.0
    """Direction of the unit's axis in the machine, degrees: to the right."""
    mount_pitch_deg: OffsetDegrees = 0.0
    """The same, up."""
    mount_roll_deg: OffsetDegrees = 0.0
    """Turn of the unit about its axis against the machine, degrees: clockwise as seen along the beam."""
    mount_sigma_deg: _Sigma | None = None
    """Standard uncertainty of each of the three, degrees; needed with points."""
    points: Annotated[tuple[MachinePoint, ...], Field(max_length=8)] = ()
    """Points of the machine, a table ``[[machine.points]]`` each."""

    @model_validator(mode="after")
    def _check_sigmas(self) -> Self:
        if self.roll_deg is not None and self.roll_sigma_deg is None:
            raise complaint((("roll_deg",), "its uncertainty is not stated; add roll_sigma_deg"))
        if self.points and self.mount_sigma_deg is None:
            raise complaint(
                (("points",), "the uncertainty of the mounting is not stated; add mount_sigma_deg")
            )
        return self
