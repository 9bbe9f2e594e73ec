"""Pydantic models of the responses, from which the OpenAPI document is generated.

The responses themselves are made elsewhere, byte for byte (``altd/status``); tests check them by the models.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from altd.status.health import State
from altd.status.models import Answer, UnitState


class Error(Answer):
    """Reason why a request failed. Every error has this form."""

    error: str
    """Reason, as one sentence for people."""
    status: list[str] = Field(default=[])
    """Codes of the reasons, only if a measurement was requested and there is none."""


class Span(Answer):
    """Share of a time span in which the measurement was valid."""

    share: float | None
    valid_s: float
    observed_s: float
    lost_s: dict[str, float]
    """Lost time by the code of its reason, s."""
    since: str | None
    """Start of the observed time, UTC, not earlier than the span's name implies; null: not known."""


class Availability(Answer):
    """Shares of time in which the unit made valid measurements, by span."""

    last_hour: Span
    last_day: Span
    last_31_days: Span
    since_start: Span


class Component(Answer):
    """A component of the daemon; its figures and counters are further keys."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, int | float | str | None] = Field(init=False)
    state: State
    message: str
    for_s: float
    """Time since its state last changed, s."""


class Status(Answer):
    """Identity of the unit, its state, its availability and its components."""

    version: str = ""
    serial: str = ""
    unit_number: str = ""
    """CRC-32 of the serial number, as `unit` in every message."""
    calibration: str = ""
    config_sha256: str = ""
    """SHA-256 of the config file as the daemon read it."""
    spot_fit: str = ""
    """Spot fit in use: `compiled`, or `numpy` and the reason; numpy finds the same and takes more CPU."""
    state: UnitState | None = None
    availability: Availability | None = None
    components: dict[str, Component]


class TargetDrift(Answer):
    """Result of a self-check for one target."""

    leds_expected: int
    leds_found: int
    shift_px: list[float] | None
    turn_deg: float | None
    scale_ppm: float | None
    rms_px: float | None
    significance: float | None
    is_similarity: bool | None
    leds: list[str]
    foreign_px: list[list[float]]
    detail: str


class PartVerdict(Answer):
    """Verdict on one target, or on yaw and pitch."""

    of: str
    verdict: Literal["good", "suspect", "bad", "unknown"]
    unit: str
    error: float | None
    """Largest error anywhere in the calibrated area, in `unit`; null: too few LEDs were found."""
    sigma: float | None
    suspect: float
    """Limit of `error` above which the verdict is `suspect`; likewise `bad`."""
    bad: float


class SelfCheck(Answer):
    """Report of the last self-check; without one, `verdict` is null and `reasons` gives the cause."""

    verdict: Literal["good", "suspect", "bad", "unknown"] | None
    reasons: list[str]
    parts: list[PartVerdict] = Field(default=[])
    unavailable: str = ""
    """Reason why this unit cannot make self-checks; empty: it can."""
    targets: dict[str, TargetDrift] = Field(default={})
    yaw_deg: float | None = None
    """Error that the drift causes at the beam's position, measured minus true; likewise the next three."""
    pitch_deg: float | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    sigma: dict[str, float | None] = Field(default={})
    number: int = 0
    """Number of this check since the start, from 1."""
    cause: str = ""
    time: str | None = None
    exposures_lost: int = 0
    notes: list[str] = Field(default=[])


class TargetArea(Answer):
    """A target and its area of valid spots."""

    name: str
    z_mm: float
    """Distance from the front target along the beam, mm."""
    valid_mm: list[tuple[float, float]]
    """Corners (x, y) of the area in which a spot is valid, in the unit frame, counter-clockwise, mm."""


class Targets(Answer):
    """Targets in beam order."""

    area_mm: tuple[float, float]
    """Width and height of the area that the unit is made for, mm; its centre is the unit frame's origin."""
    targets: list[TargetArea]


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


class Recording(Answer):
    """Frames of the last seconds, kept on the unit."""

    name: str
    why: str
    """Code of the cause with its target or component, or the user that requested the recording."""
    start: str | None
    """Time of its first frame, UTC; null: not known."""
    seconds: float
    exposures: int
    bytes: int
    """Size on the unit's disk, bytes."""
    marked: bool
    """Whether the recording is kept when space is needed."""


class Recordings(Answer):
    """Recordings that the unit has kept."""

    unavailable: str
    """Reason why the unit keeps no recordings; empty: it keeps them."""
    recordings: list[Recording]
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
