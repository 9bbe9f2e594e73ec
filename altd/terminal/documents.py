"""The required content of the daemon's documents; other answers are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from altd.errors import one_line
from altd.records import Quantities

_MAX_LISTED = 200
"""Maximum number of causes, components or targets: a unit has about ten."""

Text = Annotated[str, AfterValidator(one_line)]
"""Text without control characters, which a terminal would execute."""


Number = Annotated[float, Field(ge=-1e9, le=1e9)]
"""Seconds, mm, degrees: real values are far below the limits, and larger ones would overflow a scale."""
_Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]
_Size = Annotated[float, Field(ge=1.0, le=1e5)]


class _Document(BaseModel):
    """Base of all documents; keys that are not shown are optional."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    @classmethod
    def checked(cls, document: object) -> Self:
        """Return the content of a document; raises ValueError that names what is missing."""
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            place = ".".join(str(part) for part in first["loc"])
            raise ValueError(one_line(f"{place or 'the answer'}: {first['msg']}")) from error


class CauseDocument(_Document):
    """One cause of the state."""

    code: Text
    signal: Text
    of: Text | None
    active: bool
    for_s: Number
    brief: Text
    remedy: Text
    detail: Text


class StateDocument(_Document):
    """The state and its causes, the worst first."""

    signal: Text
    for_s: Number
    causes: Annotated[tuple[CauseDocument, ...], Field(max_length=_MAX_LISTED)]


class SpanDocument(_Document):
    """The availability in one span of time; ``share`` None: not known yet."""

    share: Number | None
    observed_s: Number


class ComponentDocument(_Document):
    """One component."""

    state: Text
    message: Text
    for_s: Number


class StatusDocument(_Document):
    """``/api/v1/status``."""

    version: Text
    serial: Text
    calibration: Text = "not known"
    state: StateDocument
    availability: dict[Text, SpanDocument]
    components: Annotated[dict[Text, ComponentDocument], Field(max_length=_MAX_LISTED)]


_Texts = Annotated[tuple[Text, ...], Field(max_length=_MAX_LISTED)]


class PartDocument(_Document):
    """The verdict on one target, or on yaw and pitch; ``error`` None: not known."""

    of: Text
    verdict: Text
    unit: Text
    error: Number | None
    sigma: Number | None
    suspect: Number
    bad: Number


class LedsDocument(_Document):
    """The LEDs of one target."""

    leds_expected: int
    leds_found: int
    leds: _Texts
    detail: Text


class SelfCheckDocument(_Document):
    """``/api/v1/self-check``; ``verdict`` None: there was none, and ``reasons`` give the reason."""

    verdict: Text | None
    reasons: _Texts = ()
    time: Text | None = None
    parts: Annotated[tuple[PartDocument, ...], Field(max_length=_MAX_LISTED)] = ()
    targets: Annotated[dict[Text, LedsDocument], Field(max_length=_MAX_LISTED)] = {}
    notes: _Texts = ()
    origin: Text = ""


class CalibratedTargetDocument(_Document):
    """Quality of one target's calibration; ``flat`` None: without a flat."""

    name: Text
    left_out_px: Number | None
    residuals: dict[Text, Number | None]
    flat: Text | None


class CalibrationDocument(_Document):
    """``/api/v1/calibration``; without targets no calibration is loaded."""

    targets: Annotated[tuple[CalibratedTargetDocument, ...], Field(max_length=_MAX_LISTED)] = ()


class TargetDocument(_Document):
    """One target: the outline of the area in which it is measured, mm in the unit frame."""

    name: Text
    valid_mm: Annotated[tuple[tuple[_Millimetres, _Millimetres], ...], Field(max_length=10_000)]


class TargetsDocument(_Document):
    """``/api/v1/targets``: targets in beam order, and the size of the area that the unit is designed for."""

    area_mm: tuple[_Size, _Size]
    targets: Annotated[tuple[TargetDocument, ...], Field(max_length=_MAX_LISTED)]


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
class Reading:
    """A measurement that was ``age_s`` old when it was sent; ``spots`` are in mm, None: not known."""

    sequence: int
    time: str | None
    frames: int
    valid: bool
    status: tuple[str, ...]
    age_s: float | None
    numbers: tuple[Shown, ...]
    spots: Mapping[str, tuple[float, float] | None]


class _MeasurementDocument(_Document):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False, extra="allow")

    sequence: int
    time: Text | None
    frames: int
    valid: bool
    status: Annotated[tuple[Text, ...], Field(max_length=_MAX_LISTED)]
    age_s: Number | None
    sigma: dict[str, Number | None]
    sigma_now: dict[str, Number | None]


class _NothingYet(_Document):
    error: Text
    status: tuple[Text, ...]


class _Place(_Document):
    x_mm: Number | None
    y_mm: Number | None


class _Number(_Document):
    value: Number | None


def reading_of(document: object, quantities: Quantities) -> Reading | None:
    """Return the measurement; None: nothing was measured since the start.

    The numbers are the main ones of the unit and those of a fitted sensor. Raises ValueError that names what
    is missing.
    """
    if isinstance(document, dict) and "error" in document:
        _NothingYet.checked(document)
        return None
    measured = _MeasurementDocument.checked(document)
    given: Mapping[str, Any] = measured.model_extra or {}
    own = {quantity.key for quantity in quantities.of_unit}
    return Reading(
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
    return _Number.checked({"value": given.get(key)}).value


def _place(value: object) -> tuple[float, float] | None:
    place = _Place.checked(value)
    return None if place.x_mm is None or place.y_mm is None else (place.x_mm, place.y_mm)
