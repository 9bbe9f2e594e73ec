"""A check and the history of checks as plain JSON types, and back; what comes back is checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from altd.selfcheck.history import DAYS_KEPT, Day, History, TargetHistory
from altd.selfcheck.records import PartVerdict, SelfCheck, TargetDrift

_DECIMALS = {"x_mm": 4, "y_mm": 4, "yaw_deg": 5, "pitch_deg": 5}
_KEYS = ("yaw_deg", "pitch_deg", "x_mm", "y_mm")


def as_object(check: SelfCheck) -> dict[str, Any]:
    """The answer of ``altd selfcheck``; unknown values are null."""
    effects = check.effects
    values = {key: round(effects[key].value, _DECIMALS[key]) if key in effects else None for key in _KEYS}
    sigmas = {key: effects[key].sigma if key in effects else None for key in _KEYS}
    return {
        "verdict": str(check.verdict),
        "reasons": list(check.reasons),
        "parts": [_of_part(part) for part in check.parts],
        "targets": {name: _of_target(drift) for name, drift in check.targets.items()},
        **values,
        "sigma": {
            key: None if sigma is None else round(sigma, _DECIMALS[key]) for key, sigma in sigmas.items()
        },
    }


def _of_part(part: PartVerdict) -> dict[str, Any]:
    known = {
        key: round(value, 5) if isinstance(value, float) else value for key, value in asdict(part).items()
    }
    del known["reason"]
    return {**known, "verdict": str(part.verdict)}


def _of_target(drift: TargetDrift) -> dict[str, Any]:
    fitted = drift.similarity
    return {
        "leds_expected": drift.leds_expected,
        "leds_found": drift.leds_found,
        "shift_px": None if fitted is None else [round(part, 4) for part in fitted.shift_px],
        "turn_deg": None if fitted is None else round(fitted.turn_deg, 5),
        "scale_ppm": None if fitted is None else round(fitted.scale_ppm, 1),
        "rms_px": None if drift.rms_px is None else round(drift.rms_px, 4),
        "significance": None if drift.significance is None else round(drift.significance, 2),
        "is_similarity": None if fitted is None else drift.is_similarity,
        "leds": [str(state) for state in drift.leds],
        "foreign_px": [[round(u, 1), round(v, 1)] for u, v in drift.foreign_px],
        "detail": drift.detail,
    }


_Px = Annotated[float, Field(ge=-1e12, le=1e12)]
_NotNegative = Annotated[float, Field(ge=0, le=1e18)]
_FourPx = tuple[_Px, _Px, _Px, _Px]
_FourNotNegative = tuple[_NotNegative, _NotNegative, _NotNegative, _NotNegative]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _DayTable(_Table):
    number: Annotated[int, Field(ge=-1_000_000, le=4_000_000)]
    checks: Annotated[int, Field(ge=1, le=1_000_000_000)]
    sums: _FourPx
    variances: _FourNotNegative

    def day(self) -> Day:
        return Day(self.number, self.checks, self.sums, self.variances)


class _TargetTable(_Table):
    today: _DayTable
    days: Annotated[list[_DayTable], Field(max_length=DAYS_KEPT)]
    above: _FourNotNegative
    below: _FourNotNegative
    drifts: bool
    radius_px: Annotated[float, Field(gt=0, le=1e5)]

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        numbers = [day.number for day in (*self.days, self.today)]
        if any(later <= earlier for earlier, later in pairwise(numbers)):
            raise ValueError("the days are not in their order")
        if self.drifts and not self.days:
            raise ValueError("a drift without a day that shows it")
        return self

    def history(self) -> TargetHistory:
        days = tuple(day.day() for day in self.days)
        return TargetHistory(self.today.day(), days, self.above, self.below, self.drifts, self.radius_px)


class _HistoryTable(_Table):
    targets: dict[str, _TargetTable]
    was_bad: bool = False


def document_of(history: History) -> dict[str, Any]:
    """The history as plain JSON types: at most some 10 kB for each target."""
    targets = {name: asdict(target) for name, target in history.targets.items()}
    return {"targets": targets, "was_bad": history.was_bad}


def history_of(document: Mapping[str, Any], targets: Iterable[str]) -> History:
    """The history that a document of ``document_of`` holds; raises ValueError in one line.

    ``targets`` are those of the calibration; one that is none of them is an error.
    """
    try:
        table = _HistoryTable.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from error
    if foreign := set(table.targets) - set(targets):
        raise ValueError(f"targets.{min(foreign)}: the calibration has no such target")
    return History({name: target.history() for name, target in table.targets.items()}, table.was_bad)
