"""The calibration file of the instrument ``planar``: one JSON document with its own checksum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from altd.calibration.file import array_of, content_of, read_document
from altd.calibration.file_tables import RecordingTable, Table, UnitTable
from altd.errors import BadInputError
from altd.files.writing import write_file
from altd.instruments.planar.fitting import PlaneFit
from altd.instruments.planar.instrument import PlanarCalibration
from altd.instruments.planar.plane import Model, PlaneCamera
from altd.recording.header import RecordingHeader
from altd.records import CameraIdentity, Origin, utc_text

PLANAR_FORMAT = "altd-planar-calibration/1"

Sigma = Annotated[float, Field(gt=0, le=1000)]
_Place = tuple[float, float]
_PARAMETERS: Mapping[Model, int] = {"homography": 8, "lens": 13}


class _Camera(Table):
    serial: str | None
    model: str | None
    driver: str | None
    origin: Origin
    width: Annotated[int, Field(ge=16, le=20_000)]
    height: Annotated[int, Field(ge=16, le=20_000)]


class _Content(Table):
    format: Literal["altd-planar-calibration/1"]
    unit: UnitTable
    created: datetime
    recording: RecordingTable
    camera: _Camera
    disc_mm: Sigma
    model: Model
    parameters: list[float]
    origin_mm: _Place
    leds_mm: Annotated[list[_Place], Field(min_length=5, max_length=64)]
    covariance: list[list[float]]
    noise_px: Sigma
    sigma_led_mm: Sigma
    sigma_pose_mm: tuple[Sigma, Sigma, Sigma]
    frame_noise_px: Sigma
    hull_mm: Annotated[list[_Place], Field(min_length=3)]
    known_phi_deg: Annotated[list[float], Field(min_length=1)]
    leave_one_out: dict[Model, tuple[float, float]]


def save_planar_calibration(calibration: PlanarCalibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    fit, camera = calibration.fit, calibration.camera
    document: dict[str, Any] = {
        "format": PLANAR_FORMAT,
        "unit": {"serial": calibration.unit_serial},
        "created": utc_text(calibration.created),
        "recording": {"note": calibration.recording_note, "sha256": calibration.recording_sha256},
        "camera": {
            "serial": camera.serial,
            "model": camera.model,
            "driver": camera.driver,
            "origin": calibration.origin,
            "width": fit.camera.width,
            "height": fit.camera.height,
        },
        "disc_mm": calibration.disc_mm,
        "model": fit.camera.model,
        "parameters": fit.camera.parameters.tolist(),
        "origin_mm": fit.camera.origin_mm.tolist(),
        "leds_mm": fit.leds_mm.tolist(),
        "covariance": fit.covariance.tolist(),
        "noise_px": fit.noise_px,
        "sigma_led_mm": fit.sigma_led_mm,
        "sigma_pose_mm": list(fit.sigma_pose_mm),
        "frame_noise_px": calibration.frame_noise_px,
        "hull_mm": calibration.hull_mm.tolist(),
        "known_phi_deg": list(calibration.known_phi_deg),
        "leave_one_out": {model: list(rms) for model, rms in calibration.rms.items()},
    }
    write_file(path, content_of(document)[0])


def load_planar_calibration(path: Path, unit_serial: str | None = None) -> PlanarCalibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""
    calibration, file = read_document(
        path, PLANAR_FORMAT, lambda document: _calibration_of(_Content.model_validate(document))
    )
    if unit_serial is not None and calibration.unit_serial != unit_serial:
        raise BadInputError(path, f"is for unit {calibration.unit_serial!r}, this is unit {unit_serial!r}")
    return replace(calibration, file=file)


def check_planar_recording(calibration: PlanarCalibration, path: Path, header: RecordingHeader) -> None:
    """Refuse a recording whose image size or camera differs from the calibration's."""
    ((name, camera),) = header.cameras.items()
    check_planar_camera(calibration, path, name, (camera.width, camera.height), camera.identity)


def check_planar_camera(
    calibration: PlanarCalibration, path: Path, name: str, size: tuple[int, int], camera: CameraIdentity
) -> None:
    """Refuse a camera whose image size or identity differs from the calibrated one's."""
    known = calibration.fit.camera
    if (known.width, known.height) != size:
        sizes = f"{known.width} × {known.height}, not {size[0]} × {size[1]}"
        raise BadInputError(path, f"camera {name!r} was calibrated at {sizes}")
    if difference := camera.difference_from(calibration.camera):
        raise BadInputError(path, f"another camera was calibrated: {difference}")


def _calibration_of(content: _Content) -> PlanarCalibration:
    camera = content.camera
    count = _PARAMETERS[content.model]
    parameters = array_of("parameters", content.parameters, (count,))
    covariance = array_of("covariance", content.covariance, 2 * (count + 2 * len(content.leds_mm),))
    sigmas = np.sqrt(np.diag(covariance).clip(1e-300))
    if np.linalg.eigvalsh(covariance / np.outer(sigmas, sigmas)).min() < -1e-6:
        raise ValueError("covariance: has a negative eigenvalue")
    return PlanarCalibration(
        unit_serial=content.unit.serial,
        created=content.created,
        recording_note=content.recording.note,
        recording_sha256=content.recording.sha256,
        camera=CameraIdentity(camera.serial, camera.model, camera.driver),
        origin=camera.origin,
        disc_mm=content.disc_mm,
        fit=PlaneFit(
            PlaneCamera(
                content.model,
                parameters,
                np.array(content.origin_mm),
                camera.width,
                camera.height,
            ),
            np.array(content.leds_mm),
            covariance,
            content.noise_px,
            content.sigma_led_mm,
            content.sigma_pose_mm,
        ),
        frame_noise_px=content.frame_noise_px,
        hull_mm=np.array(content.hull_mm),
        known_phi_deg=tuple(content.known_phi_deg),
        rms=content.leave_one_out,
    )
