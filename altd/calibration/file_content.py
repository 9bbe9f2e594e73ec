"""A calibration as the content of its file, and back."""

from __future__ import annotations

import base64
from dataclasses import asdict
from typing import Any

import cv2
import numpy as np

from altd.calibration.file_fingerprint import as_document, from_table
from altd.calibration.file_tables import FORMAT, CalibrationTable, MapTable, TargetTable
from altd.files.picture import decode_png
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.cross_check import CrossCheck
from altd.records import CameraIdentity, FloatArray, utc_text
from altd.vision.flat import Flat
from altd.vision.reference import UNKNOWN_SPOT


def document_of(calibration: Calibration) -> dict[str, Any]:
    """The file's content as plain JSON types, without its checksum."""
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
        "spread_u_px": fitted.covariance_factor_px[0].tolist(),
        "spread_v_px": fitted.covariance_factor_px[1].tolist(),
        "noise_px": fitted.noise_px,
        "hull_mm": fitted.hull_mm.tolist(),
        "margin_mm": fitted.margin_mm,
        "beyond_px_per_mm": fitted.beyond_px_per_mm,
    }


def calibration_of(content: CalibrationTable) -> Calibration:
    """The calibration of a content; raises ValueError that names the key of what is none."""
    return Calibration(
        unit_serial=content.unit.serial,
        created=content.created,
        recording_note=content.recording.note,
        recording_sha256=content.recording.sha256,
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
        fingerprint=from_table(place, target.fingerprint, target.width, target.height, flat),
    )


def _from_flat(target: TargetTable) -> Flat | None:
    if target.flat is None:
        return None
    place = f"targets.{target.name}.flat.png"
    try:
        png = base64.b64decode(target.flat.png, validate=True)
        levels = decode_png(png, target.width, target.height, bits=8)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error
    return Flat(np.asarray(levels, dtype=np.uint8), target.flat.source, target.flat.origin)


def _from_map(place: str, content: MapTable) -> TensorMap:
    columns, rows = content.degree[0] + 1, content.degree[1] + 1
    return TensorMap(
        model=content.model,
        x_axis=content.x_axis,
        y_axis=content.y_axis,
        spectra=_array(
            f"{place}.spectrum", [content.spectrum_u_px, content.spectrum_v_px], (2, rows, columns)
        ),
        covariance_factor_px=_array(
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
