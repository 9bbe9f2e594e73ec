"""The calibration file: one JSON document for one unit, checked by its own checksum."""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from pydantic import ValidationError

from altd.calibration.file_content import calibration_of, document_of
from altd.calibration.file_tables import FORMAT, CalibrationTable
from altd.calibration.soundness import check_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of, parse_json
from altd.files.reading import read_file
from altd.files.writing import write_file
from altd.measuring.calibration import Calibration, CalibrationFile
from altd.recording.header import RecordingHeader
from altd.records import CameraIdentity

MAX_BYTES = 1 << 26
"""Two flats of 20 megapixels that no compression makes smaller."""

_Z_TOLERANCE_MM = 1e-3


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; raises BadInputError when it cannot be written."""
    write_file(path, _content_of(calibration)[0])


def file_of(calibration: Calibration) -> CalibrationFile:
    """The hashes of the file that ``save_calibration`` writes."""
    content, checksum = _content_of(calibration)
    return CalibrationFile(sha256(content).hexdigest(), checksum)


def _content_of(calibration: Calibration) -> tuple[bytes, str]:
    """The bytes of the file, and the checksum in it."""
    document = document_of(calibration)
    checksum = checksum_of(document)
    return (json.dumps({**document, "checksum": checksum}, indent=1) + "\n").encode(), checksum


def load_calibration(path: Path, unit_serial: str | None = None) -> Calibration:
    """Read and check a calibration; raises BadInputError when checksum, version, content or unit is wrong."""
    content = read_file(path, MAX_BYTES)
    try:
        document = parse_json(content)
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
    if not isinstance(document, dict):
        raise BadInputError(path, "is not a calibration: no JSON object")
    if document.get("format") != FORMAT:
        raise BadInputError(path, f"format is {document.get('format')!r}, this altd reads {FORMAT!r}")
    checksum = document.pop("checksum", None)
    if checksum != checksum_of(document):
        raise BadInputError(path, "checksum does not fit: the file is damaged or was edited")
    try:
        calibration = calibration_of(CalibrationTable.model_validate(document))
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
    return replace(calibration, file=CalibrationFile(sha256(content).hexdigest(), str(checksum)))


def check_recording(calibration: Calibration, path: Path, header: RecordingHeader) -> None:
    """Refuse a recording of a target, an image size, a camera or a place that is not the calibration's."""
    for target in header.shown_targets:
        size = header.cameras[target.camera]
        check_image_size(calibration, path, target.name, size.width, size.height)
        check_camera(calibration, path, target.name, size.identity)
        if header.targets is not None:
            check_place(calibration, path, target.name, target.z_mm)


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
    if known is not None and abs(known.z_mm - z_mm) > _Z_TOLERANCE_MM:
        raise BadInputError(path, f"target {target!r} was calibrated at z {known.z_mm:g} mm, not {z_mm:g}")


def check_camera(calibration: Calibration, path: Path, target: str, camera: CameraIdentity) -> None:
    """Refuse a recording of another camera than the one that the target was calibrated with."""
    known = calibration.target(target)
    if known is not None and (difference := camera.difference_from(known.camera)):
        raise BadInputError(path, f"target {target!r} was calibrated with another camera: {difference}")
