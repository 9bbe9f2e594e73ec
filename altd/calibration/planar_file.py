"""The calibration file of the instrument ``planar``: one JSON document with its own checksum."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, TypeAdapter, ValidationInfo

from altd.calibration.file import RecordingTable, UnitTable, content_of, read_calibration
from altd.calibration.file_tables import ARRAY, Side, array_of, listed
from altd.errors import BadInputError
from altd.files.record_tables import At, attributes_of, held_in, record_from
from altd.files.table import Table, complaint
from altd.files.writing import write_file
from altd.instruments.planar.instrument import PlanarCalibration
from altd.instruments.planar.plane import Model
from altd.recording.header import RecordingHeader
from altd.records import CameraIdentity, Origin, utc_text

PLANAR_FORMAT = "altd-planar-calibration/1"

Sigma = Annotated[float, Field(gt=0, le=1000)]
_Place = tuple[float, float]
_PARAMETERS: Mapping[Model, int] = {"homography": 8, "lens": 13}


class _Camera(Table):
    serial: Annotated[str | None, At("camera.serial")]
    model: Annotated[str | None, At("camera.model")]
    driver: Annotated[str | None, At("camera.driver")]
    origin: Origin
    width: Annotated[Side, At("fit.camera.width")]
    height: Annotated[Side, At("fit.camera.height")]


class _Content(Table):
    format: Literal["altd-planar-calibration/1"]
    unit: Annotated[UnitTable, At("")]
    created: Annotated[datetime, PlainSerializer(utc_text)]
    recording: Annotated[RecordingTable, At("")]
    camera: Annotated[_Camera, At("")]
    disc_mm: Sigma
    model: Annotated[Model, At("fit.camera.model")]
    parameters: Annotated[list[float], At("fit.camera.parameters"), PlainSerializer(listed)]
    origin_mm: Annotated[_Place, At("fit.camera.origin_mm"), *ARRAY]
    leds_mm: Annotated[list[_Place], Field(min_length=5, max_length=64), At("fit.leds_mm"), *ARRAY]
    covariance: Annotated[list[list[float]], At("fit.covariance"), PlainSerializer(listed)]
    noise_px: Annotated[Sigma, At("fit.noise_px")]
    sigma_led_mm: Annotated[Sigma, At("fit.sigma_led_mm")]
    sigma_pose_mm: Annotated[tuple[Sigma, Sigma, Sigma], At("fit.sigma_pose_mm")]
    frame_noise_px: Sigma
    hull_mm: Annotated[list[_Place], Field(min_length=3), *ARRAY]
    known_phi_deg: Annotated[list[float], Field(min_length=1), AfterValidator(tuple)]
    leave_one_out: Annotated[dict[Model, tuple[float, float]], At("rms")]


def _calibration_of(content: _Content, _: ValidationInfo) -> PlanarCalibration:
    count = _PARAMETERS[content.model]
    parameters = array_of("parameters", content.parameters, (count,))
    covariance = array_of("covariance", content.covariance, 2 * (count + 2 * len(content.leds_mm),))
    sigmas = np.sqrt(np.diag(covariance).clip(1e-300))
    if np.linalg.eigvalsh(covariance / np.outer(sigmas, sigmas)).min() < -1e-6:
        raise complaint((("covariance",), "has a negative eigenvalue"))
    arrays = {"fit.camera.parameters": parameters, "fit.covariance": covariance}
    calibration: PlanarCalibration = record_from(PlanarCalibration, attributes_of(content) | arrays)
    return calibration


_FILE = TypeAdapter[PlanarCalibration](
    Annotated[PlanarCalibration, held_in(_Content, PlanarCalibration, _calibration_of)]
)


def save_planar_calibration(calibration: PlanarCalibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    write_file(path, content_of(_FILE, calibration)[0])


def load_planar_calibration(path: Path, unit_serial: str | None = None) -> PlanarCalibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""
    return read_calibration(path, PLANAR_FORMAT, _FILE, unit_serial)


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
