"""The inclinometer's task: what a measurement gets while its sensor does what it likes."""

import asyncio
import itertools
import random
import threading
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.measurements import BEAM, beam_of, measurement

from altd.acquisition.inclination import monitor
from altd.acquisition.inclination.monitor import InclinationMonitor, stated_inclination
from altd.acquisition.inclination.witness import Inclination, Witness
from altd.config import InclinometerSettings, Installation, Machine
from altd.ports import (
    InclinometerAccuracy,
    InclinometerDisturbedError,
    InclinometerError,
    InclinometerNotFoundError,
    InclinometerReading,
    InclinometerRefusedError,
    InclinometerTimeoutError,
    InclinometerWrongError,
)
from altd.reasons import Reason
from altd.records import Measurement, Value
from altd.records.sensors import Quality
from altd.status.health import Component, Health, State

INTERVAL_S = 0.05


class Sensor:
    """An inclinometer that does what a test says; each reading differs from the one before."""

    name = "a sensor"
    accuracy = InclinometerAccuracy(0.1, 10.0, 40.0, 0.15, 0.1, 0.01)

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.failure: Exception | None = None
        self.refuses_to_open: Exception | None = None
        self.hang: threading.Event | None = None
        self.opened = self.closed = 0
        self.pitch_deg: float | None = None
        self._number = itertools.count()
        self._random = random.Random(1)

    def open(self) -> None:
        self.opened += 1
        if self.refuses_to_open:
            raise self.refuses_to_open

    def read(self) -> InclinometerReading:
        if self.hang:
            self.clock.hold(self.hang)
        if self.failure:
            raise self.failure
        angle_deg = 2.0 + self._random.gauss(0.0, 0.02)
        words = (next(self._number),)
        return InclinometerReading(self.clock.monotonic_ns(), angle_deg, self.pitch_deg, 20.0, words)

    def close(self) -> None:
        self.closed += 1


class Bench:
    """A keeper that runs, and what a measurement gets of it."""

    def __init__(self) -> None:
        self.clock = FakeClock.of_loop()
        self.sensor = Sensor(self.clock)
        self.component: Component = Health(self.clock).component("inclinometer")
        table = {
            "driver": "balluff_bsi_r11a0",
            "device": "/dev/ttyS9",
            "interval_s": INTERVAL_S,
            "max_age_s": 0.3,
            "frozen_after_s": 0.3,
        }
        self.monitor = InclinationMonitor(
            self.sensor,
            InclinometerSettings.model_validate(table),
            Installation(sign_pitch=-1, offset_pitch_deg=0.5),
            self.component,
            self.clock,
        )
        self.task = asyncio.create_task(self.monitor.run())

    def settings(self, **changed: object) -> None:
        self.monitor._settings = self.monitor._settings.model_copy(update=changed)  # noqa: SLF001

    def now(self) -> Measurement:
        return measurement().with_findings(self.monitor.sense(measurement()))

    @property
    def quality(self) -> Quality:
        return self.now().from_sensors["roll_deg"].quality

    async def end(self) -> None:
        await self.clock.stop(self.task)
        self.clock.end()


@pytest.fixture
async def bench(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Bench]:
    monkeypatch.setattr(monitor, "_CALL_TIMEOUT_S", 0.3)
    bench = Bench()
    yield bench
    await bench.end()
    assert bench.sensor.closed > 0


async def known(bench: Bench) -> None:
    await bench.clock.until(lambda: bench.quality is Quality.GOOD)


async def test_before_the_first_reading_there_is_no_roll_and_a_beam() -> None:
    bench = Bench()
    shown = bench.now()
    assert shown.number("roll_deg") is None
    assert beam_of(shown) == BEAM
    assert [str(fault) for fault in shown.status] == ["roll_missing"]
    await bench.end()


async def test_what_is_read_stands_in_the_measurement_with_sigma_and_age(bench: Bench) -> None:
    await known(bench)
    shown = bench.now()
    assert shown.number("roll_deg") == pytest.approx(2.0, abs=0.1)
    assert shown.sigma("roll_deg") == pytest.approx(0.085, abs=0.02)
    age_s = shown.from_sensors["roll_deg"].age_s
    assert age_s is not None
    assert 0.0 <= age_s < 0.3
    assert shown.status == ()
    assert beam_of(shown) == BEAM
    assert bench.component.state is State.OK
    assert bench.component.figures["roll_deg"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    ("error", "quality"),
    [
        (InclinometerNotFoundError("gone"), Quality.NO_PORT),
        (InclinometerWrongError("another"), Quality.WRONG_SENSOR),
        (InclinometerRefusedError("55555"), Quality.INVALID_SETTING),
        (ZeroDivisionError("a defect"), Quality.DEFECT),
    ],
)
async def test_a_failure_that_does_not_pass_ends_roll_at_once(
    bench: Bench, error: Exception, quality: Quality
) -> None:
    await known(bench)
    bench.sensor.failure = bench.sensor.refuses_to_open = error
    await bench.clock.until(lambda: bench.now().number("roll_deg") is None, 0.2)
    assert bench.quality is quality
    assert bench.component.state is State.FAILED
    assert str(error) in bench.component.message
    assert beam_of(bench.now()) == BEAM
    bench.sensor.failure = bench.sensor.refuses_to_open = None
    await known(bench)


@pytest.mark.parametrize(
    ("error", "quality"),
    [
        (InclinometerTimeoutError("silence"), Quality.NO_ANSWER),
        (InclinometerDisturbedError("damaged"), Quality.BAD_ANSWER),
    ],
)
async def test_an_answer_that_is_lost_does_no_harm_but_many_end_roll(
    bench: Bench, error: InclinometerError, quality: Quality
) -> None:
    await known(bench)
    failures = bench.component.counters.get("failures", 0)
    bench.sensor.failure = error
    await bench.clock.until(lambda: bench.component.counters.get("failures", 0) > failures)
    assert bench.now().number("roll_deg") is not None
    await bench.clock.until(lambda: bench.now().number("roll_deg") is None, 1.0)
    assert bench.quality is quality
    await bench.clock.until(lambda: bench.sensor.opened > 1)
    bench.sensor.failure = None
    await known(bench)


async def test_a_port_that_hangs_holds_up_nobody_and_its_roll_grows_old(bench: Bench) -> None:
    await known(bench)
    bench.sensor.hang = threading.Event()
    await bench.clock.until(lambda: bench.now().number("roll_deg") is None, 0.5)
    assert bench.quality in (Quality.OLD, Quality.NO_PORT)
    await bench.clock.until(lambda: bench.quality is Quality.NO_PORT, 1.0)
    assert "hangs" in bench.component.message
    bench.clock.release(bench.sensor.hang)
    bench.sensor.hang = None
    await known(bench)


async def test_a_sensor_that_can_be_opened_but_not_read_is_tried_each_second_and_a_defect_logged_once(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    bench.sensor.failure = ZeroDivisionError("a defect")
    await bench.clock.advance(20.0)
    assert 10 < bench.sensor.opened < 25
    assert [record.exc_info is not None for record in caplog.records] == [True]
    assert caplog.messages == ["inclinometer: ZeroDivisionError: a defect"]


async def test_a_missing_port_is_looked_for_again(bench: Bench) -> None:
    bench.sensor.refuses_to_open = InclinometerNotFoundError("there is no such port now")
    bench.sensor.failure = bench.sensor.refuses_to_open
    await bench.clock.until(lambda: bench.quality is Quality.NO_PORT)
    bench.sensor.refuses_to_open = bench.sensor.failure = None
    await known(bench)


async def test_a_beam_that_diverges_is_warned_of_or_withdrawn(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BEAM's pitch of -1.7184 is 2.2184 in the unit frame: sign -1, offset 0.5; with -2.2184 it is level.

    Its yaw of 1.1459° and a roll of 2° add 0.04°, with opposite signs: the beam goes to the lower side.
    """
    bench.sensor.pitch_deg = -2.2184
    await known(bench)
    added: list[Inclination] = []
    monkeypatch.setattr(Witness, "add", lambda _, sample: added.append(sample))
    bench.now()
    assert added[0].value_deg == pytest.approx(-0.04, abs=0.003)
    added.clear()
    bench.monitor.sense(measurement(160, 8_000_000_000, Reason.SPOT_MISSING))
    assert added == []
    for sigmas, warned in ((2.9, []), (-3.1, ["pitch_diverges"])):
        monkeypatch.setattr(Witness, "difference", lambda _, now_ns, it=sigmas: Value(0.01 * it, 0.01))
        shown = bench.now()
        assert [str(fault) for fault in shown.status] == warned
        assert shown.valid
        assert beam_of(shown) == BEAM
    bench.settings(divergence="invalid")
    shown = bench.now()
    assert [str(fault) for fault in shown.status] == ["implausible", "pitch_diverges"]
    assert not shown.valid
    assert shown.number("roll_deg") is not None
    monkeypatch.setattr(Witness, "difference", lambda _, now_ns: None)
    assert bench.now().valid


async def test_one_axis_has_nothing_to_compare(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await known(bench)
    monkeypatch.setattr(Witness, "add", lambda *_: pytest.fail("there is no pitch"))
    assert bench.now().valid
    assert "gravity_pitch_deg" not in bench.component.figures


async def test_roll_is_the_mean_over_the_exposures_of_the_beam(bench: Bench) -> None:
    await known(bench)
    await bench.clock.advance(2.0)
    times = [each.t_ns for each in bench.monitor._judge.credible]  # noqa: SLF001
    half_ns = (times[-1] - times[-8]) // 2
    of_second = replace(measurement(), t_ns=times[-8] + half_ns, last_exposure_ns=times[-1])
    roll = bench.monitor.sense(of_second).from_sensors["roll_deg"]
    within = [each.tilt.roll_deg for each in bench.monitor._judge.credible if each.t_ns >= times[-8]]  # noqa: SLF001
    assert roll.value == pytest.approx(sum(within) / len(within))
    assert len(within) == 8
    assert roll.t_ns == pytest.approx(of_second.t_ns, abs=2)
    newest = bench.monitor.sense(replace(of_second, last_exposure_ns=None)).from_sensors["roll_deg"]
    assert newest.value == within[-1]
    assert (roll.sigma or 0.0) < (newest.sigma or 0.0)


async def test_a_sensor_that_was_reopened_adds_nothing_from_before(bench: Bench) -> None:
    await known(bench)
    bench.monitor._judge.restart()  # noqa: SLF001  as on opening, while the last reading is still shown
    assert bench.now().number("roll_deg") is not None


def test_a_stated_inclination_needs_its_uncertainty() -> None:
    assert stated_inclination(None) is None
    assert stated_inclination(Machine(beam_inclination_mm_per_m=10.0)) is None
    stated = stated_inclination(Machine(beam_inclination_mm_per_m=10.0, beam_inclination_sigma_mm_per_m=0.1))
    assert stated == Value(pytest.approx(0.57294, abs=1e-5), pytest.approx(0.0057290, abs=1e-6))  # type: ignore[arg-type]
