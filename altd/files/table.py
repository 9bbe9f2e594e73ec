"""The base of the tables of ``altd.toml``, and the report of a fault of the settings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import date, time
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

FAULTS = "faults"
"""Type of our own models' pydantic errors; ``ctx["faults"]`` contains keys and reason of each fault."""

_MAX_SHOWN_LETTERS = 60


def complaint(*faults: tuple[Sequence[str | int], str]) -> PydanticCustomError:
    """Return the error of a conflict between keys: each key, relative to the model, and the reason."""
    return PydanticCustomError(FAULTS, "{text}", {"faults": faults, "text": "; ".join(f[1] for f in faults)})


def shown(value: object) -> str:
    """Return a value approximately as written in the file."""
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    if isinstance(value, date | time):
        return str(value)
    text = value if isinstance(value, str) else repr(value)
    cut = text if len(text) <= _MAX_SHOWN_LETTERS else f"{text[:_MAX_SHOWN_LETTERS]}…"
    if isinstance(value, bool):
        return cut.lower()
    return json.dumps(cut, ensure_ascii=False) if isinstance(value, str) else cut


NAME_PATTERN = r"^[a-z][a-z0-9_]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN, min_length=1, max_length=32)]
GpioLineName = Annotated[str, Field(min_length=1, max_length=64)]
TcpPort = Annotated[int, Field(ge=0, le=65535)]
Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
"""Position or offset, mm: 100 m reach from a unit to the head of its machine, and fit the registers."""
StageMillimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
OffsetDegrees = Annotated[float, Field(ge=-45, le=45)]
"""Offset of an angle: with the beam's own 14° it stays well below 90°, where mm/m is infinite."""
Celsius = Annotated[float, Field(ge=-100, le=200)]
ControlValue = Annotated[int, Field(ge=-(2**63), le=2**63 - 1)]
"""Value of a 64-bit control, the kernel's largest."""


def _device(path: Path) -> Path:
    if not path.is_absolute():
        raise complaint(
            ((), f"{shown(str(path))} is not the path of a device; possible: one that begins with /dev/")
        )
    return path


Device = Annotated[Path, AfterValidator(_device)]
"""Absolute path of a device; a relative path would depend on the folder in which altd was started."""


class Table(BaseModel):
    """Base of the file's tables: unknown keys are refused, and values are immutable."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
