"""Messages between a unit's outbox and the ingest, as both sides read them.

A batch states ``first`` to ``last``: each sequence in it is a row, or was dropped by the unit. ``file`` is a
history, ``stream`` one opening of it. The reader of a batch checks its CRC first (``proof.is_sealed``).
"""

from __future__ import annotations

import itertools
import json
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from altd.status.proof import sealed

SCHEMA = 1
MAX_NUMBERS = 2500
"""Maximum number of numbers in one batch: 100 seconds of a beam, 16 kB, 2 s on a line of 64 kbit/s."""

MAX_QUANTITIES = 128

_Whole = Annotated[int, Field(ge=0, lt=2**53)]
_Count = Annotated[int, Field(ge=0, lt=2**31)]
"""A number in a column of 32 bits."""
_Code = Annotated[str, Field(pattern=r"^[A-Za-z0-9_. -]*$", max_length=80)]
_Random = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
_Key = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_.]*$", max_length=80)]
_Serial = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$")]
_Statistics = tuple[float, float | None, float, float]


class Second(NamedTuple):
    """A summary of 1 s; ``boot`` is the history's epoch, ``t_s`` the UTC second at which it begins.

    ``worst`` is the severity of the unit's state, ``cause`` its code; ``lost_to`` is the worst reason of the
    invalid measurements. Values of each quantity: mean, sigma, lowest, highest; None: not known.
    """

    sequence: _Whole
    boot: _Count
    t_s: Annotated[int, Field(ge=0, lt=2**35)]
    n: _Count
    n_valid: _Count
    worst: Annotated[int, Field(ge=0, le=4)]
    cause: _Code
    lost_to: _Code
    values: Annotated[list[_Statistics | None], Field(max_length=MAX_QUANTITIES)]


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False, extra="ignore")

    schema_: Annotated[int, Field(ge=SCHEMA, le=SCHEMA, alias="schema")]
    serial: _Serial
    stream: _Random


class Batch(_Message):
    """Consecutive seconds of a unit.

    The unit has no seconds below ``oldest`` any more; its newest is ``newest``. ``dropped`` counts the
    seconds deleted before they were acknowledged, since the file was created.
    """

    file: _Random
    oldest: Annotated[int, Field(ge=1, lt=2**53)]
    first: Annotated[int, Field(ge=1, lt=2**53)]
    last: _Whole
    newest: _Whole
    dropped: _Whole
    quantities: Annotated[list[_Key], Field(max_length=MAX_QUANTITIES)]
    rows: Annotated[list[Second], Field(max_length=MAX_NUMBERS)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        sequences = [row.sequence for row in self.rows]
        if not self.oldest <= self.first <= self.last:
            raise ValueError("oldest, first and last are not in order")
        if sequences and not (self.first <= sequences[0] and sequences[-1] <= self.last):
            raise ValueError("a row is not between first and last")
        if any(after <= before for before, after in itertools.pairwise(sequences)):
            raise ValueError("the rows are not in order")
        if any(len(row.values) != len(self.quantities) or row.n_valid > row.n for row in self.rows):
            raise ValueError("a row does not fit its quantities")
        return self


class Acknowledgement(_Message):
    """The ingest has stored all sequences of a stream up to this one in its database."""

    sequence: _Whole


def acknowledgement_of(serial: str, stream: str, sequence: int) -> str:
    """Return the ingest's acknowledgement as a sealed line."""
    return sealed(json.dumps({"schema": SCHEMA, "serial": serial, "stream": stream, "sequence": sequence}))
