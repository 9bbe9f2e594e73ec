"""A round as one JSON object: a line of ``altd replay`` (docs/chain.md)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import datetime
from typing import Any

from altd.instruments.chain.instrument import RoundResult, TargetResult
from altd.records import Fault, FloatArray, utc_text

_DECIMALS = 4


def as_object(result: RoundResult, time: datetime | None, origin: Iterable[Fault]) -> dict[str, Any]:
    """The round as plain JSON types; None: not known. ``origin``: warnings of the frames' source."""
    return {
        "sequence": result.sequence,
        "time": None if time is None else utc_text(time),
        "t_s": round(result.t_ns * 1e-9, 6),
        "frames": result.frames,
        "valid": result.valid,
        "status": [*result.status, *map(str, origin)],
        "targets": {name: _target(target) for name, target in result.targets.items()},
    }


def _target(target: TargetResult) -> dict[str, Any]:
    place, displacement, rate = target.place, target.displacement, target.rate
    values = {
        **_axes("{}_mm", None if place is None else place.mm),
        **_axes("d{}_mm", None if displacement is None else displacement.mm),
        **_axes("d{}_mm_per_day", None if rate is None else rate.mm_per_day),
    }
    sigma = {
        **_axes("{}_mm", None if place is None else _sigmas(place.covariance_mm2)),
        **_axes("d{}_mm", None if displacement is None else _sigmas(displacement.covariance_mm2)),
        **_axes("d{}_mm_per_day", None if rate is None else rate.sigma),
    }
    significance = None if displacement is None else _rounded(displacement.significance)
    status = list(target.status)
    return {
        "valid": place is not None,
        "status": status,
        **values,
        "significance": significance,
        "sigma": sigma,
    }


def _sigmas(covariance: FloatArray) -> list[float]:
    return [math.sqrt(variance) for variance in covariance.diagonal().tolist()]


def _axes(key: str, values: Iterable[float] | FloatArray | None) -> dict[str, float | None]:
    pair = (None, None) if values is None else tuple(map(float, values))
    return {key.format(axis): _rounded(value) for axis, value in zip("xy", pair, strict=True)}


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, _DECIMALS)
