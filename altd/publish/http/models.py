"""Contents of the answers, as pydantic models: the OpenAPI document is made of these.

The answers themselves are made elsewhere, byte for byte (``altd/status``); the tests hold them against these.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from altd.status.health import State
from altd.status.models import Answer, UnitState


class Error(Answer):
    """Why a request was not answered as it wished. Every error has this shape."""

    error: str
    """One sentence for people."""
    status: list[str] = Field(default=[])
    """Only where a measurement was asked for and there is none: the codes of the reasons."""


class Span(Answer):
    """The share of a span of time in which something valid was measured."""

    share: float | None
    valid_s: float
    observed_s: float
    lost_s: dict[str, float]
    """Seconds by the code of the reason."""
    since: str | None
    """UTC from when on it is known, at most as long ago as the span's name says."""


class Availability(Answer):
    """In which share of the time the unit measured."""

    last_hour: Span
    last_day: Span
    last_31_days: Span
    since_start: Span


class Component(Answer):
    """One part of the daemon; its figures and counters are further keys."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, int | float | str | None] = Field(init=False)
    state: State
    message: str
    for_s: float
    """Since when its state is this one."""


class Status(Answer):
    """The unit, its state, its availability and its components."""

    version: str = ""
    serial: str = ""
    unit_number: str = ""
    """CRC-32 of the serial number: the `unit` of every message."""
    calibration: str = ""
    config_sha256: str = ""
    """Of the config file as the daemon read it."""
    spot_fit: str = ""
    """`compiled`, or `numpy` and why: numpy finds the same and takes more CPU."""
    state: UnitState | None = None
    availability: Availability | None = None
    components: dict[str, Component]


class TargetDrift(Answer):
    """The result of a self-check for one target."""

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
    """The verdict on one target, or on yaw and pitch."""

    of: str
    verdict: Literal["good", "suspect", "bad", "unknown"]
    unit: str
    error: float | None
    """The largest error anywhere in the calibrated area; null where too few LEDs were found."""
    sigma: float | None
    suspect: float
    """The limit of `good`; so `bad`."""
    bad: float


class SelfCheck(Answer):
    """The report of the last self-check; without one, `verdict` is null and `reasons` says why."""

    verdict: Literal["good", "suspect", "bad", "unknown"] | None
    reasons: list[str]
    parts: list[PartVerdict] = Field(default=[])
    unavailable: str = ""
    """Why this unit can make none; empty: it can."""
    targets: dict[str, TargetDrift] = Field(default={})
    yaw_deg: float | None = None
    """The effect of the drift on a measurement; so the next three."""
    pitch_deg: float | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    sigma: dict[str, float | None] = Field(default={})
    number: int = 0
    """Counts the checks since the start, from 1."""
    cause: str = ""
    time: str | None = None
    exposures_lost: int = 0
    notes: list[str] = Field(default=[])


class TargetArea(Answer):
    """One target."""

    name: str
    z_mm: float
    """Its distance from the front target along the beam."""
    valid_mm: list[tuple[float, float]]
    """The corners (x, y) of the area within which a spot is valid, in the unit frame, counter-clockwise."""


class Targets(Answer):
    """The targets in beam order."""

    area_mm: tuple[float, float]
    """Width and height of the area that the unit is made for, its middle in the unit frame's zero."""
    targets: list[TargetArea]


class Login(Answer):
    """The user's name and password for a login."""

    name: str = Field(max_length=32)
    password: str = Field(max_length=1024)


class Session(Answer):
    """The user who is logged in."""

    name: str | None
    """null: no user."""
    may_act: bool
    """Whether an action, such as a self-check, would be done for this client."""
    login: bool
    """Whether one can log in at all: whether credentials are set."""


class TrendOfQuantity(Answer):
    """A quantity in columns: for each point a number, or null where it was not known."""

    mean: list[float | None]
    sigma: list[float | None]
    """The standard deviation (1 sigma) of one measurement."""
    low: list[float | None]
    high: list[float | None]


class Trend(Answer):
    """Points in the order of time, in columns of one length; where no daemon ran there are none."""

    source: str
    """The spans that the points sum up: `seconds`, `minutes` or `hours`."""
    span_s: float
    """The length of time of a point."""
    t_s: list[float]
    """When each begins, seconds since 1970, UTC."""
    n: list[int]
    """Measurements in it."""
    n_valid: list[int]
    worst: list[int]
    """The severity of the unit's worst state: 0 good, 1 maintenance required to 4 failure."""
    worst_code: list[str]
    lost_to: list[str]
    """The worst reason of those measurements that were not valid; empty: none."""
    quantities: dict[str, TrendOfQuantity]


class Event(Answer):
    """Something that happened to the unit."""

    id: int
    time: str | None
    epoch: int
    """Which run of the clock: within one, time only grows."""
    severity: int
    kind: str
    of: str | None
    text: str
    detail: dict[str, Any]
    held_back: int
    """Events of its kind before it that were counted and not kept."""


class Events(Answer):
    """Events, the newest first."""

    events: list[Event]


class Recording(Answer):
    """Frames of the last seconds, kept on the unit."""

    name: str
    why: str
    """The code of the cause, with the target or component that it is of; or the user that asked."""
    start: str | None
    """UTC of its first frame."""
    seconds: float
    exposures: int
    bytes: int
    """On the unit's disk."""
    marked: bool
    """Whether the recording is kept when space is needed."""


class Recordings(Answer):
    """The frames and recordings that the unit has kept."""

    unavailable: str
    """Why nothing is kept; empty: it is."""
    recordings: list[Recording]
    """The newest first."""


class Document(BaseModel):
    """An OpenAPI document."""

    model_config = ConfigDict(extra="allow")
    openapi: str


class Alive(Answer):
    """The daemon answers."""

    alive: Literal[True]


class Ready(Answer):
    """The unit measures; whether what it measures is valid, `/api/v1/measurement` says."""

    ready: Literal[True]
