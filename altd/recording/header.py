"""recording.json: contents of a recording, and its unit and cameras (docs/recordings.md)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from altd import __version__
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import read_file
from altd.files.table import NAME_PATTERN, Celsius
from altd.ports import Camera
from altd.recording.frames_table import MAX_POSITION_MM
from altd.records import GLASS_INDEX, CameraIdentity, Frame, Glass, Limits, Origin
from altd.records.frames import MAX_ROW_TIME_US
from altd.records.limits import MAX_LIMIT, MAX_SCALE_PPM

HEADER_FILE = "recording.json"
FRAMES_FILE = "frames.csv"

Kind = Literal["scan", "plate", "flat", "measurement", "self-check", "planar"]
"""Subject of a recording."""

MAX_HEADER_BYTES = 1 << 20

MADE_BY = f"altd {__version__}"

FRONT, REAR = "front", "rear"
"""Targets of a recording that does not list its targets, and the names of their cameras."""

Length = Annotated[float, Field(gt=0, le=MAX_POSITION_MM)]
Position = Annotated[float, Field(ge=-MAX_POSITION_MM, le=MAX_POSITION_MM)]


def _checked_year(start: datetime) -> datetime:
    if not 1970 <= start.year <= 2200:
        raise ValueError(f"the year {start.year} is not that of a recording")
    return start


def _checked_turn(degrees: float) -> float:
    if degrees not in (0.0, 180.0):
        raise ValueError("possible: 0, 180")
    return degrees


class _Header(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class CameraHeader(_Header):
    """Size and depth of one camera's frames."""

    width: Annotated[int, Field(ge=16, le=20_000)]
    height: Annotated[int, Field(ge=16, le=20_000)]
    bits: Annotated[int, Field(ge=8, le=16)]
    serial: str | None = None
    """Serial number of the camera, if its driver reports one."""
    model: str | None = None
    """The maker's name of the camera."""
    driver: str | None = None
    """Driver that reported them: ``driver`` of the config."""
    origin: Origin = Origin.CAMERA
    """Origin of the camera's frames."""
    exposure_ms: float | None = None
    """Exposure time of the first frame, ms, if the driver reports it; it is constant in a recording."""
    gain_db: float | None = None
    row_time_us: Annotated[float, Field(ge=-MAX_ROW_TIME_US, le=MAX_ROW_TIME_US)] | None = None
    """Delay of a row's exposure after the row above, µs; None: all rows at once."""
    mirrored: bool | None = None
    """Whether the camera's view of its target is mirrored, if unusual: see a plate's calibration."""

    @property
    def identity(self) -> CameraIdentity:
        """Identity of the camera, as far as the recording contains it."""
        return CameraIdentity(self.serial, self.model, self.driver)


def camera_header(frame: Frame, camera: Camera | None) -> CameraHeader:
    """Return the header of an open camera that delivers such frames."""
    known = (camera.identity if camera else None) or CameraIdentity()
    rows, columns = frame.pixels.shape
    return CameraHeader(
        width=columns,
        height=rows,
        bits=frame.bits,
        serial=known.serial,
        model=known.model,
        driver=known.driver,
        origin=camera.origin if camera else Origin.CAMERA,
        exposure_ms=frame.exposure_ms,
        gain_db=frame.gain_db,
        row_time_us=frame.row_time_us or None,
    )


def note_of(command: str, cameras: Collection[Camera]) -> str:
    """Return the note of a command's recording: its name, and ``playback`` or ``simulated``."""
    played = any(camera.playback for camera in cameras)
    simulated = any(camera.origin is Origin.SIMULATED for camera in cameras)
    return f"{command}{', playback' * played}{', simulated' * simulated}"


class UnitHeader(_Header):
    """The recorded unit."""

    serial: str
    target_distance_mm: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Distance from the front target to the rear one, mm; required if the header has no ``targets``."""


class TargetHeader(_Header):
    """A target in the recording, its position on the beam, mm, and its camera."""

    name: Annotated[str, Field(pattern=NAME_PATTERN, max_length=32)]
    z_mm: Annotated[float, Field(ge=-100_000, le=100_000)]
    camera: str
    glass_mm: Annotated[float, Field(ge=0, le=100)] | None = None
    """Thickness of the glass behind it, mm, if the recording contains it."""
    glass_index: Annotated[float, Field(ge=1, le=3)] | None = None
    switched: bool | None = None
    """Switched target of a beam: opaque in the rows that name it ``opaque``, else clear."""

    @property
    def glass(self) -> Glass | None:
        """Glass behind the target; None: not stated."""
        return None if self.glass_mm is None else Glass(self.glass_mm, self.glass_index or GLASS_INDEX)


GLASS_DEPTH_MM = 1.0
"""Standard uncertainty of the depth of a screen's pixels behind its glass as seen by a camera, mm."""


class PlacedHeader(_Header):
    """Uncertainty of a plate's place and angle on its target, 1 sigma per axis; distance of the camera."""

    sigma_mm: Annotated[float, Field(ge=0, le=100)]
    sigma_deg: Annotated[float, Field(ge=0, le=30)]
    camera_mm: Annotated[float, Field(ge=20, le=100_000)]


class PlateHeader(_Header):
    """A grid of lit LEDs; ``origin_mm`` is the LED with the smallest x and the smallest y.

    ``disc_mm`` is the diameter of an LED's even disc, ``beam_mm`` the 1/e² diameter of the laser spot that
    will be measured. ``pitch_sigma_mm`` is the standard uncertainty of the pitch, ``placed`` how well the
    plate lies on the target.
    """

    columns: Annotated[int, Field(ge=4, le=100)]
    rows: Annotated[int, Field(ge=4, le=100)]
    pitch_mm: Length
    origin_mm: tuple[Position, Position]
    disc_mm: Length | None = None
    beam_mm: Annotated[float, Field(ge=0, le=50)] = 12.0
    pitch_sigma_mm: Annotated[float, Field(ge=0)] | None = None
    placed: PlacedHeader | None = None

    @model_validator(mode="after")
    def _check_sigma(self) -> Self:
        if (self.pitch_sigma_mm or 0.0) > MAX_SCALE_PPM * 1e-6 * self.pitch_mm:
            raise ValueError(f"pitch_sigma_mm: {self.pitch_sigma_mm:g} exceeds a twentieth of pitch_mm")
        return self

    @property
    def limits(self) -> Limits:
        """Uncertainties of the places of the LEDs on the target, as far as they are stated."""
        stated: dict[str, float] = {}
        depth = 0.0
        if of := self.placed:
            depth = GLASS_DEPTH_MM / of.camera_mm
            angle = math.radians(of.sigma_deg)
            stated = {"stage_mm": 0.0, "stage_square_mrad": 0.0}
            stated |= {"plate_mm": of.sigma_mm, "plate_turn_mrad": 1e3 * angle}
            stated["plate_keystone_per_m"] = 1e3 * angle / of.camera_mm
        if self.pitch_sigma_mm is not None:
            stated["stage_scale_ppm"] = 1e6 * math.hypot(self.pitch_sigma_mm / self.pitch_mm, depth)
        return Limits(**stated)


class LedPlateHeader(_Header):
    """A plate with lit LEDs at ``leds_mm`` in its own frame, x right and y up in the camera's view.

    ``disc_mm`` is the diameter of an LED's even disc; None: measured in the pictures.
    """

    leds_mm: Annotated[tuple[tuple[Position, Position], ...], Field(min_length=5, max_length=64)]
    disc_mm: Length | None = None

    @model_validator(mode="after")
    def _check_leds(self) -> Self:
        for number, place in enumerate(self.leds_mm):
            if place in self.leds_mm[:number]:
                first = self.leds_mm.index(place)
                raise ValueError(f"leds_mm.{number}: {list(place)} is the place of leds_mm.{first} too")
        return self


def _plate_tag(plate: object) -> str:
    is_of_leds = "leds_mm" in plate if isinstance(plate, dict) else isinstance(plate, LedPlateHeader)
    return _LEDS if is_of_leds else _GRID


_LEDS, _GRID = "with leds_mm", "with a grid"
"""Tags of the two kinds of plate; pydantic puts them into an error's place."""


class SelfCheckHeader(_Header):
    """The result of the self-check before a scan."""

    verdict: Literal["good", "suspect", "bad", "unknown"]
    reasons: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    """Other observations, such as a light that blinks independently of the LEDs."""


class RecordingHeader(_Header):
    """``recording.json``; unknown keys are ignored."""

    format: Literal["altd-recording/1"]
    kind: Kind
    fps: Annotated[float, Field(ge=0.001, le=100_000)]
    cameras: Annotated[Mapping[str, CameraHeader], Field(min_length=1)]
    unit: UnitHeader
    note: str = ""
    made_by: str | None = None
    """Program that wrote it, with its version."""
    start: Annotated[datetime, AfterValidator(_checked_year)] | None = None
    """UTC of t_s = 0, if known."""
    plate: (
        Annotated[
            Annotated[PlateHeader, Tag(_GRID)] | Annotated[LedPlateHeader, Tag(_LEDS)],
            Discriminator(_plate_tag),
        ]
        | None
    ) = None
    """Plate: in a recording of kind ``plate`` a grid, of kind ``planar`` the LEDs' positions."""
    self_check: SelfCheckHeader | None = None
    """Self-check of a ``scan``, if there was a calibration for it."""
    turned_deg: Annotated[float, AfterValidator(_checked_turn)] = 0.0
    """Turn of the unit about its own z axis in a ``scan``, degrees; stage and beam were not moved."""
    seat_mm_per_m: Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None = None
    """Scatter of the unit's z axis from one seating to the next, 1 sigma per axis; None: not stated."""
    deflection_yaw_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Known deflection of the beam to +x of the stage, degrees."""
    deflection_pitch_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """The same to +y, degrees."""
    deflection_sigma_deg: Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None = None
    """Standard uncertainty of the deflection, per axis; None: not stated."""
    limits: Limits | None = None
    """Uncertainties of a ``scan`` that it cannot measure."""
    temperature_c: Celsius | None = None
    """Temperature of the frame in a ``scan``, °C."""
    targets: Annotated[tuple[TargetHeader, ...], Field(min_length=1)] | None = None
    """Targets in beam order; None: those of ``shown_targets``."""

    @model_validator(mode="before")
    @classmethod
    def _check_planar(cls, content: Any) -> Any:
        """Raise unless a recording of kind ``planar`` has the plate's LEDs and one camera."""
        if not isinstance(content, dict) or content.get("kind") != "planar":
            return content
        plate, cameras = content.get("plate"), content.get("cameras")
        if plate is None or _plate_tag(plate) != _LEDS:
            raise ValueError("plate.leds_mm: Field required in a recording of kind 'planar'")
        if isinstance(cameras, dict) and len(cameras) > 1:
            raise ValueError(f"cameras: a recording of kind 'planar' has one, not {len(cameras)}")
        return content

    @model_validator(mode="after")
    def _check_targets(self) -> Self:
        if self.targets is None:
            if self.unit.target_distance_mm is None and self.kind != "planar":
                raise ValueError("unit.target_distance_mm: Field required where there are no targets")
            return self
        for key in ("name", "camera"):
            values = [getattr(target, key) for target in self.targets]
            for number, value in enumerate(values):
                if value in values[:number]:
                    first = values.index(value)
                    raise ValueError(f"targets.{number}.{key}: {value!r} is already that of targets.{first}")
        for number, target in enumerate(self.targets):
            if target.camera not in self.cameras:
                raise ValueError(f"targets.{number}.camera: {target.camera!r} is not one of the cameras")
        for number, (nearer, target) in enumerate(itertools.pairwise(self.targets), start=1):
            if target.z_mm <= nearer.z_mm:
                raise ValueError(
                    f"targets.{number}.z_mm: {target.z_mm:g} must exceed z_mm of "
                    f"targets.{number - 1}, {nearer.z_mm:g}"
                )
        return self

    @property
    def shown_targets(self) -> tuple[TargetHeader, ...]:
        """Targets in the recording, in beam order.

        If it does not list them: ``front`` at 0 and ``rear`` behind it, as far as their cameras exist.
        """
        if self.targets is not None:
            return self.targets
        places_mm = {FRONT: 0.0, REAR: self.unit.target_distance_mm or 0.0}
        return tuple(
            TargetHeader(name=name, z_mm=z_mm, camera=name)
            for name, z_mm in places_mm.items()
            if name in self.cameras
        )

    @property
    def is_switched(self) -> bool:
        """Whether the recording is of a beam whose targets are shown in turn."""
        return any(target.switched for target in self.shown_targets)

    def is_mirrored(self, target: TargetHeader) -> bool:
        """Whether the camera's view of the target is mirrored: as in its header, else only for ``front``."""
        said = self.cameras[target.camera].mirrored
        return target.name == FRONT if said is None else said


def read_header(path: Path) -> RecordingHeader:
    """Return the header in a file; raises BadInputError with the file and the key."""
    content = read_file(path, MAX_HEADER_BYTES)
    try:
        return RecordingHeader.model_validate(parse_json(content))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"] if part not in (_LEDS, _GRID))
        message = first["msg"].removeprefix("Value error, ")
        if first["loc"] == ("kind",) and isinstance(first["input"], str):
            message = f"{first['input']!r} is not possible; possible: {', '.join(get_args(Kind))}"
        elif isinstance(first["input"], int | float):
            message += f", not {first['input']}"
        raise BadInputError(path, f"{place}: {message}" if place else message) from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
