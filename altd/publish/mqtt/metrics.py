"""The metrics of a unit as a Sparkplug edge node: identity, state, and the newest measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from typing import Any

from altd.ports import Clock
from altd.publish.mqtt.broker import BrokerError
from altd.publish.mqtt.sparkplug import Metric, Quality, Type
from altd.reasons import NOT_FROM_CAMERAS, Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.cause import StateReport

_NOT_LIVE = NOT_FROM_CAMERAS | {Reason.NOT_LIVE, Reason.REHEARSAL}


def identity_metrics(birth: Mapping[str, Any], now_ms: int) -> list[Metric]:
    """The properties of the unit, from its birth message in JSON."""
    told = {key: birth[key] for key in ("serial", "version", "instrument")}
    told |= {f"calibration_{key}": value for key, value in birth["calibration"].items()}
    return [
        Metric(
            f"Properties/{key}",
            Type.BOOLEAN if key == "calibration_simulated" else Type.STRING,
            value,
            now_ms,
            Quality.BAD if value is None else Quality.GOOD,
        )
        for key, value in told.items()
    ]


def state_metrics(report: StateReport | None, now_ms: int) -> list[Metric]:
    """The NE 107 signal, and the codes of its causes, the worst first."""
    signal = causes = None
    quality = Quality.BAD if report is None else Quality.GOOD
    if report is not None:
        signal, causes = str(report.signal), " ".join(str(shown.cause.kind) for shown in report.causes)
    return [
        Metric("State/signal", Type.STRING, signal, now_ms, quality),
        Metric("State/causes", Type.STRING, causes, now_ms, quality),
    ]


def measurement_metrics(measurement: Measurement | None, board: Board, clock: Clock) -> list[Metric]:
    """The metrics of ``board``; None: no measurement was made yet.

    Only what this unit's cameras measure now is good. What is played, simulated or rehearsed is historical,
    and bad. What is not known is null: stale where nothing is measured any more, else bad.
    """
    now_ms = utc_ms(clock, clock.monotonic_ns())
    shown = measurement or Measurement(0, 0, None, 0, board.quantities, {}, {}, (Fault(Reason.WARMING_UP),))
    reasons = {fault.reason for fault in shown.status}
    is_live, is_stale = not reasons & _NOT_LIVE, Reason.STALE in reasons
    without = Quality.STALE if is_stale else Quality.BAD
    if measurement is None or is_stale:  # later than the values before it, or a host could keep those
        captured_ms = now_ms
    else:
        captured_ms = utc_ms(clock, shown.t_ns) if shown.time is None else _ms(shown.time)

    def metric(name: str, kind: Type, value: float | str | None, time_ms: int = captured_ms) -> Metric:
        quality = without if value is None else Quality.GOOD if is_live else Quality.BAD
        return Metric(name, kind, value, time_ms, quality, is_historical=value is not None and not is_live)

    metrics = [
        metric("valid", Type.BOOLEAN, shown.valid),
        metric("status", Type.STRING, " ".join(map(str, shown.status))),
        metric("sequence", Type.INT64, None if measurement is None else shown.sequence),
    ]
    for quantity in board.quantities.shown:
        said, known = shown.from_sensors.get(quantity.key), shown.known(quantity.key)
        at_ms = captured_ms if said is None or said.value is None else utc_ms(clock, said.t_ns)
        about = {"engUnit": quantity.unit, "documentation": quantity.meaning}
        numbers = {quantity.key: None if known is None else known.value}
        if quantity.has_sigma:
            numbers[f"sigma/{quantity.key}"] = None if known is None else known.sigma
        for name, number in numbers.items():
            rounded = None if number is None else round(number, quantity.decimals)
            metrics.append(replace(metric(name, Type.DOUBLE, rounded, at_ms), about=about))
    return metrics


def utc_ms(clock: Clock, t_ns: int) -> int:
    """UTC of a monotonic instant in ms since 1970; raises BrokerError where it is not known."""
    if (utc := clock.utc(t_ns)) is None:
        raise BrokerError("the unit does not know the UTC, which Sparkplug requires")
    return _ms(utc)


def _ms(utc: datetime) -> int:
    return round(utc.timestamp() * 1e3)
