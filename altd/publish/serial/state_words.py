"""The unit's state and its availability in the words of a technician."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from altd.reasons import Signal
from altd.status.cause import ShownCause, StateReport
from altd.status.conditions import Condition
from altd.status.health import duration

_SAID_BY_COMPONENTS = {
    Condition.CAMERA_FAILED,
    Condition.CAMERA_DEGRADED,
    Condition.RECORDING_ENDED,
    Condition.FACE_FAILED,
    Condition.LAMPS_FAILED,
    Condition.INDICATORS_FAILED,
    Condition.SENSOR_FAILED,
    Condition.COMPONENT_FAILED,
    Condition.COMPONENT_DEGRADED,
}
"""What the list of what is wrong says already, in the words of the component."""

_SPANS = {
    "last_hour": "of the last hour",
    "last_day": "of the last day",
    "last_31_days": "of the last 31 days",
    "since_start": "since the start",
}
_MOST_LOST = 3
"""So many reasons for lost time are named."""


def state_facts(report: StateReport, *, whole: bool) -> dict[str, str]:
    """The state with its causes, and the availability; ``whole``: with what most time was lost to."""
    signal = str(report.signal).replace("_", " ")
    text = signal if report.signal is Signal.GOOD else signal.upper()
    text += f" for {duration((report.now_ns - report.since_ns) * 1e-9)}"
    if report.causes:
        text += f": {'; '.join(map(_cause, report.causes))}"
    return {"state": text, "available": _available(report, whole)}


def state_steps(report: StateReport) -> list[str]:
    """What is wrong beside the measurement and the components, and what to do."""
    return [
        f"{_cause(shown)}{_in_brackets(shown.cause.detail)}: {shown.cause.kind.remedy}"
        for shown in report.causes
        if isinstance(shown.cause.kind, Condition) and shown.cause.kind not in _SAID_BY_COMPONENTS
    ]


def _cause(shown: ShownCause) -> str:
    just_now = "" if shown.is_active else " - just now"
    return f"{shown.cause.kind.brief}{_in_brackets(shown.cause.of)}{just_now}"


def _in_brackets(text: str | None) -> str:
    return f" ({text})" if text else ""


def _available(report: StateReport, whole: bool) -> str:
    parts = []
    for name, span in report.availability.as_object().items():
        tally = cast("Mapping[str, object]", span)
        share = cast("float | None", tally["share"])
        if share is None:
            continue
        text = f"{_percent(share)} {_SPANS[name]}"
        lost = list(cast("Mapping[str, float]", tally["lost_s"]).items())[:_MOST_LOST]
        if whole and lost:
            text += f" (lost: {', '.join(f'{reason} {duration(seconds)}' for reason, seconds in lost)})"
        parts.append(text)
    return "; ".join(parts) or "not known yet"


def _percent(share: float) -> str:
    """Rounded down, so that a promise that was missed does not look kept."""
    return f"{int(share * 1e4) / 100:.2f} %"
