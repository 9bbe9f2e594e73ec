"""Pydantic models of the responses that only this interface sends."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from altd.status.answer import Answer
from altd.status.services import KeptRecording


class Error(Answer):
    """Reason why a request failed. Every error has this form."""

    error: str
    """Reason, as one sentence for people."""
    status: list[str] = Field(default=[])
    """Codes of the reasons, only if a measurement was requested and there is none."""


class Login(Answer):
    """User name and password for a login."""

    name: str = Field(max_length=32)
    password: str = Field(max_length=1024)


class Session(Answer):
    """The logged-in user, and the permissions of the client."""

    name: str | None
    """Name of the logged-in user; null: no user."""
    may_act: bool
    """Whether this client may act, such as request a self-check; a token in the request does not count."""
    login: bool
    """Whether login is possible: whether credentials are set."""


class TrendOfQuantity(Answer):
    """Columns of a quantity: for each point a number, or null if it was not known."""

    mean: list[float | None]
    sigma: list[float | None]
    """Standard deviation (1 sigma) of one measurement."""
    low: list[float | None]
    high: list[float | None]


class Trend(Answer):
    """Points in the order of time, as columns of equal length; times without a running daemon have none."""

    source: str
    """Summaries behind the points: `seconds`, `minutes` or `hours`; `none`: the time span is empty."""
    span_s: float
    """Duration of a point, s."""
    t_s: list[float]
    """Start of each point, seconds since 1970, UTC."""
    n: list[int]
    """Number of measurements in each point."""
    n_valid: list[int]
    worst: list[int]
    """Severity of the unit's worst state in each point: 0 good, 1 maintenance required to 4 failure."""
    worst_code: list[str]
    lost_to: list[str]
    """Worst reason of the invalid measurements in each point; empty: none."""
    quantities: dict[str, TrendOfQuantity]


class Event(Answer):
    """An event of the unit."""

    id: int
    time: str | None
    epoch: int
    """Number of the epoch of the clock; within one epoch, time only increases."""
    severity: int
    kind: str
    of: str | None
    text: str
    detail: dict[str, Any]
    held_back: int
    """Number of earlier events of its kind that were counted but not stored."""


class Events(Answer):
    """Events, the newest first."""

    events: list[Event]


class Recordings(Answer):
    """Recordings that the unit has kept."""

    unavailable: str
    """Reason why the unit keeps no recordings; empty: it keeps them."""
    recordings: list[KeptRecording]
    """Recordings, the newest first."""


class Document(BaseModel):
    """An OpenAPI document."""

    model_config = ConfigDict(extra="allow")
    openapi: str


class Alive(Answer):
    """Response of a running daemon."""

    alive: Literal[True]


class Ready(Answer):
    """The unit measures, valid or not; `/api/v1/measurement` reports the validity."""

    ready: Literal[True]
