"""/metrics, read by Prometheus' own parser, against the JSON of the same moment."""

import itertools
import math
from collections.abc import Iterator

import pytest
from prometheus_client.parser import text_string_to_metric_families
from support.clock import FakeClock
from support.measurements import changed, measured, measurement
from support.status_fixtures import checked

from altd.publish.http.metrics import Metrics
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.board import Board
from altd.status.health import Health, State
from altd.status.measurement_json import as_object_now
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit

from .conftest import Unit

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def samples(text: str) -> Samples:
    return dict(_samples(text))


def _samples(text: str) -> Iterator[tuple[tuple[str, tuple[tuple[str, str], ...]], float]]:
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            assert math.isfinite(sample.value)
            yield (sample.name, tuple(sorted(sample.labels.items()))), sample.value


def one(found: Samples, name: str, **labels: str) -> float | None:
    return found.get((name, tuple(sorted(labels.items()))))


def read(published: PublishedUnit) -> Samples:
    return samples(Metrics(published).text().decode())


async def test_it_is_served_in_prometheus_text_format(
    unit: Unit, board: Board, measured: Measurement
) -> None:
    board.publish(measured)
    answer = await unit.ask("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    found = samples(answer.body.decode())
    assert one(found, "altd_x_mm") == 10.012
    assert one(found, "altd_component_state", component="http", state="ok") == 1.0
    assert one(found, "altd_component_events_total", component="http", event="requests") == 1.0


def test_the_numbers_are_those_of_the_json(
    board: Board, published: PublishedUnit, clock: FakeClock, measured: Measurement
) -> None:
    board.publish(measured)
    clock.now_ns += 520_000_000
    found, shown = read(published), as_object_now(measured, 0.52)
    for key in ("x_mm", "y_mm", "yaw_deg", "pitch_deg"):
        assert one(found, f"altd_{key}") == shown[key]
        assert one(found, f"altd_{key}_sigma") == shown["sigma"][key]
        assert one(found, f"altd_{key}_sigma_now") == shown["sigma_now"][key]
    for target in ("front", "rear"):
        assert one(found, "altd_target_x_mm", target=target) == shown[target]["x_mm"]
    assert one(found, "altd_roll_deg") is None
    assert one(found, "altd_valid") == 1.0
    assert one(found, "altd_measurement_age_seconds") == 0.52
    assert one(found, "altd_measurements_total") == 1.0


@pytest.mark.parametrize(
    ("reasons", "valid", "live"),
    [
        ((), 1.0, 1.0),
        ((Reason.PLAYBACK,), 0.0, 0.0),
        ((Reason.SIMULATED,), 0.0, 0.0),
        ((Reason.COMPENSATED, Reason.SIMULATED), 0.0, 0.0),
        ((Reason.COMPENSATED,), 1.0, 1.0),
        ((Reason.UNSTEADY, Reason.PLAYBACK), 0.0, 0.0),
        ((Reason.UNSTEADY,), 0.0, 1.0),
    ],
)
def test_what_does_not_come_from_the_units_cameras_is_not_live(
    board: Board,
    published: PublishedUnit,
    clock: FakeClock,
    reasons: tuple[Reason, ...],
    valid: float,
    live: float,
) -> None:
    assert one(read(published), "altd_live") == 0.0, "nothing has been measured yet"
    board.publish(measurement(160, clock.now_ns, *reasons))
    found = read(published)
    assert (one(found, "altd_valid"), one(found, "altd_live")) == (valid, live)
    clock.now_ns += 5_000_000_000
    stale = read(published)
    assert (one(stale, "altd_valid"), one(stale, "altd_live")) == (0.0, live)


def values(found: Samples) -> set[str]:
    """The names of all samples that are numbers of the beam."""
    keys = ("x_mm", "y_mm", "yaw", "pitch", "roll", "target")
    return {name for name, _ in found if name.startswith(tuple(f"altd_{key}" for key in keys))}


def test_what_is_not_known_has_no_sample(
    board: Board, published: PublishedUnit, clock: FakeClock, measured: Measurement
) -> None:
    nothing_yet = read(published)
    assert values(nothing_yet) == set()
    assert one(nothing_yet, "altd_valid") == 0.0
    assert one(nothing_yet, "altd_measurement_age_seconds") is None
    board.publish(changed(measured, None, {"front": None, "rear": (1.0, 2.0)}, status=()))
    lost = read(published)
    assert values(lost) == {"altd_target_x_mm", "altd_target_y_mm"}
    assert one(lost, "altd_target_x_mm", target="rear") == 1.0
    assert one(lost, "altd_target_x_mm", target="front") is None
    board.publish(measured)
    clock.now_ns += 5_000_000_000
    stale = read(published)
    assert values(stale) == set()
    assert one(stale, "altd_valid") == 0.0
    assert one(stale, "altd_status", code="stale") == 1.0


def test_reasons_causes_and_availability_are_told(
    board: Board, health: Health, published: PublishedUnit, clock: FakeClock
) -> None:
    state = UnitState(board, health, clock)
    published.state = state.read
    health.component("camera front").set_state(State.FAILED, "no such device")
    clock.now_ns += 60_000_000_000
    fault = Fault(Reason.SPOT_MISSING, "front")
    board.publish(changed(measured(t_ns=clock.now_ns), None, status=(fault, fault)))
    clock.now_ns += 500_000_000
    found = read(published)
    assert one(found, "altd_status", code="front_spot_missing") == 1.0
    assert one(found, "altd_state", signal="failure") == 1.0
    assert one(found, "altd_state", signal="good") == 0.0
    assert one(found, "altd_cause", code="camera_failed", of="camera front", signal="failure") == 1.0
    assert one(found, "altd_availability_ratio", span="since_start") == 0.0
    assert one(found, "altd_component_state", component="camera front", state="failed") == 1.0


def test_names_from_outside_are_escaped(board: Board, health: Health, published: PublishedUnit) -> None:
    name = 'camera "front"\n\\ altd_x_mm 99'
    health.component(name).count('a"b\n')
    health.component(name).observe({"fps": 20.5, "driver": "v4l2", "celsius": None})
    published.self_check.publish(checked(3))
    found = read(published)
    assert one(found, "altd_component_events_total", component=name, event='a"b\n') == 1.0
    assert one(found, "altd_component_figure", component=name, figure="fps") == 20.5
    assert one(found, "altd_component_figure", component=name, figure="celsius") is None
    assert one(found, "altd_component_figure", component=name, figure="driver") is None
    assert one(found, "altd_x_mm") is None
    assert one(found, "altd_self_check_verdict", verdict="good") == 1.0
    assert one(found, "altd_self_check_number") == 3.0


def test_each_family_and_sample_comes_once_and_what_goes_down_is_no_counter(
    board: Board, health: Health, published: PublishedUnit, measured: Measurement
) -> None:
    """Prometheus, exposition formats; OpenMetrics, counters."""
    board.publish(measured)
    health.component("modbus_tcp").count("clients")
    health.component("modbus_tcp").count("requests")
    text = Metrics(published).text().decode()
    assert text.endswith("\n")
    lines = text.splitlines()
    types = dict(line.split()[2:4] for line in lines if line.startswith("# TYPE "))
    assert len(types) == sum(line.startswith("# TYPE ") for line in lines)
    names = [line.partition("{")[0].partition(" ")[0] for line in lines if not line.startswith("#")]
    assert [name for name, _ in itertools.groupby(names)] == list(dict.fromkeys(names)), "one block each"
    assert all(name.endswith("_total") is (types[name] == "counter") for name in names)
    assert len(samples(text)) == len(names)
    found = read(published)
    assert one(found, "altd_component_figure", component="modbus_tcp", figure="clients") == 1.0
    assert one(found, "altd_component_events_total", component="modbus_tcp", event="clients") is None
    assert one(found, "altd_component_events_total", component="modbus_tcp", event="requests") == 1.0


def test_nothing_of_the_process_itself_is_told(published: PublishedUnit) -> None:
    assert {name.split("_")[0] for name, _ in read(published)} == {"altd"}
