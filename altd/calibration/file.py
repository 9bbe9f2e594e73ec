"""The calibration file: one JSON document for one unit, checked by its own checksum."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from altd.calibration.fingerprint_file import FingerprintTable, as_document, from_table
from altd.calibration.soundness import check_calibration
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.picture import decode_png
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.mapping.grid import Axis
from altd.mapping.tensor_map import Model, TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.records import CameraIdentity, FloatArray, Origin, utc_text
from altd.vision.flat import Flat, Source
from altd.vision.reference import UNKNOWN_SPOT, ShapeReference, SpotReference
from altd.vision.settings import Method, SpotSettings

FORMAT = "altd-calibration/1"

_LARGEST_BYTES = 1 << 26
"""Two flats of 20 megapixels that no compression makes smaller."""

_SAME_Z_MM = 1e-3

Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
Pixels = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A place in or about a picture of at most 20 000 px."""
PositivePixels = Annotated[float, Field(gt=0, le=1000)]
"""A misfit, a noise, a limit."""
Coefficient = Annotated[float, Field(ge=-1e7, le=1e7)]
"""A place in px times the root of a grid's number of nodes: the Gram polynomials are orthonormal."""
Side = Annotated[int, Field(ge=16, le=20_000)]
_Feature = Annotated[float, Field(ge=-10, le=10)]
_Scatter = Annotated[float, Field(ge=0, le=10)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Axis(_Table):
    first_mm: Millimetres
    step_mm: Annotated[float, Field(gt=0, le=10_000)]
    nodes: Annotated[int, Field(ge=2, le=10_000)]


class _Map(_Table):
    basis: Literal["gram"]
    model: Model
    x_axis: _Axis
    y_axis: _Axis
    degree: tuple[Annotated[int, Field(ge=0, le=100)], Annotated[int, Field(ge=0, le=100)]]
    spectrum_u_px: list[list[Coefficient]]
    spectrum_v_px: list[list[Coefficient]]
    spread_u_px: list[list[Coefficient]]
    spread_v_px: list[list[Coefficient]]
    noise_px: PositivePixels
    hull_mm: Annotated[list[tuple[Millimetres, Millimetres]], Field(min_length=3)]
    margin_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    beyond_px_per_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0


class _CrossCheck(_Table):
    map: _Map
    left_out_px: PositivePixels
    bound_px: PositivePixels
    largest_px: Annotated[float, Field(ge=0, le=1000)]


class _Residuals(_Table):
    mean_mm: Annotated[float, Field(ge=0, le=1000)]
    std_mm: Annotated[float, Field(ge=0, le=1000)]
    max_mm: Annotated[float, Field(ge=0, le=1000)]


class _Localiser(_Table):
    method: Method
    smoothing_px: Annotated[float, Field(ge=0, le=100)]
    threshold: Annotated[float, Field(gt=0, lt=1)]
    power: Annotated[float, Field(gt=0, le=10)]
    min_diameter_px: Annotated[float, Field(gt=0, le=10_000)]
    max_diameter_px: Annotated[float, Field(gt=0, le=20_000)] | None
    max_aspect: Annotated[float, Field(ge=1, le=100)]
    min_fill: Annotated[float, Field(ge=0, le=1)]
    like_size: Annotated[float, Field(gt=0, le=1)]
    max_saturated: Annotated[float, Field(ge=0, le=1)]
    max_sigma_px: PositivePixels
    full_well_electrons: Annotated[float, Field(ge=100, le=10_000_000)]


class _Flat(_Table):
    source: Source
    origin: Origin = Origin.CAMERA
    png: str


class _Shape(_Table):
    mean: tuple[_Feature, _Feature, _Feature, Annotated[float, Field(gt=0, le=1000)]]
    sigma: tuple[_Scatter, _Scatter, _Scatter, _Scatter]


class _Spot(_Table):
    grain: Annotated[float, Field(gt=0, le=10)] | None
    misfit_ratio: Annotated[float, Field(ge=1, le=1000)]
    pattern_px: Annotated[float, Field(ge=0, le=100)] | None
    noise_px: Annotated[float, Field(ge=0, le=100)]
    shape: _Shape | None


class _Target(_Table):
    name: str
    z_mm: Millimetres
    camera_serial: str | None
    camera_model: str | None = None
    camera_driver: str | None = None
    origin: Origin = Origin.CAMERA
    width: Side
    height: Side
    localiser: _Localiser
    flat: _Flat | None
    map: _Map
    cross_check: _CrossCheck
    left_out_px: PositivePixels
    residuals: _Residuals
    repeatability_px: tuple[Annotated[float, Field(ge=0, le=1000)], Annotated[float, Field(ge=0, le=1000)]]
    leds_px: list[tuple[Pixels, Pixels]]
    spot: _Spot | None = None
    fingerprint: FingerprintTable | None = None


class _Unit(_Table):
    serial: str


class _Source(_Table):
    note: str
    sha256: str


class _File(_Table):
    format: Literal["altd-calibration/1"]
    unit: _Unit
    created: datetime
    recording: _Source
    targets: Annotated[list[_Target], Field(min_length=1)]


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    document = _as_document(calibration)
    document["checksum"] = _checksum(document)
    write_file(path, (json.dumps(document, indent=1) + "\n").encode())


def load_calibration(path: Path, unit_serial: str | None = None) -> Calibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""
    content = read_file(path, _LARGEST_BYTES)
    try:
        document = parse_json(content)
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
    if not isinstance(document, dict):
        raise BadInputError(path, "is not a calibration: no JSON object")
    if document.get("format") != FORMAT:
        raise BadInputError(path, f"format is {document.get('format')!r}, this altd reads {FORMAT!r}")
    checksum = document.pop("checksum", None)
    if checksum != _checksum(document):
        raise BadInputError(path, "checksum does not fit: the file is damaged or was edited")
    try:
        calibration = _from_content(_File.model_validate(document))
        check_calibration(calibration)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        value = f", not {first['input']}" if isinstance(first["input"], int | float) else ""
        raise BadInputError(path, f"{place}: {first['msg']}{value}") from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
    if unit_serial is not None and calibration.unit_serial != unit_serial:
        raise BadInputError(path, f"is for unit {calibration.unit_serial!r}, this is unit {unit_serial!r}")
    return calibration


def check_image_size(calibration: Calibration, path: Path, target: str, width: int, height: int) -> None:
    """Refuse frames of another size than the calibration was made with, or of a target it does not know."""
    known = calibration.target(target)
    if known is None:
        raise BadInputError(path, f"does not know target {target!r}")
    if (known.width, known.height) != (width, height):
        raise BadInputError(
            path,
            f"target {target!r} was calibrated at {known.width} × {known.height}, not {width} × {height}",
        )


def check_place(calibration: Calibration, path: Path, target: str, z_mm: float) -> None:
    """Refuse a target that stands elsewhere on the beam than where it was calibrated."""
    known = calibration.target(target)
    if known is not None and abs(known.z_mm - z_mm) > _SAME_Z_MM:
        raise BadInputError(path, f"target {target!r} was calibrated at z {known.z_mm:g} mm, not {z_mm:g}")


def check_camera(calibration: Calibration, path: Path, target: str, camera: CameraIdentity) -> None:
    """Refuse a recording of another camera than the one that the target was calibrated with."""
    known = calibration.target(target)
    if known is not None and (difference := camera.difference_from(known.camera)):
        raise BadInputError(path, f"target {target!r} was calibrated with another camera: {difference}")


def _checksum(document: dict[str, Any]) -> str:
    """SHA-256 over the document without its checksum, keys sorted, no spaces."""
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()


def _as_document(calibration: Calibration) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "unit": {"serial": calibration.unit_serial},
        "created": utc_text(calibration.created),
        "recording": {"note": calibration.recording_note, "sha256": calibration.recording_sha256},
        "targets": [_target_document(target) for target in calibration.targets],
    }


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
            "left_out_px": target.cross_check.left_out_px,
            "bound_px": target.cross_check.bound_px,
            "largest_px": target.cross_check.largest_px,
        },
        "left_out_px": target.left_out_px,
        "residuals": {
            "mean_mm": target.residual_mean_mm,
            "std_mm": target.residual_std_mm,
            "max_mm": target.residual_max_mm,
        },
        "repeatability_px": target.repeatability_px.tolist(),
        "leds_px": target.leds_px.tolist(),
        "spot": None if target.spot == UNKNOWN_SPOT else asdict(target.spot),
        "fingerprint": as_document(target.fingerprint),
    }


def _flat_document(flat: Flat | None) -> dict[str, str] | None:
    """The levels as a grey PNG in base64."""
    if flat is None:
        return None
    png = cv2.imencode(".png", flat.levels)[1].tobytes()
    return {"source": flat.source, "origin": flat.origin, "png": base64.b64encode(png).decode("ascii")}


def _map_document(fitted: TensorMap) -> dict[str, Any]:
    return {
        "basis": "gram",
        "model": fitted.model,
        "x_axis": asdict(fitted.x_axis),
        "y_axis": asdict(fitted.y_axis),
        "degree": list(fitted.degree),
        "spectrum_u_px": fitted.spectra[0].tolist(),
        "spectrum_v_px": fitted.spectra[1].tolist(),
        "spread_u_px": fitted.spread_px[0].tolist(),
        "spread_v_px": fitted.spread_px[1].tolist(),
        "noise_px": fitted.noise_px,
        "hull_mm": fitted.hull_mm.tolist(),
        "margin_mm": fitted.margin_mm,
        "beyond_px_per_mm": fitted.beyond_px_per_mm,
    }


def _from_content(content: _File) -> Calibration:
    return Calibration(
        unit_serial=content.unit.serial,
        created=content.created,
        recording_note=content.recording.note,
        recording_sha256=content.recording.sha256,
        targets=tuple(_from_target(target) for target in content.targets),
    )


def _from_target(target: _Target) -> TargetCalibration:
    flat = _from_flat(target)
    place = f"targets.{target.name}.fingerprint"
    return TargetCalibration(
        name=target.name,
        z_mm=target.z_mm,
        width=target.width,
        height=target.height,
        localiser=SpotSettings(**target.localiser.model_dump()),
        flat=flat,
        map=_from_map(f"targets.{target.name}.map", target.map),
        cross_check=CrossCheck(
            map=_from_map(f"targets.{target.name}.cross_check.map", target.cross_check.map),
            left_out_px=target.cross_check.left_out_px,
            bound_px=target.cross_check.bound_px,
            largest_px=target.cross_check.largest_px,
        ),
        left_out_px=target.left_out_px,
        residual_mean_mm=target.residuals.mean_mm,
        residual_std_mm=target.residuals.std_mm,
        residual_max_mm=target.residuals.max_mm,
        repeatability_px=np.array(target.repeatability_px),
        leds_px=np.array(target.leds_px).reshape(-1, 2),
        spot=UNKNOWN_SPOT if target.spot is None else _from_spot(target.spot),
        camera=CameraIdentity(target.camera_serial, target.camera_model, target.camera_driver),
        origin=target.origin,
        fingerprint=from_table(place, target.fingerprint, target.width, target.height, flat),
    )


def _from_spot(spot: _Spot) -> SpotReference:
    shape = None if spot.shape is None else ShapeReference(spot.shape.mean, spot.shape.sigma)
    return SpotReference(spot.grain, spot.misfit_ratio, spot.pattern_px, spot.noise_px, shape)


def _from_flat(target: _Target) -> Flat | None:
    if target.flat is None:
        return None
    place = f"targets.{target.name}.flat.png"
    try:
        png = base64.b64decode(target.flat.png, validate=True)
        levels = decode_png(png, target.width, target.height, bits=8)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error
    return Flat(np.asarray(levels, dtype=np.uint8), target.flat.source, target.flat.origin)


def _from_map(place: str, content: _Map) -> TensorMap:
    columns, rows = content.degree[0] + 1, content.degree[1] + 1
    return TensorMap(
        model=content.model,
        x_axis=Axis(**content.x_axis.model_dump()),
        y_axis=Axis(**content.y_axis.model_dump()),
        spectra=_array(
            f"{place}.spectrum", [content.spectrum_u_px, content.spectrum_v_px], (2, rows, columns)
        ),
        spread_px=_array(
            f"{place}.spread",
            [content.spread_u_px, content.spread_v_px],
            (2, rows * columns, len(content.spread_u_px[0]) if content.spread_u_px else 0),
        ),
        noise_px=content.noise_px,
        hull_mm=np.array(content.hull_mm),
        margin_mm=content.margin_mm,
        beyond_px_per_mm=content.beyond_px_per_mm,
    )


def _array(place: str, values: list[Any], shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:
        array = np.empty(0)
    if array.shape != shape:
        raise ValueError(f"{place}: expected {' × '.join(map(str, shape))} numbers")
    return array
