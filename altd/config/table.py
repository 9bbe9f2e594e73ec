"""What the tables of ``altd.toml`` have in common: frozen, unknown keys refused, units in the keys."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=32)]
GpioLineName = Annotated[str, Field(min_length=1, max_length=64)]
TcpPort = Annotated[int, Field(ge=0, le=65535)]
Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A place or an offset: 100 m reach from a unit to the head of its machine, and fit the registers."""
StageMillimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
OffsetDegrees = Annotated[float, Field(ge=-45, le=45)]
"""With the beam's own 14° it stays well below 90°, where mm/m has no end."""
ControlValue = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
"""What the kernel's largest control holds."""


class Table(BaseModel):
    """A table of the file: its keys are all known, its values do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)
