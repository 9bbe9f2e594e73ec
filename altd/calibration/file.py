"""The calibration file: one JSON document for one unit, checked by its own checksum."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from altd.calibration.file_tables import (
    FORMAT,
    CalibrationTable,
    MapTable,
    TargetTable,
    fingerprint_document,
    fingerprint_of,
    png_levels,
    png_text,
)
from altd.calibration.result import check_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of, parse_json
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import Calibration, CalibrationFile, TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.recording.header import RecordingHeader
from altd.records import CameraIdentity, FloatArray, Glass, Limits, utc_text
from altd.vision.flat import Flat
from altd.vision.settings import UNKNOWN_SPOT


def document_of(calibration: Calibration) -> dict[str, Any]:
    """The file's content as plain JSON types, without its checksum."""
    return {
        "format": FORMAT,
        "unit": {"serial": calibration.unit_serial},
        "created": utc_text(calibration.created),
        "recording": {"note": calibration.recording_note, "sha256": calibration.recording_sha256},
        "limits": _limits_document(calibration.limits),
        **({} if calibration.temperature_c is None else {"temperature_c": calibration.temperature_c}),
        "targets": [_target_document(target) for target in calibration.targets],
    }


def _limits_document(limits: Limits) -> dict[str, float | None]:
    """Return the limits; without ``temperature_k`` where it is not stated, for releases that lack it."""
    return {key: of for key, of in asdict(limits).items() if key != "temperature_k" or of is not None}


def _target_document(target: TargetCalibration) -> dict[str, Any]:
    return {
        "name": target.name,
        "z_mm": target.z_mm,
        "camera_serial": target.camera.serial,
        "camera_model": target.camera.model,
        "camera_driver": target.camera.driver,
        "origin": target.origin,
        "width": target.width,
        "height": target.height,
        "localiser": asdict(target.localiser),
        "flat": _flat_document(target.flat),
        "map": _map_document(target.map),
        "cross_check": {
            "map": _map_document(target.cross_check.map),
            "left_out_px": target.cross_check.leave_one_out_px,
            "bound_px": target.cross_check.limit_px,
            "largest_px": target.cross_check.max_difference_px,
        },
        "left_out_px": target.leave_one_out_px,
        "residuals": {
            "mean_mm": target.residual_mean_mm,
            "std_mm": target.residual_std_mm,
            "max_mm": target.residual_max_mm,
        },
        "repeatability_px": target.repeatability_px.tolist(),
        "leds_px": target.leds_px.tolist(),
        "spot": None if target.spot == UNKNOWN_SPOT else asdict(target.spot),
        "fingerprint": fingerprint_document(target.fingerprint),
        **_glass_document(target.glass),
    }


def _glass_document(glass: Glass | None) -> dict[str, float]:
    """Return the keys of the glass; none without glass, so that releases without them can read the file."""
    return {} if glass is None else {"glass_mm": glass.thickness_mm, "glass_index": glass.index}


def _flat_document(flat: Flat | None) -> dict[str, str] | None:
    if flat is None:
        return None
    return {"source": flat.source, "origin": flat.origin, "png": png_text(flat.levels)}


def _map_document(fitted: TensorMap) -> dict[str, Any]:
    return {
        "basis": "gram",
        "model": fitted.model,
        "x_axis": asdict(fitted.x_axis),
        "y_axis": asdict(fitted.y_axis),
        "degree": list(fitted.degree),
        "spectrum_u_px": fitted.spectra[0].tolist(),
        "spectrum_v_px": fitted.spectra[1].tolist(),
        "spread_u_px": fitted.covariance_factor_px[0].tolist(),
        "spread_v_px": fitted.covariance_factor_px[1].tolist(),
        "noise_px": fitted.noise_px,
        "noise_shape": list(fitted.noise_shape),
        "hull_mm": fitted.hull_mm.tolist(),
        "margin_mm": fitted.margin_mm,
        "beyond_px_per_mm": fitted.beyond_px_per_mm,
    }


def calibration_of(content: CalibrationTable) -> Calibration:
    """Build the calibration from a file's content; raises ValueError with the key of an invalid value."""
    return Calibration(
        unit_serial=content.unit.serial,
        created=content.created,
        recording_note=content.recording.note,
        recording_sha256=content.recording.sha256,
        limits=content.limits,
        temperature_c=content.temperature_c,
        targets=tuple(_from_target(target) for target in content.targets),
    )


def _from_target(target: TargetTable) -> TargetCalibration:
    flat = _from_flat(target)
    place = f"targets.{target.name}.fingerprint"
    return TargetCalibration(
        name=target.name,
        z_mm=target.z_mm,
        width=target.width,
        height=target.height,
        localiser=target.localiser,
        flat=flat,
        map=_from_map(f"targets.{target.name}.map", target.map),
        cross_check=CrossCheck(
            map=_from_map(f"targets.{target.name}.cross_check.map", target.cross_check.map),
            leave_one_out_px=target.cross_check.left_out_px,
            limit_px=target.cross_check.bound_px,
            max_difference_px=target.cross_check.largest_px,
        ),
        leave_one_out_px=target.left_out_px,
        residual_mean_mm=target.residuals.mean_mm,
        residual_std_mm=target.residuals.std_mm,
        residual_max_mm=target.residuals.max_mm,
        repeatability_px=np.array(target.repeatability_px),
        leds_px=np.array(target.leds_px).reshape(-1, 2),
        spot=UNKNOWN_SPOT if target.spot is None else target.spot,
        camera=CameraIdentity(target.camera_serial, target.camera_model, target.camera_driver),
        origin=target.origin,
        glass=None if target.glass_mm is None else Glass(target.glass_mm, target.glass_index),
        fingerprint=fingerprint_of(place, target.fingerprint, target.width, target.height, flat),
    )


def _from_flat(target: TargetTable) -> Flat | None:
    if target.flat is None:
        return None
    place = f"targets.{target.name}.flat.png"
    levels = png_levels(place, target.flat.png, target.width, target.height)
    return Flat(levels, target.flat.source, target.flat.origin)


def _from_map(place: str, content: MapTable) -> TensorMap:
    columns, rows = content.degree[0] + 1, content.degree[1] + 1
    return TensorMap(
        model=content.model,
        x_axis=content.x_axis,
        y_axis=content.y_axis,
        spectra=array_of(
            f"{place}.spectrum", [content.spectrum_u_px, content.spectrum_v_px], (2, rows, columns)
        ),
        covariance_factor_px=array_of(
            f"{place}.spread",
            [content.spread_u_px, content.spread_v_px],
            (2, rows * columns, len(content.spread_u_px[0]) if content.spread_u_px else 0),
        ),
        noise_px=content.noise_px,
        noise_shape=content.noise_shape,
        hull_mm=np.array(content.hull_mm),
        margin_mm=content.margin_mm,
        beyond_px_per_mm=content.beyond_px_per_mm,
    )


def array_of(place: str, values: list[Any], shape: tuple[int, ...]) -> FloatArray:
    """Return the numbers as an array; raises ValueError with ``place`` if they do not have this shape."""
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:
        array = np.empty(0)
    if array.shape != shape:
        raise ValueError(f"{place}: expected {' × '.join(map(str, shape))} numbers")
    return array


MAX_BYTES = 1 << 26
"""Maximum size of a file, bytes: that of two incompressible flats of 20 megapixels."""

_Z_TOLERANCE_MM = 1e-3

Parsed = TypeVar("Parsed")


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    write_file(path, content_of(document_of(calibration))[0])


def file_of(calibration: Calibration) -> CalibrationFile:
    """Hashes of the file that ``save_calibration`` writes."""
    content, checksum = content_of(document_of(calibration))
    return CalibrationFile(sha256(content).hexdigest(), checksum)


def content_of(document: Mapping[str, Any]) -> tuple[bytes, str]:
    """Content of the file of a document, and the checksum in it."""
    checksum = checksum_of(document)
    return (json.dumps({**document, "checksum": checksum}, indent=1) + "\n").encode(), checksum


def load_calibration(path: Path, unit_serial: str | None = None) -> Calibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""

    def checked(document: Any) -> Calibration:
        calibration = calibration_of(CalibrationTable.model_validate(document))
        check_calibration(calibration)
        return calibration

    calibration, file = read_document(path, FORMAT, checked)
    if unit_serial is not None and calibration.unit_serial != unit_serial:
        raise BadInputError(path, f"is for unit {calibration.unit_serial!r}, this is unit {unit_serial!r}")
    return replace(calibration, file=file)


def read_document(path: Path, form: str, parse: Callable[[Any], Parsed]) -> tuple[Parsed, CalibrationFile]:
    """Return the result of ``parse`` for the document in a file, and the hashes of the file.

    ``parse`` receives the document without its checksum. Raises BadInputError when format, checksum or
    content is wrong.
    """
    content = read_file(path, MAX_BYTES)
    try:
        document = parse_json(content)
    except ValueError as error:
        raise BadInputError(path, f"is not a calibration made by `altd calibrate`: {error}") from error
    if not isinstance(document, dict):
        raise BadInputError(path, "is not a calibration: no JSON object")
    if document.get("format") != form:
        raise BadInputError(path, f"format is {document.get('format')!r}, this altd reads {form!r}")
    checksum = document.pop("checksum", None)
    if checksum != checksum_of(document):
        raise BadInputError(path, "checksum does not match: the file is damaged or was edited")
    try:
        return parse(document), CalibrationFile(sha256(content).hexdigest(), str(checksum))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        value = f", not {first['input']}" if isinstance(first["input"], int | float) else ""
        raise BadInputError(path, f"{place}: {first['msg'].removeprefix('Value error, ')}{value}") from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error


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
    if glass is not None and glass != known.glass:
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
