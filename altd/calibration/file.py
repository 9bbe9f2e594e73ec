"""The calibration file: one JSON document for one unit, checked by its own checksum."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WrapSerializer,
)

from altd.calibration.file_tables import (
    ARRAY,
    FingerprintInFile,
    FlatInFile,
    MapInFile,
    Pixels,
    PositivePixels,
    Side,
    SpotInFile,
    UpTo1000,
    listed,
    table_of,
)
from altd.calibration.result import check_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of, parse_json
from altd.files.reading import read_file
from altd.files.record_tables import At, attributes_of, held_in, record_from
from altd.files.table import FAULTS, Celsius, Millimetres, Table
from altd.files.writing import write_file
from altd.measuring.calibration import Calibration, CalibrationFile, TargetCalibration
from altd.recording.header import RecordingHeader
from altd.records import GLASS_INDEX, CameraIdentity, Glass, Limits, Origin, utc_text
from altd.records.limits import LIMIT_KEYS, MAX_LIMIT, MAX_SCALE_PPM, NO_LIMITS, PLATE_KEYS
from altd.vision.settings import UNKNOWN_SPOT, SpotSettings

MAX_BYTES = 1 << 26
"""Maximum size of a file, bytes: that of two incompressible flats of 20 megapixels."""

_Z_TOLERANCE_MM = 1e-3


class _CrossCheck(Table):
    map: MapInFile
    left_out_px: Annotated[PositivePixels, At("leave_one_out_px")]
    bound_px: Annotated[PositivePixels, At("limit_px")]
    largest_px: Annotated[UpTo1000, At("max_difference_px")]


class _Residuals(Table):
    mean_mm: Annotated[UpTo1000, At("residual_mean_mm")]
    std_mm: Annotated[UpTo1000, At("residual_std_mm")]
    max_mm: Annotated[UpTo1000, At("residual_max_mm")]


class TargetTable(Table):
    """Entry of ``targets``; a target without glass has no keys of it, for releases that lack them."""

    name: str
    z_mm: Millimetres
    camera_serial: Annotated[str | None, At("camera.serial")]
    camera_model: Annotated[str | None, At("camera.model")] = None
    camera_driver: Annotated[str | None, At("camera.driver")] = None
    origin: Origin = Origin.CAMERA
    width: Side
    height: Side
    localiser: Annotated[SpotSettings, table_of(SpotSettings)]
    flat: FlatInFile | None
    map: MapInFile
    cross_check: _CrossCheck
    left_out_px: Annotated[PositivePixels, At("leave_one_out_px")]
    residuals: Annotated[_Residuals, At("")]
    repeatability_px: Annotated[tuple[UpTo1000, UpTo1000], *ARRAY]
    leds_px: Annotated[
        list[tuple[Pixels, Pixels]],
        AfterValidator(lambda px: np.array(px).reshape(-1, 2)),
        PlainSerializer(listed),
    ]
    spot: SpotInFile = UNKNOWN_SPOT
    fingerprint: FingerprintInFile | None = None
    glass_mm: Annotated[float | None, Field(ge=0, le=100), At("glass.thickness_mm", or_absent=True)] = None
    glass_index: Annotated[float, Field(ge=1, le=3), At("glass.index", or_absent=True)] = GLASS_INDEX


_Limit = Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None
_Limits = Annotated[
    Limits,
    table_of(
        Limits,
        **dict.fromkeys(LIMIT_KEYS, _Limit)
        | {"stage_scale_ppm": Annotated[float, Field(ge=0, le=MAX_SCALE_PPM)] | None}
        | {key: (Annotated[_Limit, At(key, or_absent=True)], None) for key in ("temperature_k", *PLATE_KEYS)},
    ),
]


class UnitTable(Table):
    """Table ``unit``."""

    serial: Annotated[str, At("unit_serial")]


class RecordingTable(Table):
    """Table ``recording``: the source of the calibration."""

    note: Annotated[str, At("recording_note")]
    sha256: Annotated[str, At("recording_sha256")]


class CalibrationTable(Table):
    """The whole file except its checksum; keys that it lacks if not known are new to older releases."""

    format: Literal["altd-calibration/1"]
    unit: Annotated[UnitTable, At("")]
    created: Annotated[datetime, PlainSerializer(utc_text)]
    recording: Annotated[RecordingTable, At("")]
    limits: _Limits = NO_LIMITS
    temperature_c: Annotated[Celsius | None, At("temperature_c", or_absent=True)] = None
    targets: Annotated[
        list[Annotated[TargetCalibration, held_in(TargetTable, TargetCalibration)]],
        Field(min_length=1),
        AfterValidator(tuple),
        WrapSerializer(lambda targets, write: write(list(targets))),
    ]


def _calibration_of(table: CalibrationTable, _: ValidationInfo) -> Calibration:
    calibration: Calibration = record_from(Calibration, attributes_of(table))
    check_calibration(calibration)
    return calibration


AnyCalibration = TypeVar("AnyCalibration")

FORMAT = "altd-calibration/1"
_FILE = TypeAdapter[Calibration](
    Annotated[Calibration, held_in(CalibrationTable, Calibration, _calibration_of)]
)


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    write_file(path, content_of(_FILE, calibration)[0])


def file_of(calibration: Calibration) -> CalibrationFile:
    """Hashes of the file that ``save_calibration`` writes."""
    content, checksum = content_of(_FILE, calibration)
    return CalibrationFile(sha256(content).hexdigest(), checksum)


def content_of(form: TypeAdapter[Any], calibration: object) -> tuple[bytes, str]:
    """Content of the file of a calibration, and the checksum in it."""
    document = form.dump_python(calibration, exclude_unset=True, warnings=False)
    checksum = checksum_of(document)
    return (json.dumps({**document, "checksum": checksum}, indent=1) + "\n").encode(), checksum


def load_calibration(path: Path, unit_serial: str | None = None) -> Calibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""
    return read_calibration(path, FORMAT, _FILE, unit_serial)


def read_calibration(
    path: Path, name: str, form: TypeAdapter[AnyCalibration], unit_serial: str | None
) -> AnyCalibration:
    """Read a calibration of the format ``name``; raises BadInputError as ``load_calibration``."""
    content = read_file(path, MAX_BYTES)
    try:
        document = parse_json(content)
    except ValueError as error:
        raise BadInputError(path, f"is not a calibration made by `altd calibrate`: {error}") from error
    if not isinstance(document, dict):
        raise BadInputError(path, "is not a calibration: no JSON object")
    if document.get("format") != name:
        raise BadInputError(path, f"format is {document.get('format')!r}, this altd reads {name!r}")
    checksum = document.pop("checksum", None)
    if checksum != checksum_of(document):
        raise BadInputError(path, "checksum does not match: the file is damaged or was edited")
    try:
        calibration: Any = form.validate_python(document)
    except ValidationError as error:
        raise BadInputError(path, _first_fault(document, error)) from error
    if unit_serial not in (None, calibration.unit_serial):
        raise BadInputError(path, f"is for unit {calibration.unit_serial!r}, this is unit {unit_serial!r}")
    file = CalibrationFile(sha256(content).hexdigest(), str(checksum))
    read: AnyCalibration = replace(calibration, file=file)
    return read


def _first_fault(document: Mapping[str, Any], error: ValidationError) -> str:
    """Describe the first fault with its place: by the target's name if its values contradict each other."""
    first = error.errors(include_url=False)[0]
    place, said = first["loc"], first["msg"].removeprefix("Value error, ")
    if first["type"] == FAULTS:
        keys, said = first["ctx"]["faults"][0]
        if place:
            place = ("targets", document["targets"][place[1]]["name"], *place[2:])
        place = (*place, *keys)
    elif isinstance(first["input"], int | float):
        said += f", not {first['input']}"
    return ": ".join(filter(None, [".".join(map(str, place)), said]))


def check_recording(calibration: Calibration, path: Path, header: RecordingHeader) -> None:
    """Refuse a recording whose targets, image size, camera or places differ from the calibration's."""
    for target in header.shown_targets:
        size = header.cameras[target.camera]
        check_image_size(calibration, path, target.name, size.width, size.height)
        check_camera(calibration, path, target.name, size.identity)
        if header.targets is not None:
            check_place(calibration, path, target.name, target.z_mm, target.glass)


def target_of(calibration: Calibration, path: Path, name: str) -> TargetCalibration:
    """Return the calibration of a target; refuse a name that the calibration does not contain."""
    known = calibration.target(name)
    if known is None:
        names = ", ".join(repr(target.name) for target in calibration.targets)
        raise BadInputError(path, f"does not know target {name!r}, only {names}")
    return known


def check_image_size(calibration: Calibration, path: Path, target: str, width: int, height: int) -> None:
    """Refuse frames whose size differs from the calibration's, and targets that it does not contain."""
    known = target_of(calibration, path, target)
    if (known.width, known.height) != (width, height):
        swapped = ": width and height are swapped" if (known.height, known.width) == (width, height) else ""
        raise BadInputError(
            path,
            f"target {target!r} was calibrated at {known.width} × {known.height}, not {width} × {height}"
            f"{swapped}",
        )


def check_place(
    calibration: Calibration, path: Path, target: str, z_mm: float, glass: Glass | None = None
) -> None:
    """Refuse a target whose place on the beam, or glass, differs from the calibration's.

    ``glass`` None: not stated; the calibration's glass applies.
    """
    known = calibration.target(target)
    if known is None:
        return
    if abs(known.z_mm - z_mm) > _Z_TOLERANCE_MM:
        raise BadInputError(path, f"target {target!r} was calibrated at z {known.z_mm:g} mm, not {z_mm:g}")
    is_none = glass is None or (known.glass is None and glass.thickness_mm == 0.0)
    if not is_none and glass != known.glass:
        calibrated = "without glass" if known.glass is None else f"with {known.glass}"
        raise BadInputError(
            path, f"target {target!r} was calibrated {calibrated} behind it, not with {glass}"
        )


def check_camera(calibration: Calibration, path: Path, target: str, camera: CameraIdentity) -> None:
    """Refuse a camera that differs from the one with which the target was calibrated."""
    known = calibration.target(target)
    if known is not None and (difference := camera.difference_from(known.camera)):
        difference += calibration.other_place_of(camera, target)
        raise BadInputError(path, f"target {target!r} was calibrated with another camera: {difference}")
