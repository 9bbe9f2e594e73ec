"""Documents on the unit that several interfaces send and the terminal reads, and what they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import ConfigDict, Field

from altd.reasons import Signal
from altd.records import utc_text
from altd.selfcheck import records
from altd.status import target_area
from altd.status.answer import Answer
from altd.status.availability import Span
from altd.status.cause import StateReport
from altd.status.health import State
from altd.status.services import SelfCheckReport
from altd.status.unit import UnitFacts, UnitView


class Cause(Answer):
    """A fault and its remedy."""

    code: str
    signal: Signal
    of: str | None
    """Name of the target or component; null: the whole unit."""
    active: bool
    """Whether it is true now; otherwise it is still shown for a while."""
    for_s: float
    times: int
    brief: str
    remedy: str
    detail: str


class UnitState(Answer):
    """State of the unit in the signals of NAMUR NE 107."""

    signal: Signal
    number: int
    """Number of the signal in OPC 10000-100, table 22."""
    for_s: float
    causes: list[Cause]
    """Causes, the worst first."""


def state_of(report: StateReport) -> UnitState:
    """Return the state of a unit at the time of its report."""

    def for_s(since_ns: int) -> float:
        return round((report.now_ns - since_ns) * 1e-9, 1)

    causes = [
        Cause(
            code=str(shown.cause.kind),
            signal=shown.signal,
            of=shown.cause.of,
            active=shown.is_active,
            for_s=for_s(shown.since_ns),
            times=shown.times,
            brief=shown.cause.kind.brief,
            remedy=shown.cause.remedy,
            detail=shown.cause.detail,
        )
        for shown in report.causes
    ]
    return UnitState(
        signal=report.signal, number=report.signal.number, for_s=for_s(report.since_ns), causes=causes
    )


class Availability(Answer):
    """Shares of time in which the unit made valid measurements, by span."""

    last_hour: Span
    last_day: Span
    last_31_days: Span
    since_start: Span


def availability_of(report: StateReport) -> Availability:
    """Return the availability up to the time of a report."""
    return Availability.model_validate(report.availability.spans())


class Component(Answer):
    """A component of the daemon; its figures and counters are further keys."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, int | float | str | None] = Field(init=False)
    state: State
    message: str
    for_s: float
    """Time since its state last changed, s."""


class SetZero(Answer):
    """The zero of relative values for controllers."""

    count: int
    """Number of zeros set since the daemon started."""
    by: str
    """Interface and client that requested it."""
    time: str | None
    """Time of the measurement used as zero, UTC."""


class Status(UnitFacts):
    """Identity of the unit, its state, its availability, its zero and its components."""

    state: UnitState | None = None
    availability: Availability | None = None
    zero: SetZero | None = None
    """The zero; null: none was set since the daemon started."""
    operating_hours: float | None = None
    """Hours for which the unit has operated over its life; null: not known."""
    components: dict[str, Component]


def status_of(view: UnitView) -> Status:
    """Return facts, state, availability and components of a unit."""
    components = {
        component.name: Component.model_validate(
            {
                "state": component.state,
                "message": component.message,
                "for_s": round(component.for_s, 1),
                **component.figures,
                **component.counters,
            }
        )
        for component in view.components
    }
    report = view.state
    state = {} if report is None else {"state": state_of(report), "availability": availability_of(report)}
    zero = None
    if (measurement := view.zero.measurement) is not None:
        time = None if measurement.time is None else utc_text(measurement.time)
        zero = SetZero(count=view.zero.count, by=view.zero.by, time=time)
    hours = None if view.operating_hours is None else round(view.operating_hours, 1)
    return Status.model_validate(
        {**view.facts.known, **state, "zero": zero, "operating_hours": hours, "components": components}
    )


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


_DECIMALS = {"x_mm": 4, "y_mm": 4, "yaw_deg": 5, "pitch_deg": 5}


def self_check_of(check: records.SelfCheck, report: SelfCheckReport | None = None) -> SelfCheck:
    """Return the result of a check, and, for one of a running unit, what its report adds."""
    values = {key: _rounded(check.effects[key].value, _DECIMALS[key]) for key in check.effects}
    sigmas = {key: _rounded(check.effects[key].sigma, _DECIMALS[key]) for key in check.effects}
    found = SelfCheck(
        verdict=check.verdict.value,
        reasons=list(check.reasons),
        parts=[_part_of(part) for part in check.parts],
        targets={name: _drift_of(drift) for name, drift in check.targets.items()},
        yaw_deg=values.get("yaw_deg"),
        pitch_deg=values.get("pitch_deg"),
        x_mm=values.get("x_mm"),
        y_mm=values.get("y_mm"),
        sigma={key: sigmas.get(key) for key in ("yaw_deg", "pitch_deg", "x_mm", "y_mm")},
    )
    if report is None:
        return found
    about = {
        "number": report.number,
        "cause": report.cause,
        "time": None if report.time is None else utc_text(report.time),
        "exposures_lost": report.exposures_lost,
        "notes": list(check.notes),
    }
    return found.model_copy(update=about)


def _part_of(part: records.PartVerdict) -> PartVerdict:
    return PartVerdict(
        of=part.of,
        verdict=part.verdict.value,
        unit=part.unit,
        error=_rounded(part.error, 5),
        sigma=_rounded(part.sigma, 5),
        suspect=round(part.suspect, 5),
        bad=round(part.bad, 5),
    )


def _drift_of(drift: records.TargetDrift) -> TargetDrift:
    fitted = drift.similarity
    return TargetDrift(
        leds_expected=drift.leds_expected,
        leds_found=drift.leds_found,
        shift_px=drift.shift_px,
        turn_deg=None if fitted is None else round(fitted.turn_deg, 5),
        scale_ppm=None if fitted is None else round(fitted.scale_ppm, 1),
        rms_px=_rounded(drift.rms_px, 4),
        significance=_rounded(drift.significance, 2),
        is_similarity=None if fitted is None else drift.is_similarity,
        leds=list(map(str, drift.leds)),
        foreign_px=[[round(u, 1), round(v, 1)] for u, v in drift.foreign_px],
        detail=drift.detail,
    )


def _rounded(value: float | None, decimals: int) -> float | None:
    return None if value is None else round(value, decimals)


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


def targets_of(areas: Sequence[target_area.TargetArea]) -> Targets:
    """Return the targets in beam order."""
    targets = [TargetArea(name=area.name, z_mm=area.z_mm, valid_mm=list(area.valid_mm)) for area in areas]
    return Targets(area_mm=target_area.AREA_MM, targets=targets)
