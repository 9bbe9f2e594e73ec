"""Which values a line makes, and when they are taken back, by a clock that the test drives."""

import json
import zlib
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

import pytest
from support.clock import START, FakeClock
from support.opcua import STALE_AFTER_S, OpcUaUnit, Written

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.opcua.live import LINK_TIMEOUT_S, LiveUnit
from altd.publish.opcua.quality import Status
from altd.reasons import Reason
from altd.records import Fault
from altd.records.sensors import Quality, SensorValue

NUMBERS = {
    "x_mm": 10.012,
    "y_mm": 4.987,
    "yaw_deg": 1.1459,
    "pitch_deg": -1.7184,
    "x_mm.sigma": 0.004,
    "targets.front.x_mm": 10.012,
    "targets.rear.y_mm": -3.413,
}
KEYS = frozenset({*NUMBERS, "y_mm.sigma", "x_mm.sigma_now", "roll_deg", "roll_deg.sigma"}) | {
    *("yaw_mm_per_m", "pitch_mm_per_m", "targets.front.y_mm", "targets.rear.x_mm"),
    *("valid", "sequence", "frames", "age_ms", "status", "causes", "health"),
}


@dataclass
class NotedNodes:
    """The values written last to each node."""

    keys: frozenset[str] = KEYS
    now: dict[str, Written] = field(default_factory=dict)

    async def write(
        self, key: str, value: object, status: Status, source: datetime | None, now: datetime
    ) -> None:
        assert key in self.keys
        self.now[key] = Written(None if status.is_bad else value, status, source)

    def statuses(self, *keys: str) -> set[Status]:
        return {self.now[key].status for key in keys or self.keys - {"causes", "health"}}


@dataclass
class Bench:
    clock: FakeClock
    unit: OpcUaUnit
    nodes: NotedNodes
    live: LiveUnit

    async def measure(self, sequence: int = 160, **changes: Any) -> None:
        self.unit.measure(sequence, **changes)
        await self.live.take(self.unit.line())

    async def passed(self, seconds: float) -> None:
        self.clock.now_ns += round(seconds * 1e9)
        await self.live.withdraw_stale()


def bench(**fields: Any) -> Bench:
    clock = FakeClock(10**12)
    unit, nodes = OpcUaUnit(clock, **fields), NotedNodes()
    live = LiveUnit(nodes, unit.start, clock.monotonic_ns, lambda: clock.utc(clock.now_ns))  # type: ignore[arg-type]
    return Bench(clock, unit, nodes, live)


@pytest.fixture
def on() -> Bench:
    return bench()


async def test_a_valid_measurement_is_good_with_its_numbers_and_the_time_of_its_exposures(on: Bench) -> None:
    await on.measure()
    captured = START + timedelta(seconds=1000 - 0.5)
    for key, value in NUMBERS.items():
        assert on.nodes.now[key] == Written(value, Status.GOOD, captured)
    assert on.nodes.now["valid"] == Written(True, Status.GOOD, captured)
    assert on.nodes.now["sequence"] == Written(160, Status.GOOD, captured)
    assert on.nodes.now["frames"].value == 20
    assert on.nodes.now["status"].value == []
    assert on.nodes.now["age_ms"].value == 500
    assert on.nodes.now["roll_deg"].status is Status.BAD_NOT_CONNECTED


async def test_an_invalid_one_has_no_numbers_and_says_why(on: Bench) -> None:
    none = dict.fromkeys(("front", "rear"))
    status = (Fault(Reason.CAMERA_SILENT, "rear"),)
    await on.measure(values={}, targets=none, motions={}, status=status)
    assert on.nodes.statuses(*NUMBERS) == {Status.BAD_SENSOR_FAILURE}
    assert on.nodes.now["valid"].value is False
    assert on.nodes.now["status"].value == ["rear_camera_silent"]


@pytest.mark.parametrize("reason", [Reason.PLAYBACK, Reason.SIMULATED])
async def test_what_does_not_come_from_the_cameras_is_never_good(reason: Reason) -> None:
    rehearsing, live = bench(rehearsal=True), bench()
    await rehearsing.measure(status=(Fault(reason),))
    assert rehearsing.nodes.statuses(*NUMBERS, "valid") == {Status.UNCERTAIN_SIMULATED_VALUE}
    assert rehearsing.nodes.now["valid"].value is True
    await live.measure(status=(Fault(reason),))
    assert live.nodes.statuses(*NUMBERS) == {Status.BAD_OUT_OF_SERVICE}
    assert live.nodes.now["valid"] == Written(False, Status.GOOD, live.nodes.now["x_mm"].source)


async def test_numbers_of_a_rehearsal_with_the_units_own_cameras_are_not_good_either() -> None:
    rehearsing = bench(rehearsal=True)
    await rehearsing.measure()
    assert rehearsing.nodes.statuses(*NUMBERS, "valid") == {Status.UNCERTAIN_SIMULATED_VALUE}


async def test_without_a_capture_time_no_number_is_good_and_none_has_a_source_time(on: Bench) -> None:
    on.clock.utc = lambda t_ns: None  # type: ignore[assignment,method-assign,return-value]
    on.unit.measure()
    del on.clock.utc
    await on.live.take(on.unit.line())
    assert on.nodes.statuses(*NUMBERS) == {Status.UNCERTAIN}
    assert {on.nodes.now[key].source for key in NUMBERS} == {None}


async def test_numbers_are_taken_back_when_nothing_follows_them_and_all_when_the_daemon_is_silent(
    on: Bench,
) -> None:
    await on.measure()
    await on.live.take(on.unit.state_line())
    await on.passed(STALE_AFTER_S)
    assert on.nodes.statuses(*NUMBERS, "valid") == {Status.GOOD}
    await on.passed(0.01)
    assert on.nodes.statuses(*NUMBERS, "valid", "roll_deg") == {Status.BAD_NO_COMMUNICATION}
    assert on.nodes.statuses("sequence", "status", "health") == {Status.GOOD}
    await on.passed(LINK_TIMEOUT_S)
    assert set(on.nodes.now) == on.nodes.keys
    assert {each.status for each in on.nodes.now.values()} == {Status.BAD_NO_COMMUNICATION}
    await on.measure(161)
    assert on.nodes.statuses(*NUMBERS, "valid") == {Status.GOOD}


async def test_the_same_measurement_sent_again_stays_as_old_as_it_is(on: Bench) -> None:
    """A daemon that repeats a line, whatever its board says, does not keep a number alive."""
    on.unit = OpcUaUnit(on.clock, stale_after_s=1000.0)
    start = replace(on.unit.start, stale_after_s=STALE_AFTER_S)
    on.live = LiveUnit(on.nodes, start, on.clock.monotonic_ns)  # type: ignore[arg-type]
    await on.measure()
    for _ in range(12):
        await on.passed(0.1)
        await on.live.take(on.unit.line())
        await on.live.withdraw_stale()
    assert json.loads(on.unit.line())["valid"], "the board would show it"
    assert on.nodes.statuses(*NUMBERS, "valid") == {Status.BAD_NO_COMMUNICATION}


async def test_a_line_that_waited_in_the_pipe_is_as_old_as_it_is(on: Bench) -> None:
    on.unit.measure()
    waited = on.unit.line()
    await on.passed(STALE_AFTER_S + 0.01)
    await on.live.take(waited)
    assert on.nodes.statuses(*NUMBERS, "valid") == {Status.BAD_NO_COMMUNICATION}
    assert on.nodes.now["age_ms"].value == pytest.approx(1510, abs=1)
    on.unit.measure(161)
    waited = on.unit.line()
    await on.passed(LINK_TIMEOUT_S + 0.01)
    await on.live.take(waited)
    assert on.nodes.statuses() == {Status.BAD_NO_COMMUNICATION}, "nothing of it is of now"


async def test_what_the_board_calls_stale_is_bad_and_the_reason_is_readable(on: Bench) -> None:
    await on.measure()
    await on.passed(STALE_AFTER_S + 0.1)
    await on.live.take(on.unit.line())
    assert on.nodes.statuses(*NUMBERS) == {Status.BAD_NO_COMMUNICATION}
    assert on.nodes.now["status"].value == ["stale"]


@pytest.mark.parametrize("spoil", ["byte", "torn", "session", "not json"])
async def test_damaged_and_foreign_lines_change_nothing_and_are_counted(on: Bench, spoil: str) -> None:
    await on.measure()
    before = dict(on.nodes.now)
    on.unit.measure(161)
    line = on.unit.line()
    if spoil == "byte":
        line = line.replace(b'"sequence": 161', b'"sequence": 171')
    elif spoil == "torn":
        line = line[:200]
    elif spoil == "session":
        body = line.rpartition(b', "crc32"')[0].replace(on.unit.start.session.encode(), b"00000001")
        line = body + b', "crc32": "%08X"}\n' % zlib.crc32(body)
    else:
        line = b"]]]\n"
    await on.live.take(line)
    assert (on.nodes.now, on.live.lines_refused) == (before, 1)


async def test_it_goes_on_when_the_daemons_clock_of_milliseconds_begins_again(on: Bench) -> None:
    for _ in range(3):
        on.clock.now_ns = on.unit.start.started_ns + 0xFFFF_FFFF * 1_000_000 - 30_000_000
        for sequence in range(3):
            await on.measure(sequence)
            assert on.nodes.statuses(*NUMBERS) == {Status.GOOD}
            on.clock.now_ns += 20_000_000


async def test_roll_has_its_sensors_quality_and_time_whatever_the_beam_does() -> None:
    on = bench(quantities=QUANTITIES.with_sensor("roll_deg"))
    roll = SensorValue(Quality.GOOD, value=0.25, sigma=0.01, age_s=0.1, expires_ns=2 * 10**12)
    lost = {"values": {}, "targets": dict.fromkeys(("front", "rear")), "motions": {}}
    missing = (Fault(Reason.SPOT_MISSING, "front"),)
    await on.measure(**lost, status=missing, from_sensors={"roll_deg": roll})
    measured = START + timedelta(seconds=1000 - 0.1)
    assert on.nodes.now["roll_deg"] == Written(0.25, Status.GOOD, measured)
    assert on.nodes.now["roll_deg.sigma"] == Written(0.01, Status.GOOD, measured)
    assert on.nodes.statuses(*NUMBERS) == {Status.BAD}
    await on.measure(161, from_sensors={"roll_deg": SensorValue(Quality.FROZEN)})
    assert on.nodes.now["roll_deg"].status is Status.BAD_SENSOR_FAILURE


async def test_the_units_state_is_that_of_every_interface(on: Bench) -> None:
    await on.measure()
    on.clock.now_ns += 3 * 10**9
    await on.live.take(on.unit.state_line())
    assert on.nodes.now["health"].value == 1
    assert on.nodes.now["causes"].value == ["stale"]
