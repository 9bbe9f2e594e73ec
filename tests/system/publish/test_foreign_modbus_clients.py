"""pyModbusTCP and minimalmodbus read the real daemon; HTTP says what they must find."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import minimalmodbus
import pytest
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.utils import decode_ieee, word_list_to_long
from support.played_unit import PlayedUnit, PlayingDaemon, playing
from support.wire import socat_line

KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
FLOATS, SEQUENCE = 20, 8

Read = Callable[[], tuple[int, list[float]]]
"""Reads the sequence and the four values in one request."""


def agrees(daemon: PlayingDaemon, read: Read) -> None:
    """Until both interfaces were read between two measurements: their sequence is then the same."""
    daemon.wait_until_valid()
    for _ in range(200):
        before = daemon.measurement()
        sequence, values = read()
        if before["sequence"] == sequence:
            break
    else:
        pytest.fail("never the same measurement")
    assert values == pytest.approx([before[key] for key in KEYS], abs=1e-4)


def test_pymodbustcp_reads_the_numbers_of_http(played_unit: PlayedUnit, tmp_path: Path) -> None:
    with playing(played_unit, tmp_path, subprocess.DEVNULL) as daemon:
        client = ModbusClient("127.0.0.1", daemon.modbus, unit_id=1, timeout=20.0, auto_open=True)

        def read() -> tuple[int, list[float]]:
            words = client.read_input_registers(0, 50)
            assert words is not None, client.last_error_as_txt
            (sequence,) = word_list_to_long(words[SEQUENCE : SEQUENCE + 2])
            numbers = word_list_to_long(words[FLOATS : FLOATS + 8])
            return sequence, [decode_ieee(number) for number in numbers]

        agrees(daemon, read)
        client.close()


def test_minimalmodbus_reads_the_numbers_of_http_over_a_line(played_unit: PlayedUnit, tmp_path: Path) -> None:
    with socat_line(tmp_path) as (unit, controller, _):
        more = f'[[serial]]\ndevice = "{unit}"\nspeaks = "modbus_rtu"\nbaud = 115200\nunit_id = 12\n'
        with playing(played_unit, tmp_path, subprocess.DEVNULL, more=more) as daemon:
            instrument = minimalmodbus.Instrument(str(controller), 12)
            instrument.serial.baudrate, instrument.serial.timeout = 115200, 5.0

            def read() -> tuple[int, list[float]]:
                words = instrument.read_registers(0, 28, functioncode=4)
                sequence = words[SEQUENCE] << 16 | words[SEQUENCE + 1]
                pairs = zip(words[FLOATS::2], words[FLOATS + 1 :: 2], strict=True)
                return sequence, [decode_ieee(high << 16 | low) for high, low in pairs]

            agrees(daemon, read)
            for _ in range(200):  # until three requests are answered from one measurement
                before, values = read()
                x_mm = instrument.read_float(FLOATS, functioncode=3)
                if read()[0] == before:
                    break
            else:
                pytest.fail("never the same measurement")
            assert x_mm == values[0]
            instrument.serial.close()
