"""The archive that a user attaches to a public issue (``altd diagnose --public``), made from files alone.

Its parts hold listed keys only, so a new key of the settings or of a document stays out until it is listed
here. Known names are then removed from all texts, as a second barrier.
"""

from __future__ import annotations

import asyncio
import getpass
import json
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from altd.app.calibration_summary import planar_summary_of, summary_of
from altd.app.diagnostics import diagnostic_parts
from altd.app.parts import calibration_of_instrument
from altd.calibration.verification.document import FORMAT
from altd.config import Config
from altd.devices.settings import LiveCameraSettings
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import read_file
from altd.instruments.planar.instrument import PlanarCalibration
from altd.publish.http.diagnostics import archive_of, part_of
from altd.recording.frames_table import FrameLine
from altd.recording.reader import Recording, open_recording
from altd.status.unit import DiagnosticPart

PICTURES = 10
"""Number of pictures."""

CONSENT = (
    "This archive is made to be attached to a public issue: anybody may read and keep it.",
    "It contains: targets, cameras and measuring of the settings; versions of software; the figures of the",
    f"calibration; the tests of `altd verify`; {PICTURES} pictures, which show all that the cameras saw.",
    "It does not contain: serial numbers, names of this computer and its users, paths, addresses, passwords,",
    "the log, the history. Look into it before you attach it.",
)
"""Lines for the user, before the archive is written."""

_TABLES = frozenset({"unit", "targets", "cameras", "measuring", "installation", "self_check", "lamps"})
_WORDS = frozenset(
    {"kind", "instrument", "driver", "pixel_format", "trigger", "control", "output", "pair_by", "name"}
    | {"when_bad", "when_unknown", "camera", "map", "flat", "texture", "model", "created", "format", "origin"}
    | {"verdict", "result", "unit"}
)
"""Keys of texts that stay: words of altd, models of cameras, units of quantities."""
_WITHOUT = frozenset({"recording", "file", "calibration", "note"})
"""Keys that name files, or are texts of the user."""
_OF_VERIFICATION = ("format", "created", "origin", "verdict", "tests", "sets", "residuals")
_REMOVED = "removed"
_MIN_WORD_LETTERS = 4
_MAX_BYTES = 1 << 26


def public_archive(config: Config, recording: Path | None, verification: Path | None) -> tuple[str, bytes]:
    """Return name and content of the archive; raises BadInputError for an unusable recording or file.

    Ten pictures are taken evenly from ``recording``; ``verification`` is the file of ``altd verify -o``.
    """
    now = datetime.now(UTC)
    (versions,) = (part for part in diagnostic_parts(None) if part.name == "versions.txt")
    made = [
        DiagnosticPart("settings.json", "targets, cameras and measuring", lambda: _json(_settings(config))),
        versions,
        DiagnosticPart("calibration.json", "figures of the calibration", lambda: _calibration(config)),
    ]
    if verification is not None:
        tests = _verification(verification, config.unit.serial)
        made.append(DiagnosticPart("verification.json", "tests of `altd verify`", lambda: tests))
    words = list(_known_words(config))
    parts = [part_of(part.name, part.meaning, _cleared(part.make, words)) for part in made]
    if recording is not None:
        opened = open_recording(recording)
        for row in _spread(opened):
            name, frame = f"pictures/{row.camera}-{row.sequence}.png", opened.frame(row)
            _, data = cv2.imencode(".png", np.asarray(frame.pixels))
            parts.append(part_of(name, "a picture as it was recorded", data.tobytes))
    content = asyncio.run(archive_of(parts, "", now))
    return f"altd-public-{now:%Y%m%dT%H%M%SZ}.zip", content


def _cleared(make: Callable[[], bytes], words: Iterable[str]) -> Callable[[], bytes]:
    """Return a part without known words, whose failure names no file."""

    def made() -> bytes:
        try:
            text = make().decode()
        except Exception as error:  # its text may name a path
            raise LookupError("it cannot be read: `altd check-config`") from error
        for word in words:
            text = text.replace(word, _REMOVED)
        return text.encode()

    return made


def _known_words(config: Config) -> Iterator[str]:
    """Yield the names that must not be in the archive, without those that are too short to be recognised."""
    words = [config.unit.serial, socket.gethostname(), str(Path.home())]
    with suppress(OSError, KeyError):
        words.append(getpass.getuser())
    for camera in config.cameras.values():
        if isinstance(camera, LiveCameraSettings):
            words += [camera.serial or "", str(camera.device)]
    yield from (word for word in words if len(word) >= _MIN_WORD_LETTERS)


def _public(value: Any, key: str = "") -> Any:
    """Return a JSON value whose texts are those of listed keys."""
    if isinstance(value, dict):
        return {name: _public(item, name) for name, item in value.items() if name not in _WITHOUT}
    if isinstance(value, list):
        return [_public(item, key) for item in value]
    return _REMOVED if isinstance(value, str) and key not in _WORDS else value


def _settings(config: Config) -> Any:
    return _public(config.model_dump(mode="json", include=set(_TABLES)))


def _calibration(config: Config) -> bytes:
    found = calibration_of_instrument(config, {})
    name = config.unit.calibration.name
    if isinstance(found, PlanarCalibration):
        figures = planar_summary_of(found, name)
    else:
        figures = summary_of(found, [target.name for target in config.targets], name)
    return _json(_public(figures.as_object() | {"unit": _REMOVED}))


def _verification(path: Path, serial: str) -> bytes:
    try:
        document = parse_json(read_file(path, _MAX_BYTES))
        if document["format"] != FORMAT:
            raise ValueError(document["format"])
        if (unit := document["unit"]) != serial:
            raise BadInputError(path, f"is of unit {unit!r}, not {serial!r}")
        return _json(_public({key: document[key] for key in _OF_VERIFICATION}))
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(path, "is not a verification.json of `altd verify -o`") from error


def _spread(recording: Recording) -> Iterator[FrameLine]:
    """Yield rows of each camera, evenly over the recording."""
    cameras: Sequence[str] = list(recording.header.cameras)
    for camera in cameras:
        count = recording.rows.count[camera]
        chosen = set(np.linspace(0, count - 1, min(count, PICTURES // len(cameras)), dtype=int).tolist())
        yield from (row for number, row in enumerate(recording.rows.of(camera)) if number in chosen)


def _json(document: Any) -> bytes:
    return (json.dumps(document, indent=1) + "\n").encode()
