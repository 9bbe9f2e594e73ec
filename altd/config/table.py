"""What the tables of ``altd.toml`` have in common: frozen, unknown keys refused, units in the keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from altd.config.complaints import complaint, shown

NAME_PATTERN = r"^[a-z][a-z0-9_]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN, min_length=1, max_length=32)]
GpioLineName = Annotated[str, Field(min_length=1, max_length=64)]
TcpPort = Annotated[int, Field(ge=0, le=65535)]
Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
"""A place or an offset: 100 m reach from a unit to the head of its machine, and fit the registers."""
StageMillimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
OffsetDegrees = Annotated[float, Field(ge=-45, le=45)]
"""With the beam's own 14° it stays well below 90°, where mm/m has no end."""
Celsius = Annotated[float, Field(ge=-100, le=200)]
ControlValue = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
"""What the kernel's largest control holds."""


def _device(path: Path) -> Path:
    if not path.is_absolute():
        raise complaint(
            ((), f"{shown(str(path))} is no path of a device; possible: one that begins with /dev/")
        )
    return path


Device = Annotated[Path, AfterValidator(_device)]
"""A device of the computer. A path that does not begin with / would count from wherever altd was started."""


class Table(BaseModel):
    """A table of the file: its keys are all known, its values do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)
