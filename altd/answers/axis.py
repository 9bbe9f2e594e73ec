"""``altd axis``: points of the machine in the project's coordinates and against the designed axis."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from altd.app.settings import load_beam_settings
from altd.axis import Axis, AxisDocument, BeamLine, Distance, Utc, fault_of
from altd.config import Installation, Machine
from altd.errors import BadInputError
from altd.files.documents import parse_json
from altd.files.reading import os_reason, read_file
from altd.instruments.beam.points import BEAM_KEYS, MachinePoints
from altd.reasons import NOT_FROM_CAMERAS, Reason
from altd.records import FloatArray, utc_text
from altd.status.proof import unit_number
from altd.tables import AXIS_COLUMNS, TEXT_FORMATS, Row, TextFormat

UNREADABLE = "unreadable"
_MAX_BYTES = _MAX_LINE_BYTES = 1 << 20
_MAX_INCLINATION_MM_PER_M = 0.5
"""Maximum difference of the beam's inclination in the settings from the surveyed one, which also finds a
wrong sign: at a yaw of 50 mm/m it turns the vertical by 0.025 mm/m."""
_ROUNDED_MM, _ROUNDED_PER_LEVER = 0.005, 2e-6
"""Maximum difference of a point that is computed again from the rounded numbers of its message."""
_ROUNDED_SIGMA_MM, _MIN_SIGMA_SHARE = 2e-4, 0.98
"""A published sigma is at least that of the settings, but for its rounding."""
_ROUNDED, _MIN_VARIANCE = 1e-4, 1e-12
"""Maximum fault of a matrix of correlations: a covariance is published with six digits."""
_NOT_LIVE = {*NOT_FROM_CAMERAS, Reason.REHEARSAL}
_Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Given(BaseModel):
    """Part of a message; further keys have no effect."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class _Sigma(_Given):
    right_mm: Annotated[_Number, Field(ge=0)] | None
    up_mm: Annotated[_Number, Field(ge=0)] | None


class _Point(_Given):
    right_mm: _Number | None
    up_mm: _Number | None
    sigma: _Sigma


class Message(_Given):
    """The keys of a measurement that are used, and ``distance_m``, which a controller may add."""

    sequence: int
    time: Utc | None
    valid: bool
    status: list[str]
    x_mm: _Number | None
    y_mm: _Number | None
    yaw_mm_per_m: _Number | None
    pitch_mm_per_m: _Number | None
    roll_deg: _Number | None
    covariance: list[list[_Number | None]]
    points: dict[str, _Point] = {}
    unit: str | None = None
    session: str | None = None
    distance_m: Distance | None = None


class _RefusedError(Exception):
    """A measurement has no place: the reason, and the same in words."""


AnyDocument = TypeVar("AnyDocument", AxisDocument, BeamLine)


def _read(path: Path, kind: type[AnyDocument]) -> AnyDocument:
    try:
        return kind.model_validate(parse_json(read_file(path, _MAX_BYTES)))
    except ValidationError as error:
        raise BadInputError(path, fault_of(error)) from error
    except ValueError as error:
        raise BadInputError(path, str(error)) from error


class Guidance:
    """Rows of the messages of one unit, whose beam was surveyed, against a designed axis."""

    def __init__(self, axis: Axis, beam: BeamLine, machine: Machine, installation: Installation) -> None:
        self._axis, self._beam, self._machine = axis, beam, machine
        self._points = MachinePoints(machine, installation)
        self._unit = f"{unit_number(beam.serial):08X}"
        self._last: tuple[str | None, int, object] | None = None

    def rows(self, message: Message) -> Iterator[Row]:
        """Yield a row for each point of the machine."""
        about: Row = {
            "sequence": message.sequence,
            "time": None if message.time is None else utc_text(message.time),
            "status": " ".join(message.status),
        }
        try:
            distance_m = self._distance_m(message)
            places, covariances = self._offsets(message)
        except _RefusedError as refused:
            reason, detail = refused.args
            for point in self._machine.points:
                yield {**about, "point": point.name, "reason": reason, "detail": detail}
            return
        for point, place, covariance in zip(self._machine.points, places, covariances, strict=True):
            row = self._row(*self._beam.place(distance_m, place, covariance))
            yield {**about, "point": point.name, **row}

    def _distance_m(self, message: Message) -> float:
        """Return the distance to the front target; raises if the message cannot be used with this survey."""
        beam, this = self._beam, (message.session, message.sequence, message.time)
        last, self._last = self._last, this
        if message.unit is not None and message.unit != self._unit:
            raise _RefusedError("other_unit", f"unit {message.unit}, the beam is that of {self._unit}")
        if not message.valid:
            raise _RefusedError("invalid", "the measurement is not valid: see status")
        if this == last:
            raise _RefusedError("repeated", "the same measurement as in the line before")
        if message.time is None:
            raise _RefusedError("no_time", "a beam holds from the time of its survey on")
        if message.time < beam.time:
            raise _RefusedError("before_survey", f"the beam was surveyed at {utc_text(beam.time)}")
        if message.distance_m is not None:
            return message.distance_m
        if beam.distance_m is None or beam.distance_until is None:
            raise _RefusedError("no_distance", "neither the line nor the beam states distance_m")
        if message.time > beam.distance_until:
            raise _RefusedError("distance_old", f"its distance holds until {utc_text(beam.distance_until)}")
        return beam.distance_m

    def _offsets(self, message: Message) -> tuple[FloatArray, FloatArray]:
        """Return the points (n, 3) to the right, up and along, mm, and their covariances.

        Right and up are the published numbers. They are computed again, because only then the settings are
        those of the unit; their sigmas are the published ones too, which also contain a roll in motion.
        """
        machine = self._machine
        numbers = [getattr(message, key) for key in BEAM_KEYS]
        said = [message.points.get(each.name) for each in machine.points]
        published = [(each.right_mm, each.up_mm) if each else (None, None) for each in said]
        stated = [(each.sigma.right_mm, each.sigma.up_mm) if each else (None, None) for each in said]
        roll_deg = self._roll_deg(message)
        known = np.array([*published, *stated], dtype=np.float64)
        joint = np.array([row[:4] for row in message.covariance[:4]], dtype=np.float64)
        is_known = np.isfinite(known).all() and np.isfinite(joint).all()
        if roll_deg is None or None in numbers or not is_known:
            raise _RefusedError("not_known", "the measurement has no place of this machine's points")
        places, covariances = self._points.places(numbers, joint, roll_deg)
        across, sigmas = known[: len(said)], known[len(said) :]
        levers_mm = [math.hypot(each.x_mm, each.y_mm, each.z_mm) for each in machine.points]
        allowed_mm = _ROUNDED_MM + _ROUNDED_PER_LEVER * np.array(levers_mm)
        own = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
        is_other = np.abs(places[:, :2] - across).max(axis=1) > allowed_mm
        is_other |= (sigmas < _MIN_SIGMA_SHARE * own[:, :2] - _ROUNDED_SIGMA_MM).any(axis=1)
        if is_other.any() or set(message.points) != {each.name for each in machine.points}:
            raise _RefusedError("other_settings", "with these settings the unit would publish other points")
        scale = np.ones_like(own)
        scale[:, :2] = np.maximum(sigmas, own[:, :2]) / np.where(own[:, :2] > 0, own[:, :2], 1.0)
        scaled: FloatArray = covariances * scale[:, :, None] * scale[:, None, :]
        return np.column_stack([across, places[:, 2]]), scaled

    def _roll_deg(self, message: Message) -> tuple[float, float] | None:
        """Return roll and its sigma, as ``MachinePoints`` takes them; the covariance has it in mm/m."""
        if self._machine.roll_deg is not None:
            return self._machine.roll_deg, self._machine.roll_sigma_deg or 0.0
        variance = message.covariance[4][4] if len(message.covariance) == 5 else None
        if message.roll_deg is None or variance is None or variance < 0:
            return None
        per_deg = 1000.0 * math.radians(1.0) / math.cos(math.radians(message.roll_deg)) ** 2
        return message.roll_deg, math.sqrt(variance) / per_deg

    def _row(self, place: FloatArray, covariance: FloatArray) -> Row:
        feet = self._axis.feet(place)
        if len(feet) != 1:
            detail = "the axis has no place beside it, within max_offset_m and between its ends"
            if feet:
                detail = f"the axis passes at {', '.join(f'{foot.chainage_m:.3f}' for foot in feet)}"
            return {"reason": "ambiguous" if feet else "out_of_axis", "detail": detail}
        (foot,) = feet
        of_place = np.sqrt(np.diag(covariance)).tolist()
        of_foot = np.sqrt(np.diag(foot.normal @ covariance @ foot.normal.T)).tolist()
        numbers = (foot.chainage_m, 1000 * foot.right_m, 1000 * foot.up_m, *of_foot, *place, *of_place)
        names = [column.name for column in AXIS_COLUMNS if column.unit]
        return {
            name: round(float(number), 5 if name.endswith("_m") else 3)
            for name, number in zip(names, numbers, strict=True)
        }


def guidance_of(axis: Path, beam: Path, config: Path) -> Guidance:
    """Return what the three files state together; raises BadInputError."""
    document, survey, settings = _read(axis, AxisDocument), _read(beam, BeamLine), load_beam_settings(config)
    machine = settings.machine
    if machine is None or not machine.points:
        raise BadInputError(config, "machine.points: this table is missing")
    if settings.unit.serial != survey.serial:
        raise BadInputError(
            beam, f"serial: {survey.serial}, the settings are those of {settings.unit.serial}"
        )
    surveyed, stated = survey.inclination_mm_per_m, machine.beam_inclination_mm_per_m
    if abs(surveyed - stated) > _MAX_INCLINATION_MM_PER_M:
        said = f"machine.beam_inclination_mm_per_m of the settings is {stated:g}"
        raise BadInputError(beam, f"inclination_mm_per_m: {surveyed:g}, {said}")
    return Guidance(document.axis, survey, machine, settings.installation)


def answer(
    guidance: Guidance, measurements: Path | None, form: TextFormat, report_error: Callable[[str], object]
) -> int:
    """Write the rows of each line as it comes; return the exit status, 2 if a line could not be used."""
    table = TEXT_FORMATS[form](sys.stdout.write, AXIS_COLUMNS)
    status, is_warned = 0, False
    for number, line in enumerate(_lines(measurements), start=1):
        if not line.strip():
            continue
        try:
            message = message_of(line)
        except ValueError as error:
            report_error(f"{measurements or 'stdin'}: line {number}: {error}")
            table.add({"line": number, "reason": UNREADABLE, "detail": str(error)})
            status = 2
        else:
            for row in guidance.rows(message):
                table.add({"line": number, **row})
            if not is_warned and _NOT_LIVE & set(message.status):
                report_error(f"{measurements or 'stdin'}: line {number}: is not live: see status")
                is_warned = True
        sys.stdout.flush()
    return status


def message_of(line: bytes) -> Message:
    """Parse a line; raises ValueError that names the key."""
    if len(line) > _MAX_LINE_BYTES:
        raise ValueError(f"is longer than {_MAX_LINE_BYTES} bytes")
    try:
        message = Message.model_validate(parse_json(line))
    except ValidationError as error:
        raise ValueError(fault_of(error)) from error
    size = len(message.covariance)
    if size not in (4, 5) or any(len(row) != size for row in message.covariance):
        raise ValueError("covariance: is not a matrix of 4 or 5 rows")
    joint = np.array(message.covariance, dtype=np.float64)[:4, :4]
    if np.isfinite(joint).all():
        scale = np.sqrt(np.maximum(np.diag(joint), _MIN_VARIANCE))
        scaled = joint / scale[:, None] / scale
        if np.abs(scaled - scaled.T).max() > _ROUNDED or np.linalg.eigvalsh(scaled)[0] < -_ROUNDED:
            raise ValueError("covariance: is not that of four numbers")
    return message


def _lines(path: Path | None) -> Iterator[bytes]:
    """Yield the lines as they come, each cut to its first ``_MAX_LINE_BYTES`` + 1 bytes."""
    try:
        with nullcontext(sys.stdin.buffer) if path is None else path.open("rb") as file:
            while line := file.readline(_MAX_LINE_BYTES + 1):
                yield line
                while len(line) > _MAX_LINE_BYTES and not line.endswith(b"\n"):
                    line = file.readline(_MAX_LINE_BYTES + 1)
    except OSError as error:
        raise BadInputError(path or "stdin", os_reason(error, path)) from error
