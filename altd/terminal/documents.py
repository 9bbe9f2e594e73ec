"""The required content of the daemon's documents; other answers are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError

from altd.errors import one_line
from altd.records import Quantities
from altd.status.answer import Answer
from altd.status.calibration_summary import CalibratedTarget
from altd.status.cross_check import CrossCheckedMeasurement
from altd.status.models import Availability, SelfCheck, Status, TargetArea, Targets, UnitState

_MAX_LISTED = 200
"""Maximum number of causes, components or targets: a unit has about ten."""
_MAX_CORNERS = 10_000
"""Maximum number of corners of an outline."""
_MAX_NUMBER, _MAX_COUNT = 1e9, 2**53
"""Seconds, mm, degrees: real values are far below the limit, and larger ones would overflow a scale."""
_MAX_MM = 1e5

Document = TypeVar("Document", bound=BaseModel)


def checked(
    model: type[Document], document: object, extra: Literal["allow", "ignore"] = "ignore"
) -> Document:
    """Return a document by its model, with texts that can be shown; raises ValueError that names the place.

    ``extra`` tells what happens to keys that are not in the model: a daemon may be newer than this program.
    """
    try:
        return model.model_validate(_harmless(document, "the answer"), extra=extra)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ValueError(one_line(f"{place or 'the answer'}: {first['msg']}")) from error


def _harmless(value: object, place: str) -> object:
    """Return a JSON value without control characters, which a terminal would execute.

    Raises ValueError for what is too long or too large.
    """
    if isinstance(value, str):
        return one_line(value)
    limit = _MAX_COUNT if isinstance(value, int) else _MAX_NUMBER
    if isinstance(value, int | float) and not abs(value) <= limit:
        raise ValueError(f"{place}: a number beyond {limit:g}")
    if isinstance(value, dict):
        if len(value) > _MAX_LISTED:
            raise ValueError(f"{place}: more than {_MAX_LISTED} keys")
        return {one_line(str(key)): _harmless(item, one_line(str(key))) for key, item in value.items()}
    if isinstance(value, list):
        is_listed = any(isinstance(item, dict | str) for item in value)
        if len(value) > (_MAX_LISTED if is_listed else _MAX_CORNERS):
            raise ValueError(f"{place}: a list that is too long")
        return [_harmless(item, place) for item in value]
    return value


class StatusDocument(Status):
    """``/api/v1/status`` of a daemon, which always knows its state."""

    calibration: str = "not known"
    state: UnitState
    availability: Availability


class SelfCheckDocument(SelfCheck):
    """``/api/v1/self-check``, or the answer of ``altd selfcheck`` with the ``origin`` of its frames."""

    origin: str = ""


_Millimetres = Annotated[float, Field(ge=-_MAX_MM, le=_MAX_MM)]
_Size = Annotated[float, Field(ge=1.0, le=_MAX_MM)]


class TargetDocument(TargetArea):
    """One target, whose outline can be drawn."""

    valid_mm: list[tuple[_Millimetres, _Millimetres]]


class TargetsDocument(Targets):
    """``/api/v1/targets``, in a size that can be drawn."""

    area_mm: tuple[_Size, _Size]
    targets: list[TargetDocument]  # type: ignore[assignment]  # of the same keys


class CalibrationDocument(Answer):
    """``/api/v1/calibration``; without targets no calibration is loaded."""

    targets: list[CalibratedTarget] = Field(default=[])


@dataclass(frozen=True, slots=True)
class Shown:
    """One quantity as displayed; ``also`` is its value in another unit, with that. None: not known."""

    key: str
    label: str
    unit: str
    decimals: int
    value: float | None
    sigma: float | None
    sigma_now: float | None
    also: tuple[float | None, str, int] | None = None


@dataclass(frozen=True, slots=True)
class ShownBeam:
    """A measurement that was ``age_s`` old when it was sent; ``spots`` are in mm, None: not known."""

    sequence: int
    time: str | None
    frames: int
    valid: bool
    status: tuple[str, ...]
    age_s: float | None
    numbers: tuple[Shown, ...]
    spots: Mapping[str, tuple[float, float] | None]
    cross_check: CrossCheckedMeasurement | None


class _MeasurementDocument(BaseModel):
    sequence: int
    time: str | None
    frames: int
    valid: bool
    status: tuple[str, ...]
    age_s: float | None
    sigma: dict[str, float | None]
    sigma_now: dict[str, float | None]
    cross_check: CrossCheckedMeasurement | None = None


class _NothingYet(BaseModel):
    error: str
    status: tuple[str, ...]


class _Place(BaseModel):
    x_mm: float | None
    y_mm: float | None


class _Number(BaseModel):
    value: float | None


def reading_of(document: object, quantities: Quantities) -> ShownBeam | None:
    """Return the measurement; None: nothing was measured since the start.

    The numbers are the main ones of the unit and those of a fitted sensor. Raises ValueError that names what
    is missing.
    """
    if isinstance(document, dict) and "error" in document:
        checked(_NothingYet, document)
        return None
    measured = checked(_MeasurementDocument, document, "allow")
    given: Mapping[str, Any] = measured.model_extra or {}
    own = {quantity.key for quantity in quantities.of_unit}
    return ShownBeam(
        sequence=measured.sequence,
        time=measured.time,
        frames=measured.frames,
        valid=measured.valid,
        status=measured.status,
        age_s=measured.age_s,
        numbers=tuple(_numbers(measured, given, quantities)),
        spots={
            one_line(key): _place(value)
            for key, value in list(given.items())[:_MAX_LISTED]
            if key not in own and isinstance(value, dict) and value.keys() == {"x_mm", "y_mm"}
        },
        cross_check=measured.cross_check,
    )


def _numbers(measured: _MeasurementDocument, given: Mapping[str, Any], quantities: Quantities) -> list[Shown]:
    numbers = []
    twins = {quantity.is_also: quantity for quantity in quantities.of_unit if quantity.is_also}
    for quantity in quantities.of_unit:
        if quantity.key not in measured.sigma:
            continue
        value = _number(given, quantity.key)
        also = twins.get(quantity.key)
        numbers.append(
            Shown(
                key=quantity.key,
                label=quantity.label,
                unit=quantity.unit.replace("°", "deg"),
                decimals=quantity.decimals - 1,
                value=value,
                sigma=None if value is None else measured.sigma[quantity.key],
                sigma_now=None if value is None else measured.sigma_now.get(quantity.key),
                also=None if also is None else (_number(given, also.key), also.unit, also.decimals - 1),
            )
        )
    return numbers


def _number(given: Mapping[str, Any], key: str) -> float | None:
    return checked(_Number, {"value": given.get(key)}).value


def _place(value: object) -> tuple[float, float] | None:
    place = checked(_Place, value)
    return None if place.x_mm is None or place.y_mm is None else (place.x_mm, place.y_mm)
