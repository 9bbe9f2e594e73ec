"""Power on each target of a row: transmission^n."""

from __future__ import annotations

from altd.config import RowSettings


def powers_mw(settings: RowSettings, targets: int) -> tuple[float, ...]:
    """Power on each target in beam order, with all glasses before it clear: P τⁿ."""
    return tuple(settings.laser_mw * settings.transmission**before for before in range(targets))
