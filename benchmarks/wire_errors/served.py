"""Two units that differ only in their serial numbers, each with all its interfaces, in a separate process.

``python -m benchmarks.wire_errors.served PORTS`` takes the serial ports of both as JSON and prints their TCP
ports as one line of JSON. It ends when its standard input does.
"""

import asyncio
import json
import signal
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Final

from altd.config import HttpSettings, ModbusRtuPortSettings, ModbusTcpSettings, TelegramPortSettings
from altd.instruments.beam.instrument import QUANTITIES, values_of
from altd.instruments.beam.solver import Beam
from altd.publish.http.publisher import HttpPublisher
from altd.publish.modbus.rtu import ModbusRtuPublisher
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.publish.serial.publisher import TelegramPublisher
from altd.publish.serial.telegram import Nameplate
from altd.records import Measurement, Value
from altd.runtime.clock import SystemClock
from altd.runtime.supervision import Publisher
from altd.status.board import Board
from altd.status.health import Health
from altd.status.proof import Identity, unit_number

SERIALS = ("ALT-0007", "ALT-0008")
RATE_HZ = 40.0
_AGE_S = 0.005
_BAUD: Final = 230400


class _Unit:
    """A board with measurements, and its interfaces."""

    def __init__(self, serial: str, ports: dict[str, list[str]]) -> None:
        self.clock = SystemClock()
        self.board = board = Board(self.clock, 1.0, QUANTITIES, Identity.drawn(serial))
        health = Health(self.clock)
        component = health.component(serial)
        self.http = HttpPublisher(HttpSettings(host="127.0.0.1", port=0), board, health, component)
        self.tcp = ModbusTcpPublisher(ModbusTcpSettings(host="127.0.0.1", port=0), board, component, health)
        plate = Nameplate(unit=unit_number(serial), serial=serial, firmware="", calibrated=None)
        self.faces: list[Publisher] = [self.http, self.tcp]
        for device in ports["telegram"]:
            line = TelegramPortSettings(
                device=Path(device), speaks="telegram", baud=_BAUD, interval_s=0.05, checked=True
            )
            self.faces.append(TelegramPublisher(line, board, component, self.clock, plate))
        for device in ports["rtu"]:
            rtu = ModbusRtuPortSettings(device=Path(device), speaks="modbus_rtu", baud=_BAUD)
            self.faces.append(ModbusRtuPublisher(rtu, board, component, health))

    async def measure(self) -> None:
        """Publish differing measurements without end."""
        for sequence in count(1):
            self.board.publish(self._measurement(sequence))
            await asyncio.sleep(1 / RATE_HZ)

    def _measurement(self, sequence: int) -> Measurement:
        t_ns = self.clock.monotonic_ns() - round(_AGE_S * 1e9)
        x_mm = 10 + sequence % 1000 / 1000
        beam = Beam(x_mm, 4.987, 1.1459, -1.7184, 0.004, 0.004, 0.0011, 0.0011)
        points = {"front": {"x_mm": Value(x_mm), "y_mm": Value(4.987)}}
        blank = Measurement(sequence, t_ns, self.clock.utc(t_ns), 20, QUANTITIES, {}, points)
        return replace(blank, values=values_of(beam))


async def _run(face: Publisher, ready: asyncio.Event) -> None:
    await face.run(ready.set)


async def _serve(ports: list[dict[str, list[str]]]) -> None:
    units = [_Unit(serial, of_unit) for serial, of_unit in zip(SERIALS, ports, strict=True)]
    async with asyncio.TaskGroup() as tasks:
        served = []
        for unit in units:
            served.append(tasks.create_task(unit.measure()))
            for face in unit.faces:
                ready = asyncio.Event()
                served.append(tasks.create_task(_run(face, ready)))
                await ready.wait()
        print(json.dumps([{"tcp": unit.tcp.port, "http": unit.http.port} for unit in units]), flush=True)
        await asyncio.to_thread(sys.stdin.read)
        for task in served:
            task.cancel()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    asyncio.run(_serve(json.loads(sys.argv[1])))
