"""Metrics in Prometheus' text format. Unknown values have no sample, neither 0 nor an old number."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector

from altd.reasons import NOT_FROM_CAMERAS, Signal
from altd.records import Measurement, Quantity
from altd.status.cause import StateReport
from altd.status.health import State
from altd.status.measurement_json import as_object_now
from altd.status.unit import PublishedUnit, UnitView

CONTENT_TYPE = CONTENT_TYPE_PLAIN_0_0_4

_LEVELS = {"clients"}
"""Counters of components that also go down, which no counter of Prometheus does."""


class Metrics:
    """Metrics of one unit, in a registry of their own, without metrics of the process itself."""

    def __init__(self, unit: PublishedUnit) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(_Families(unit))

    def text(self) -> bytes:
        """Return all current samples."""
        return generate_latest(self._registry)


class _Families(Collector):
    """Collector of one unit: a view at each collection."""

    def __init__(self, unit: PublishedUnit) -> None:
        self._unit = unit

    def collect(self) -> Iterator[Metric]:
        """Yield every family, with samples of the values that are known now."""
        view = self._unit.view()
        yield from _build(view)
        yield from _measurement(view)
        if view.measurement is not None:
            yield from _values(view.measurement, view.age_s)
        if view.state is not None:
            yield from _state(view.state)
        yield from _components(view)
        if (check := view.self_check) is not None:
            verdict = _gauge(
                "altd_self_check_verdict", "The last self-check's verdict, in a label", "verdict"
            )
            verdict.add_metric([str(check.check.verdict)], 1)
            yield verdict
            yield _known("altd_self_check_number", "Self-checks since the start of the daemon", check.number)


def _build(view: UnitView) -> Iterator[Metric]:
    facts = view.facts
    about = {
        "version": facts.version,
        "serial": facts.serial,
        "calibration": facts.calibration,
        "spot_fit": facts.spot_fit,
        "instrument": view.quantities.instrument,
    }
    yield InfoMetricFamily("altd_build", "The unit and the daemon", value=about)
    running_s = view.running_ns * 1e-9
    yield _known("altd_running_seconds", "Since the start of the daemon", running_s)


def _measurement(view: UnitView) -> Iterator[Metric]:
    measurement = view.measurement
    is_valid = measurement is not None and measurement.valid
    yield _known("altd_valid", "1 while there is a valid measurement, else 0", float(is_valid))
    is_live = measurement is not None and NOT_FROM_CAMERAS.isdisjoint(
        fault.reason for fault in measurement.status
    )
    meaning = "1 while the measurement is from this unit's cameras, else 0"
    yield _known("altd_live", meaning, float(is_live))
    published = CounterMetricFamily("altd_measurements", "Measurements since the start, valid or not")
    published.add_metric([], view.published)
    yield published
    if view.age_s is not None:
        yield _known("altd_measurement_age_seconds", "Since the middle of the latest exposures", view.age_s)
    status = _gauge("altd_status", "1 for each reason and warning of the latest measurement", "code")
    for code in dict.fromkeys(() if measurement is None else map(str, measurement.status)):
        status.add_metric([code], 1)
    yield status


def _components(view: UnitView) -> Iterator[Metric]:
    states = _gauge("altd_component_state", "1 for the state of a component", "component", "state")
    events = CounterMetricFamily(
        "altd_component_events", "Counters of a component", labels=["component", "event"]
    )
    figures = _gauge("altd_component_figure", "Figures of a component", "component", "figure")
    for component in view.components:
        for state in State:
            states.add_metric([component.name, str(state)], float(component.state is state))
        for event, count in component.counters.items():
            (figures if event in _LEVELS else events).add_metric([component.name, event], count)
        for name, figure in component.figures.items():
            if isinstance(figure, int | float):
                figures.add_metric([component.name, name], figure)
    yield from (states, events, figures)


def _values(measurement: Measurement, age_s: float | None) -> Iterator[Metric]:
    """Yield a family for each quantity, with the numbers of the JSON; null values have no sample."""
    shown = as_object_now(measurement, age_s)
    for quantity in measurement.quantities.of_unit:
        name, meaning = f"altd_{quantity.key}", _meaning(quantity)
        yield _known(name, meaning, shown[quantity.key])
        if quantity.has_sigma:
            sigma, sigma_now = shown["sigma"][quantity.key], shown["sigma_now"][quantity.key]
            yield _known(f"{name}_sigma", f"Standard deviation of {meaning}", sigma)
            yield _known(f"{name}_sigma_now", f"The same as a statement about now: {meaning}", sigma_now)
    for quantity in measurement.quantities.of_target:
        family = _gauge(f"altd_target_{quantity.key}", _meaning(quantity), "target")
        for target in measurement.targets:
            if (known := measurement.known_of(f"{target}.{quantity.key}")) is not None:
                family.add_metric([target], round(known.value, quantity.decimals))
        yield family


def _meaning(quantity: Quantity) -> str:
    return f"{quantity.label}{quantity.unit and f', {quantity.unit}'}: {quantity.meaning}"


def _state(report: StateReport) -> Iterator[Metric]:
    signals = _gauge("altd_state", "1 for the unit's state (NAMUR NE 107), 0 for the others", "signal")
    for signal in Signal:
        signals.add_metric([str(signal)], float(report.signal is signal))
    since_s = (report.now_ns - report.since_ns) * 1e-9
    since = _known("altd_state_seconds", "Duration of the unit's present state", since_s)
    causes = _gauge(
        "altd_cause", "1 for a cause that is true now, 0 while it is still shown", "code", "of", "signal"
    )
    for shown in report.causes:
        labels = [str(shown.cause.kind), shown.cause.of or "", str(shown.signal)]
        causes.add_metric(labels, float(shown.is_active))
    shares = _gauge("altd_availability_ratio", "Share of the time in which something was valid", "span")
    for name, span in report.availability.spans().items():
        if span.share is not None:
            shares.add_metric([name], span.share)
    yield from (signals, since, causes, shares)


def _known(name: str, meaning: str, value: float | None) -> Metric:
    family = _gauge(name, meaning)
    if value is not None:
        family.add_metric([], value)
    return family


def _gauge(name: str, meaning: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, meaning, labels=labels)
