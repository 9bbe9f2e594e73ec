"""The inclinometer's driver against simulated sensors on a pseudo-terminal and bytes made by hand."""

import math
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest
from support.foreign import need_program
from support.inclinometer import FINE, answering, settings
from support.modbus_rtu_wire import frame

from altd.devices.inclinometer.driver import ModbusInclinometer
from altd.devices.inclinometer.registers import BALLUFF, SENSORS, WITMOTION, Kind
from altd.ports import (
    InclinometerDisturbedError,
    InclinometerError,
    InclinometerNotFoundError,
    InclinometerReading,
    InclinometerRefusedError,
    InclinometerTimeoutError,
    InclinometerWrongError,
)
from altd.records.sensors import within_half_turn
from hw_sim.inclinometer import INPUT, Inclinometer

DRIVERS = {"balluff_bsi_r11a0": Inclinometer.balluff, "witmotion_wt901c485": Inclinometer.witmotion}


PATIENCE_S = 30.0
"""For an answer that comes: on a busy machine the thread of a simulated sensor may wait for its turn."""
ANSWER_WITHIN_S = 0.2
"""As the driver has it, for an answer that does not come, or too late."""


@pytest.fixture(autouse=True)
def wait(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Set how long the driver waits for an answer."""

    def wait(seconds: float) -> None:
        monkeypatch.setattr("altd.devices.inclinometer.driver._ANSWER_TIMEOUT_S", seconds)

    wait(PATIENCE_S)
    return wait


@contextmanager
def opened(driver: str = "balluff_bsi_r11a0") -> Iterator[tuple[Inclinometer, ModbusInclinometer]]:
    with DRIVERS[driver]() as sensor:
        inclinometer = settings(sensor.device, driver).inclinometer()
        try:
            inclinometer.open()
            yield sensor, inclinometer
        finally:
            inclinometer.close()


def _open_and_read(inclinometer: ModbusInclinometer) -> None:
    inclinometer.open()
    inclinometer.read()


class TestTables:
    @pytest.mark.parametrize(
        ("sensor", "requests"),
        [
            (BALLUFF, [(4, 0, 1), (4, 10, 1)]),
            (WITMOTION, [(3, 0x34, 13)]),
        ],
    )
    def test_a_reading_asks_for_what_lies_together_at_once(
        self, sensor: object, requests: list[tuple[int, int, int]]
    ) -> None:
        blocks = sensor.blocks(settings=False)  # type: ignore[attr-defined]
        assert [(block[0].function, block[0].address, len(block)) for block in blocks] == requests

    @pytest.mark.parametrize(
        ("kind", "word", "number"),
        [
            *((Kind.U16, 0xFFFF, 65535), (Kind.S16, 0xFFFF, -1), (Kind.S16, 0x7FFF, 32767)),
            *(
                (Kind.S32, 0xFFFFFFFE, -2),
                (Kind.U32, 0xFFFFFFFE, 0xFFFFFFFE),
                (Kind.F32, 0xC0490FDB, -math.pi),
            ),
        ],
    )
    def test_registers_hold_numbers(self, kind: Kind, word: int, number: float) -> None:
        assert kind.number(word) == pytest.approx(number, rel=1e-7)

    def test_the_low_word_is_first_where_words_are_swapped(self) -> None:
        assert Kind.U32.raw([0x1234, 0x5678]) == 0x12345678
        assert Kind.F32_SWAPPED.raw([0x5678, 0x1234]) == 0x12345678
        assert Kind.S16.raw([0xFFFF]) == 0xFFFF

    @pytest.mark.parametrize(
        ("angle", "within"), [(0, 0), (359.99, -0.01), (180, -180), (-180, -180), (190, -170), (36.5, 36.5)]
    )
    def test_angles_are_within_half_a_turn(self, angle: float, within: float) -> None:
        assert within_half_turn(angle) == pytest.approx(within, abs=1e-9)

    def test_every_driver_of_the_settings_has_a_table(self) -> None:
        assert set(SENSORS) == set(DRIVERS)


BALLUFF_ANSWERS = {
    "0103 0085 0003": "0103 06 0001 0000 0000",
    "0103 00c8 0002": "0103 04 0001 00c0",
    "0104 0000 0001": "0104 02 8c97",  # 35991: 359.91°
    "0104 000a 0001": "0104 02 fe0c",  # -500: -5.00 °C
}
WITMOTION_ANSWERS = {
    "5003 0004 0001": "5003 02 0002",
    "5003 001a 0001": "5003 02 0050",
    "5003 0034 000d": "5003 1a 0001 0002 07f0 0000 0000 0000 0000 0000 0000 e000 0400 0000 0bb8",
}


def by_hand(answers: dict[str, str]) -> Callable[[bytes], bytes]:
    known = {bytes.fromhex(asked): bytes.fromhex(answer) for asked, answer in answers.items()}
    return lambda request: frame(known[request[:-2]][1:], request[0])


class TestBytes:
    def test_of_the_balluff_are_angle_and_temperature(self) -> None:
        with answering(by_hand(BALLUFF_ANSWERS)) as wire:
            inclinometer = settings(wire.device).inclinometer()
            inclinometer.open()
            reading = inclinometer.read()
            inclinometer.close()
        assert reading.roll_deg == pytest.approx(-0.09)
        assert reading.temperature_c == pytest.approx(-5.0)
        assert reading.pitch_deg is None
        assert reading.words == (35991, 0xFE0C)

    def test_of_the_witmotion_are_roll_and_pitch(self) -> None:
        with answering(by_hand(WITMOTION_ANSWERS)) as wire:
            inclinometer = settings(wire.device, "witmotion_wt901c485").inclinometer()
            inclinometer.open()
            reading = inclinometer.read()
            inclinometer.close()
        assert reading.roll_deg == pytest.approx(-45.0)  # -8192/32768 of 180°
        assert reading.pitch_deg == pytest.approx(5.625)  # 1024/32768 of 180°
        assert reading.temperature_c == pytest.approx(30.0)

    @pytest.mark.parametrize(
        ("asked", "answer", "complaint"),
        [
            ("0103 0085 0003", "0103 06 0001 0064 0000", r"register 134 \(offset\) is 100 and must be 0"),
            ("0103 0085 0003", "0103 06 0001 0000 0001", r"register 135 .* is 1 and must be 0"),
            ("0103 0085 0003", "0103 06 0014 0000 0000", r"register 133 .* is 20: its values are 1.6 s old"),
            ("0103 00c8 0002", "0103 04 0002 00c0", r"register 200 \(address\) is 2 and must be 1"),
            ("0103 00c8 0002", "0103 04 0001 0060", r"register 201 .* is 96 and must be 192"),
            ("0104 0000 0001", "0104 02 8ca1", r"register 0 .* says 36001"),
            ("0103 0085 0003", "0183 02", r"another sensor: it refuses function 3, register 133"),
        ],
    )
    def test_a_sensor_that_is_another_one_or_set_up_otherwise_is_refused(
        self, asked: str, answer: str, complaint: str
    ) -> None:
        with answering(by_hand(BALLUFF_ANSWERS | {asked: answer})) as wire:
            inclinometer = settings(wire.device).inclinometer()
            with closing(inclinometer), pytest.raises(InclinometerWrongError, match=complaint):
                _open_and_read(inclinometer)

    def test_an_invalid_setting_is_no_angle(self) -> None:
        answers = BALLUFF_ANSWERS | {"0104 0000 0001": "0104 02 d903"}
        with answering(by_hand(answers)) as wire:
            inclinometer = settings(wire.device).inclinometer()
            inclinometer.open()
            with pytest.raises(InclinometerRefusedError, match="register 0 says 55555"):
                inclinometer.read()
            inclinometer.close()

    @pytest.mark.parametrize(
        ("spoilt", "complaint"),
        [
            (lambda good: good[:-1] + bytes([good[-1] ^ 1]), "damaged answer"),
            (lambda good: good[:-3], "damaged answer"),
            (lambda good: good + b"\0", "another question"),  # a CRC stays good when a zero follows it
            (lambda good: good + good, "damaged answer"),
            (lambda good: b"\0" + good, "damaged answer"),
            (lambda good: bytes(1000), "damaged answer"),
            (lambda good: frame(good[1:-2], 9), "address 9 answers"),
            (lambda good: frame(bytes([4]) + good[2:-2], 1), "another question"),
            (lambda good: frame(good[1:2] + b"\2" + good[3:5], 1), "another question"),
            (lambda good: frame(good[1:2] + b"\4" + good[3:-2], 1), "another question"),
            (lambda good: frame(good[1:2] + b"\x08" + good[3:-2] + b"\0\0", 1), "another question"),
        ],
    )
    def test_what_is_none_is_taken_for_none(self, spoilt: Callable[[bytes], bytes], complaint: str) -> None:
        good = by_hand(BALLUFF_ANSWERS)
        raises = pytest.raises(InclinometerDisturbedError, match=complaint)
        with answering(lambda request: spoilt(good(request))) as wire, raises:
            settings(wire.device).inclinometer().open()

    def test_a_two_wire_adapter_that_hears_itself_does_no_harm(self) -> None:
        good = by_hand(BALLUFF_ANSWERS)
        with answering(lambda request: request + good(request)) as wire:
            inclinometer = settings(wire.device).inclinometer()
            inclinometer.open()
            assert inclinometer.read().roll_deg == pytest.approx(-0.09)
            inclinometer.close()


class TestSensor:
    @pytest.mark.parametrize("driver", DRIVERS)
    def test_reads_what_the_sensor_measures(self, driver: str) -> None:
        with opened(driver) as (sensor, inclinometer):
            sensor.roll_deg, sensor.pitch_deg, sensor.noise_deg = -3.25, 1.5, 0.0
            before_ns = time.monotonic_ns()
            reading = inclinometer.read()
        assert reading.roll_deg == pytest.approx(-3.25, abs=0.006)
        assert reading.pitch_deg == (pytest.approx(1.5, abs=0.006) if "wit" in driver else None)
        assert reading.temperature_c == pytest.approx(21.5, abs=0.2)
        assert 0.0 < (before_ns - reading.t_ns) * 1e-9 < 0.2  # as old as the sensor's own sampling

    @pytest.mark.parametrize("driver", DRIVERS)
    def test_that_is_silent_is_said_to_be(self, driver: str, wait: Callable[[float], None]) -> None:
        with opened(driver) as (sensor, inclinometer):
            sensor.answers = False
            wait(ANSWER_WITHIN_S)
            with pytest.raises(InclinometerTimeoutError, match="no answer: address"):
                inclinometer.read()
            sensor.answers = True
            wait(PATIENCE_S)
            assert inclinometer.read().roll_deg == pytest.approx(0.0, abs=0.2)

    def test_at_another_address_is_silent(self, wait: Callable[[float], None]) -> None:
        wait(ANSWER_WITHIN_S)
        with Inclinometer.balluff() as sensor:
            sensor.address = 2
            with pytest.raises(InclinometerTimeoutError, match="no answer: address 1 on"):
                settings(sensor.device).inclinometer().open()

    def test_of_the_other_make_is_found_out(self) -> None:
        raises = pytest.raises(InclinometerWrongError, match="another sensor")
        with Inclinometer.witmotion() as sensor, raises:
            settings(sensor.device, address=0x50, baud=9600).inclinometer().open()

    def test_on_a_line_that_only_echoes_is_said_to_be_missing(self, wait: Callable[[float], None]) -> None:
        wait(1.0)
        with Inclinometer.balluff() as sensor:
            sensor.echoes, sensor.answers = True, False
            with pytest.raises(InclinometerTimeoutError, match="echoes the requests, and no sensor"):
                settings(sensor.device).inclinometer().open()

    def test_with_damaged_answers_is_said_to_have_them(self) -> None:
        with opened() as (sensor, inclinometer):
            sensor.corrupts = True
            with pytest.raises(InclinometerDisturbedError, match="damaged"):
                inclinometer.read()

    def test_that_is_unplugged_has_no_port(self) -> None:
        with opened() as (sensor, inclinometer):
            sensor.unplug()
            with pytest.raises(InclinometerNotFoundError, match=r"unplugged\?"):
                inclinometer.read()
            with pytest.raises(InclinometerNotFoundError, match="no such port"):
                inclinometer.open()

    @pytest.mark.parametrize("late_s", [0.21, 0.25, 0.3, 0.4])
    def test_that_answers_late_never_has_its_temperature_taken_for_an_angle(
        self, late_s: float, wait: Callable[[float], None]
    ) -> None:
        with opened() as (sensor, inclinometer):
            sensor.roll_deg, sensor.noise_deg = -3.0, 0.0
            read = []
            for late in (0.0, late_s, late_s, 0.0, late_s, 0.0, 0.0, 0.0, 0.0):
                sensor.late_s = late
                wait(ANSWER_WITHIN_S if late else PATIENCE_S)
                try:
                    reading = inclinometer.read()
                except InclinometerError:
                    continue
                read.append((reading.roll_deg, reading.temperature_c))
        assert len(read) >= 3
        assert all(roll == pytest.approx(-3.0, abs=0.02) for roll, _ in read)
        assert all(temperature == pytest.approx(21.5, abs=0.2) for _, temperature in read)


@pytest.mark.parametrize(
    ("driver", "table", "address", "baud", "register", "expected"),
    [
        ("balluff_bsi_r11a0", 3, 1, 19200, 0, 34750),
        ("balluff_bsi_r11a0", 4, 1, 19200, 201, 192),
        ("witmotion_wt901c485", 4, 80, 9600, 0x3D, round(-12.5 / 180 * 32768) & 0xFFFF),
    ],
)
def test_a_foreign_client_reads_the_simulated_sensors(
    driver: str, table: int, address: int, baud: int, register: int, expected: int
) -> None:
    """mbpoll's table 3 is that of input registers, 4 that of holding registers."""
    with DRIVERS[driver]() as sensor:
        sensor.roll_deg, sensor.noise_deg = -12.5, 0.0
        command = [need_program("mbpoll"), "-m", "rtu", "-b", baud, "-P", "none", "-a", address, "-0", "-1"]
        command += ["-t", f"{table}:hex", "-r", register, "-c", 1, sensor.device]
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=60)
    assert f"[{register}]: \t0x{expected:04X}" in done.stdout, done.stdout + done.stderr


def test_the_simulated_balluff_says_55555_where_a_setting_is_none() -> None:
    sensor = Inclinometer.balluff()
    sensor.settings[133] = 21
    answer = sensor.response(struct.pack(">BHH", INPUT, 0, 1))
    sensor.unplug()
    assert answer == struct.pack(">BBH", INPUT, 2, 55555)


class TestDescribedSensor:
    @pytest.fixture
    def fine(self) -> Iterator[Inclinometer]:
        with Inclinometer.fine() as sensor:
            sensor.noise_deg, sensor.roll_deg, sensor.pitch_deg = 0.0, 3.25, -7.5
            yield sensor

    def read(self, sensor: Inclinometer, times: int = 1, **of_sheet: object) -> InclinometerReading:
        inclinometer = settings(sensor.device, "modbus", sensor=FINE | of_sheet).inclinometer()
        with closing(inclinometer):
            inclinometer.open()
            return [inclinometer.read() for _ in range(times)][-1]

    def test_is_read_by_its_data_sheet(self, fine: Inclinometer) -> None:
        reading = self.read(fine)
        across = math.degrees(math.asin(math.sin(math.radians(3.25)) * math.cos(math.radians(7.5))))
        assert (reading.roll_deg, reading.pitch_deg) == (pytest.approx(across), pytest.approx(-7.5))
        assert reading.temperature_c == pytest.approx(21.5, abs=0.2)

    @pytest.mark.parametrize(
        ("row", "change", "said"),
        [
            (0, {"type": "f32"}, r"register 0 \(roll\) says"),
            (0, {"type": "s32"}, r"register 0 \(roll\) says"),
            (1, {"address": 3, "type": "s16"}, r"register 3 \(pitch\) says"),
            (2, {"scale": 1.0}, r"register 4 \(temperature\) says"),
            (3, {"must_be": 0x4712}, r"register 100 \(identity\) is 18193 and must be 18194: another sensor"),
            (3, {"address": 101}, "refuses function 3, register 101"),
        ],
    )
    def test_is_refused_with_a_wrong_data_sheet(
        self, fine: Inclinometer, row: int, change: dict[str, object], said: str
    ) -> None:
        rows = [dict(of) for of in FINE["registers"]]
        rows[row] |= change
        fine.noise_deg = 0.003  # the last digits are first with swapped words: a reading can be possible
        with pytest.raises(InclinometerWrongError, match=said):
            self.read(fine, 5, registers=rows)

    def test_a_number_that_is_none_is_no_angle(self, fine: Inclinometer) -> None:
        fine.axes = ((math.nan, 0.0, 0.0), (0.0, 0.0, 1.0))
        with pytest.raises(InclinometerWrongError, match=r"register 0 \(roll\) says nan"):
            self.read(fine)
