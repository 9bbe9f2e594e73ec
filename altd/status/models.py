"""Shape of what several interfaces send, as pydantic models from which schemas are made.

Other modules write the documents, byte for byte; tests compare them with these models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import GenericAlias
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from altd.reasons import Signal
from altd.records import Quantities, Quantity
from altd.records.sensors import Quality


class Answer(BaseModel):
    """An object without keys other than those listed here."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


class Cause(Answer):
    """A fault and its remedy."""

    code: str
    signal: Signal
    of: str | None
    """Name of the target or component; null: the whole unit."""
    active: bool
    """Whether it is true now; otherwise it is still shown for a while."""
    for_s: float
    times: int
    brief: str
    remedy: str
    detail: str


class UnitState(Answer):
    """State of the unit in the signals of NAMUR NE 107."""

    signal: Signal
    number: int
    """Number of the signal in OPC 10000-100, table 22."""
    for_s: float
    causes: list[Cause]
    """Causes, the worst first."""


class Sensor(Answer):
    """State and age (s) of another sensor's value when the measurement was published."""

    quality: Quality
    age_s: float | None


def measurement_model(quantities: Quantities) -> type[BaseModel]:
    """Return the model of a measurement, as ``altd/status/measurement_json.py`` writes it."""
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
