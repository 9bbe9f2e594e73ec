"""The measurement object and its model: a line of ``altd replay``, the body of HTTP and MQTT."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from types import GenericAlias
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from altd.files.documents import line_of
from altd.reasons import Reason
from altd.records import FloatArray, Measurement, Quantities, Quantity, Value, utc_text
from altd.records.sensors import Quality, SensorValue
from altd.status.answer import Answer
from altd.status.board import Board
from altd.status.cross_check import CrossCheckedMeasurement, cross_check_object
from altd.status.proof import Stamp, sealed

_KNOWN_DECIMALS = 4
"""Decimals of the stage's beam position, mm, and of a measurement's difference from it."""
_AGE_DECIMALS = 3
_REASONS = frozenset(map(str, Reason))
Matrix = list[list[float | None]]


def as_object(measurement: Measurement) -> dict[str, Any]:
    """Return the measurement as plain JSON types; an unknown value is None, never a number."""
    quantities, codes = measurement.quantities, [str(fault) for fault in measurement.status]
    return {
        "sequence": measurement.sequence,
        "time": None if measurement.time is None else utc_text(measurement.time),
        "t_s": round(measurement.t_ns * 1e-9, 6),
        "frames": measurement.frames,
        "valid": measurement.valid,
        "status": codes,
        **_values(quantities.of_unit, measurement.known),
        "sigma": _sigmas(quantities, measurement.sigma),
        "sigma_random": _sigmas(quantities, measurement.sigma_random),
        **_matrix("covariance", quantities, measurement.covariance()),
        **targets_object(quantities, measurement.targets, measurement.known_of, codes),
        **points_object(quantities, measurement.known),
        **_sensors(measurement),
    }


def as_object_now(measurement: Measurement, age_s: float | None) -> dict[str, Any]:
    """Return the object as sent by a running unit, ``age_s`` after the middle of the exposures.

    Adds ``rates``, per second and with their ``sigma``, and ``sigma_now``: the standard deviation as a
    statement about the true value at that age, and ``cross_check``. None: not known.
    """
    quantities = [quantity for quantity in measurement.quantities.of_unit if quantity.has_sigma]
    rates = measurement.rates
    return as_object(measurement) | {
        "sigma_now": {
            quantity.key: _rounded(
                None if age_s is None else measurement.sigma_at(quantity.key, age_s), quantity.decimals
            )
            for quantity in quantities
        },
        **_matrix(
            "covariance_now",
            measurement.quantities,
            None if age_s is None else measurement.covariance(age_s),
        ),
        "rates": {
            **{f"{quantity.key}_per_s": _rate(rates, quantity, "value") for quantity in quantities},
            "sigma": {f"{quantity.key}_per_s": _rate(rates, quantity, "sigma") for quantity in quantities},
        },
        **cross_check_object(measurement),
    }


def as_scan_object(measurement: Measurement, known_mm: tuple[float, float]) -> dict[str, Any]:
    """Return the object of a scan whose stage put the beam at (x, y) mm on every target.

    Adds ``known_x_mm``, ``known_y_mm``, and measured minus known as ``dx_mm``, ``dy_mm``, of the displacement
    and of each target.
    """
    document = as_object(measurement)
    axes = dict(zip("xy", known_mm, strict=True))
    for target, values in measurement.targets.items():
        document[target] |= _difference(values or {}, axes)
    document |= {f"known_{axis}_mm": round(known, _KNOWN_DECIMALS) for axis, known in axes.items()}
    return document | _difference(measurement.values, axes)


def _sigmas(quantities: Quantities, sigma: Callable[[str], float | None]) -> dict[str, float | None]:
    return {
        each.key: _rounded(sigma(each.key), each.decimals) for each in quantities.of_unit if each.has_sigma
    }


def _matrix(key: str, quantities: Quantities, covariance: FloatArray | None) -> dict[str, Matrix]:
    """Return the rows of a covariance with six digits; nothing for an instrument that publishes none."""
    size = len(quantities.joint)
    known = [[math.nan] * size] * size if covariance is None else covariance.tolist()
    rows = [[float(f"{each:.6g}") if math.isfinite(each) else None for each in row] for row in known]
    return {key: rows} if rows else {}


def _values(
    quantities: tuple[Quantity, ...], known: Callable[[str], Value | None]
) -> dict[str, float | None]:
    return {each.key: _rounded(_number(known(each.key)), each.decimals) for each in quantities}


def targets_object(
    quantities: Quantities, targets: Iterable[str], known: Callable[[str], Value | None], codes: Sequence[str]
) -> dict[str, Any]:
    """Return each target's values by name; targets of a row below ``targets``, with status and place.

    ``known`` returns the value of a key of the unit, or of ``TARGET.KEY``. ``codes`` are those of the
    measurement.
    """
    if not quantities.has_places:
        return {
            target: {
                each.key: _rounded(_number(known(f"{target}.{each.key}")), each.decimals)
                for each in quantities.of_target
            }
            for target in targets
        }
    return {"targets": {target: _place(quantities, target, known, codes) for target in targets}}


def points_object(quantities: Quantities, known: Callable[[str], Value | None]) -> dict[str, Any]:
    """Return the machine's points by name below ``points``; nothing if there are none."""
    points: dict[str, dict[str, Any]] = {}
    for each in filter(lambda each: each.point, quantities.of_unit):
        value, key = known(each.key), each.key.removeprefix(f"{each.point}_")
        of = points.setdefault(each.point, {})
        sigma = {**of.pop("sigma", {}), key: _rounded(None if value is None else value.sigma, each.decimals)}
        of |= {key: _rounded(_number(value), each.decimals), "sigma": sigma}
    return {"points": points} if points else {}


def _place(
    quantities: Quantities, target: str, known: Callable[[str], Value | None], codes: Sequence[str]
) -> dict[str, Any]:
    rows = [(each.key, each, known(f"{target}.{each.key}")) for each in quantities.of_target]
    rows += [
        (each.key.removeprefix(f"{target}_"), each, known(each.key))
        for each in quantities.of_unit
        if each.place == target
    ]
    said = (code.removeprefix(f"{target}_") for code in codes if code.startswith(f"{target}_"))
    return {
        "valid": any(value is not None for _, _, value in rows),
        "status": [code for code in said if code in _REASONS],
        **{key: _rounded(_number(value), each.decimals) for key, each, value in rows},
        "sigma": {
            key: _rounded(None if value is None else value.sigma, each.decimals)
            for key, each, value in rows
            if each.has_sigma
        },
    }


def _number(value: Value | None) -> float | None:
    return None if value is None else value.value


def _sensors(measurement: Measurement) -> dict[str, Any]:
    """Return state and age of each sensor's value; empty if no such sensor is fitted."""
    if not measurement.from_sensors:
        return {}
    return {
        "sensors": {
            key: {"quality": str(said.quality), "age_s": _rounded(said.age_s, _AGE_DECIMALS)}
            for key, said in measurement.from_sensors.items()
        }
    }


def _rate(rates: Mapping[str, Value], quantity: Quantity, field: str) -> float | None:
    return _rounded(getattr(rates.get(quantity.key), field, None), quantity.decimals)


def _difference(values: Mapping[str, Value], known_mm: Mapping[str, float]) -> dict[str, float | None]:
    """Return measured minus known, of x and y."""
    return {
        f"d{axis}_mm": _rounded(
            values[f"{axis}_mm"].value - known if f"{axis}_mm" in values else None, _KNOWN_DECIMALS
        )
        for axis, known in known_mm.items()
    }


def _rounded(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)


PROOF_KEYS = ("unit", "session", "message", "published", "clock_ms", "age_s", "crc32")
"""Keys that follow those of the measurement, in this order."""


def proof_of(board: Board, stamp: Stamp) -> dict[str, Any]:
    """Return the keys before ``crc32``, for the board's present content."""
    identity, age_s = stamp.identity, board.age_s()
    return {
        "unit": _hexadecimal(identity.unit),
        "session": _hexadecimal(identity.session),
        "message": stamp.message,
        "published": board.published,
        "clock_ms": stamp.clock_ms,
        "age_s": None if age_s is None else round(age_s, 3),
    }


def checked_line(board: Board, measurement: Measurement, stamp: Stamp) -> str:
    """Return the board's current reading with its proof, as one line of JSON without the line end."""
    return with_proof(as_object_now(measurement, board.age_s()), board, stamp)


def with_proof(document: Mapping[str, Any], board: Board, stamp: Stamp) -> str:
    """Return a document as one line of JSON, with the keys of the proof at its end.

    The last member is ``crc32`` of all bytes before ``, "crc32":``, as they are sent.
    """
    return sealed(line_of({**document, **proof_of(board, stamp)}))


def reserved_names(quantities: Quantities) -> frozenset[str]:
    """Return the keys of the measurement object in any of its forms; no target may have such a name."""
    sensors = {quantity.key: SensorValue(Quality.STARTING) for quantity in quantities.of_unit}
    without_targets = Measurement(0, 0, None, 0, quantities, {}, {}, from_sensors=sensors)
    objects = as_object_now(without_targets, None) | as_scan_object(without_targets, (0.0, 0.0))
    return frozenset(objects).union(PROOF_KEYS)


def _hexadecimal(number: int | None) -> str | None:
    return None if number is None else f"{number:08X}"


class Sensor(Answer):
    """State and age (s) of another sensor's value when the measurement was published."""

    quality: Quality
    age_s: float | None


class PointSigma(Answer):
    """Combined standard uncertainties (1 sigma) of a point's distances."""

    right_mm: float | None
    up_mm: float | None


class Point(Answer):
    """Distances of a point of the machine from the beam, in the world of gravity; null: not known."""

    right_mm: float | None
    up_mm: float | None
    sigma: PointSigma


def measurement_model(quantities: Quantities) -> type[BaseModel]:
    """Return the model of a measurement, as ``as_object_now`` writes it."""
    with_sigma = [quantity for quantity in quantities.of_unit if quantity.has_sigma]
    of_target = _numbers("TargetValues", "The values of one target.", quantities.of_target, "")
    sigma = _numbers("Sigma", "Combined standard uncertainties (1 sigma) of the means.", with_sigma, "")
    sigma_random = _numbers("SigmaRandom", "The part of sigma that scatters.", with_sigma, "")
    sigma_now = _numbers("SigmaNow", "The same as statements about where the beam is now.", with_sigma, "")
    sigma_rates = _numbers("SigmaRates", "Standard deviations of the rates.", with_sigma, "_per_s")
    rates = _numbers("Rates", "How fast quantities change.", with_sigma, "_per_s", sigma=sigma_rates)

    class Measurement(Answer):
        """One measurement. Use its numbers only when `valid` is true; null means not known.

        In addition to the keys listed here, there is one key for each target, with the target's name.
        """

        model_config = ConfigDict(extra="allow")
        sequence: int
        """Number of the newest exposure; it increases, with gaps."""
        time: str | None
        """UTC, ISO 8601, of the middle of the exposures."""
        t_s: float
        frames: int
        """Number of averaged exposures."""
        valid: bool
        status: list[str]
        """Codes of reasons and warnings."""
        sensors: dict[str, Sensor] = Field(default={})
        """State of each other sensor's value; only if another sensor is fitted."""
        unit: str | None
        session: str | None
        """Random number, drawn at the start of the daemon."""
        message: int
        published: int
        """Number of measurements since the start of the daemon."""
        clock_ms: int
        age_s: float | None
        """Time from the middle of the exposures until sending, s."""
        crc32: str
        """CRC-32 of all bytes before `, "crc32":`."""

    more: dict[str, Any] = {}
    if quantities.joint:
        of = f"Covariance of {', '.join(quantities.joint)}, in this order and in the products of their units"
        more = {
            "covariance": (Matrix, Field(description=f"{of}: of the means.")),
            "covariance_now": (
                Matrix,
                Field(description="The same as a statement about where the beam is now."),
            ),
        }
    if any(each.point for each in quantities.of_unit):
        more["points"] = (dict[str, Point], Field(description="Points of the machine, by name."))
    if quantities.has_cross_check:
        more["cross_check"] = (CrossCheckedMeasurement, ...)
    of_row = place_model(quantities)
    beside: dict[str, Any] = (
        {"__pydantic_extra__": (GenericAlias(dict, (str, of_target)), Field(init=False))}
        if of_row is None
        else {"targets": (GenericAlias(dict, (str, of_row)), ...)}
    )
    return create_model(
        "Measurement",
        __base__=Measurement,
        __doc__=Measurement.__doc__,
        **beside,
        **_fields(quantities.of_unit, ""),
        sigma=(sigma, ...),
        sigma_random=(sigma_random, ...),
        sigma_now=(sigma_now, ...),
        **more,
        rates=(rates, ...),
    )


def place_model(quantities: Quantities) -> type[BaseModel] | None:
    """Return the model of a row's target, below ``targets``; None: the instrument is not a row."""
    first = next((each.place for each in quantities.of_unit if each.place), None)
    if first is None:
        return None
    values = [
        *quantities.of_target,
        *(
            replace(each, key=each.key.removeprefix(f"{first}_"), label=each.label.removeprefix(f"{first} "))
            for each in quantities.of_unit
            if each.place == first
        ),
    ]
    with_sigma = [each for each in values if each.has_sigma]
    return create_model(
        "Place",
        __base__=Answer,
        __doc__="A target of a row: whether it was measured, its own reasons and warnings, its numbers.",
        valid=(bool, ...),
        status=(list[str], ...),
        **_fields(values, ""),
        sigma=(_numbers("PlaceSigma", "Combined standard uncertainties.", with_sigma, ""), ...),
    )


def _numbers(
    name: str, meaning: str, quantities: Sequence[Quantity], suffix: str, sigma: type[BaseModel] | None = None
) -> type[BaseModel]:
    """Return the model of an object with a number, or null, for each quantity."""
    more: dict[str, Any] = {} if sigma is None else {"sigma": (sigma, ...)}
    return create_model(name, __base__=Answer, __doc__=meaning, **_fields(quantities, suffix), **more)


def _fields(quantities: Sequence[Quantity], suffix: str) -> dict[str, Any]:
    per = "/s" if suffix else ""
    return {
        quantity.key + suffix: (
            float | None,
            Field(description=f"{quantity.label}, {quantity.unit}{per}: {quantity.meaning}"),
        )
        for quantity in quantities
    }
