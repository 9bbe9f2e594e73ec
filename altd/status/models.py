"""The shape of what several interfaces send, as pydantic models: schemas are made of them.

The documents themselves are made elsewhere, byte for byte; the tests hold them against these.
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
    """An object whose keys are all named here."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


class Cause(Answer):
    """Something that is wrong, with what to do about it."""

    code: str
    signal: Signal
    of: str | None
    """The target or component; null: the whole unit."""
    active: bool
    """Whether it is true just now; else it is shown for a while after."""
    for_s: float
    times: int
    brief: str
    remedy: str
    detail: str


class UnitState(Answer):
    """The unit's state in the signals of NAMUR NE 107."""

    signal: Signal
    number: int
    """Number of the signal in OPC 10000-100, table 22."""
    for_s: float
    causes: list[Cause]
    """The worst first."""


class Sensor(Answer):
    """State and age of the value of another sensor when the measurement was published."""

    quality: Quality
    age_s: float | None


def measurement_model(quantities: Quantities) -> type[BaseModel]:
    """The measurement of a unit with these quantities, as ``altd/status/measurement_json.py`` writes it."""
    with_sigma = [quantity for quantity in quantities.of_unit if quantity.has_sigma]
    of_target = _numbers("TargetValues", "The values of one target.", quantities.of_target, "")
    sigma = _numbers("Sigma", "Combined standard uncertainties (1 sigma) of the means.", with_sigma, "")
    sigma_random = _numbers("SigmaRandom", "The part of sigma that scatters.", with_sigma, "")
    sigma_now = _numbers("SigmaNow", "The same as statements about where the beam is now.", with_sigma, "")
    sigma_rates = _numbers("SigmaRates", "Standard deviations of the rates.", with_sigma, "_per_s")
    rates = _numbers("Rates", "How fast quantities change.", with_sigma, "_per_s", sigma=sigma_rates)

    class Measurement(Answer):
        """One measurement. Use its numbers only when `valid` is true; what is not known is null.

        Next to the keys that are named here there is one for each target, by the target's name.
        """

        model_config = ConfigDict(extra="allow")
        sequence: int
        """Number of the newest exposure; it increases, with gaps."""
        time: str | None
        """UTC, ISO 8601, of the middle of the exposures."""
        t_s: float
        frames: int
        """Exposures that were averaged."""
        valid: bool
        status: list[str]
        """The codes of reasons and warnings."""
        sensors: dict[str, Sensor] = Field(default={})
        """Only where another sensor is fitted."""
        unit: str | None
        session: str | None
        """Drawn by chance at the start of the daemon."""
        message: int
        published: int
        """Measurements since the start of the daemon."""
        clock_ms: int
        age_s: float | None
        """Seconds from the middle of the exposures until it was sent."""
        crc32: str
        """Of all bytes before `, "crc32":`."""

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
    """One target of a row with its place, below ``targets``; None: the instrument is no row."""
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
    """An object with a number, or null, for each quantity."""
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
