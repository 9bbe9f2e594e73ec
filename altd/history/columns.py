"""How quantities stand in the history: as whole numbers of the last decimal that is published.

A column is named by its quantity's number in the file, never by its key. What is not known is NULL. SQLite
stores a whole number in as many bytes as it needs: 110 mm in steps of 0.0001 mm takes three, a sigma one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from altd.records import Measurement, Quantities, Quantity, Value

_MAX_UNITS = 2**53
"""Beyond this a float is no exact whole number; no quantity of a unit comes near."""


@dataclass(frozen=True, slots=True)
class Column:
    """A quantity as a file has it.

    ``key`` is that of the unit's quantity, or ``TARGET.KEY``. ``is_summarised``: the summaries hold it too;
    ``is_from_sensor``: it may be known while the measurement is invalid.
    """

    key: str
    unit: str
    decimals: int
    label: str
    is_summarised: bool
    is_from_sensor: bool

    @property
    def identity(self) -> tuple[str, str, int]:
        """What may not change while its numbers stay what they are."""
        return self.key, self.unit, self.decimals

    def steps(self, value: float | None) -> int | None:
        """A value as a whole number of steps of its last decimal; None: not known, or no number."""
        if value is None or not math.isfinite(value):
            return None
        steps = round(value * 10**self.decimals)
        return steps if abs(steps) < _MAX_UNITS else None

    def value(self, steps: float | None) -> float | None:
        """What so many steps are; a mean may have parts of a step."""
        return None if steps is None else round(steps / 10**self.decimals, self.decimals)


def columns_of(quantities: Quantities, targets: Iterable[str]) -> tuple[Column, ...]:
    """The columns of a unit: all of its quantities, then those of its targets.

    Summaries hold what a person is shown: neither a quantity again in another unit, nor one of a sensor that
    is not fitted.
    """
    shown = {quantity.key for quantity in quantities.shown}
    of_unit = [_column(quantity, "", quantity.key in shown) for quantity in quantities.of_unit]
    of_targets = [
        _column(quantity, f"{target}.", False) for target in targets for quantity in quantities.of_target
    ]
    return (*of_unit, *of_targets)


def _column(quantity: Quantity, prefix: str, is_summarised: bool) -> Column:
    return Column(
        prefix + quantity.key,
        quantity.unit,
        quantity.decimals,
        quantity.label,
        is_summarised,
        quantity.is_from_sensor,
    )


def value_of(measurement: Measurement, column: Column) -> Value | None:
    """What a measurement says of a column's quantity; None: not known."""
    target, _, key = column.key.rpartition(".")
    if target:
        return (measurement.targets.get(target) or {}).get(key)
    return measurement.known(key)
