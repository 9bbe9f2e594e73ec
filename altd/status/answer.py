"""Base of everything that is sent as an object in JSON, as pydantic models from which schemas are made."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class Answer(BaseModel):
    """An object without keys other than those listed here."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    def as_object(self) -> dict[str, Any]:
        """Return the known keys as plain JSON types."""
        return self.model_dump(mode="json", exclude_unset=True)
