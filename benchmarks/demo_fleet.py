"""``python -m benchmarks.demo_fleet``: twenty simulated units, broker, PostgreSQL, ingest and `altd fleet`.

Each unit has a real history, outbox and MQTT publisher; its measurements are invented, two per second. Two of
the units have faults. One loses its beam for ten seconds in each half minute, as its state, its cause and its
share of valid measurements show. The other has no network for forty seconds in each minute, and catches up.
"""

import asyncio
import contextlib
import dataclasses
import math
import random
import sys
import tempfile
from collections.abc import Awaitable
from pathlib import Path

from altd.app.keeping import DaemonHistory
from altd.config import MqttSettings
from altd.errors import BadInputError
from altd.fleet.settings import FleetSettings
from altd.fleet.table import as_text, units
from altd.history.columns import columns_of
from altd.history.records import About
from altd.instruments.beam.instrument import QUANTITIES, values_of
from altd.instruments.beam.solver import Beam
from altd.publish.mqtt.publisher import MqttPublisher
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.runtime.clock import SystemClock
from altd.runtime.supervision import keep_running
from altd.status.board import Board
from altd.status.health import MEASURING, Health, State
from altd.status.proof import Identity
from altd.status.state import UnitState
from altd.status.unit import PublishedUnit, UnitFacts
from benchmarks.fleet import servers
from benchmarks.harness import Parser, end

UNITS = 20
_BLIND, _CUT_OFF = 7, 13
"""Numbers of the units with faults."""

_INTERVAL_S = 0.5
_SHOWN_EVERY_S = 5.0
_MAX_BYTES = 64 * 10**6
_AGE_S = 2.0


class DemoUnit:
    """A unit without cameras."""

    def __init__(self, number: int, folder: Path, port: int) -> None:
        self.number = number
        self._clock = SystemClock()
        serial = f"ALT-{number:04d}"
        self._board = Board(self._clock, _AGE_S, QUANTITIES, Identity.drawn(serial), rehearsal=True)
        health = Health(self._clock)
        health.component(MEASURING).set_state(State.OK)
        state, facts = UnitState(self._board, health, self._clock), UnitFacts(serial=serial, version="demo")
        unit = PublishedUnit(self._board, health, facts, state=state.read)
        self._past = DaemonHistory(unit, state)
        about = About(columns_of(QUANTITIES, ()), {"serial": serial})
        self._past.keep_in(folder / f"{serial}.db", _MAX_BYTES, about, has_outbox=True)
        self._component = health.component("mqtt")
        settings = MqttSettings(host="127.0.0.1", port=port, store_and_forward=True)
        self._publisher = MqttPublisher(
            settings, unit, self._component, random.Random(number), self._past.outbox
        )

    async def run(self) -> None:
        """Measure, store and publish until cancelled."""
        async with self._past.recorded():
            await asyncio.gather(self._measure(), self._publish())

    async def _measure(self) -> None:
        sequence = 0
        while True:
            now_ns = self._clock.monotonic_ns()
            sequence += 1
            phase = now_ns * 1e-9 / 60 + self.number
            beam = Beam(
                10 * math.sin(phase), self.number, 0.5 * math.cos(phase), -1.0, 0.004, 0.004, 0.0011, 0.0011
            )
            is_blind = self.number == _BLIND and now_ns * 1e-9 % 30 < 10
            values = {} if is_blind else values_of(beam)
            status = (Fault(Reason.SIMULATED), *([Fault(Reason.SPOT_MISSING, "front")] if is_blind else []))
            measurement = Measurement(
                sequence, now_ns, self._clock.utc(now_ns), 20, QUANTITIES, values, {}, status=status
            )
            self._past.record(self._board.publish(dataclasses.replace(measurement, last_exposure_ns=now_ns)))
            await asyncio.sleep(_INTERVAL_S)

    async def _publish(self) -> None:
        """Publish, with the network of one unit disconnected periodically."""
        while True:
            has_network = self.number != _CUT_OFF or self._clock.monotonic_ns() * 1e-9 % 60 < 20
            if has_network:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(20.0 if self.number == _CUT_OFF else None):
                        await keep_running("mqtt", self._publisher, self._component, self._clock)
            else:
                await asyncio.sleep(0.5)


async def show_units(connection: str) -> None:
    """Print the table of `altd fleet` until cancelled; while there is none, the reason."""
    settings = FleetSettings.model_validate(
        {"broker": {"host": "127.0.0.1"}, "database": {"connection": connection}}
    )
    while True:
        await asyncio.sleep(_SHOWN_EVERY_S)
        try:
            lines = as_text(await asyncio.to_thread(units, settings))
        except BadInputError as error:  # the database restarts: units and ingest wait for it
            lines = [str(error)]
        print("\n".join(["\x1b[2J\x1b[H" if sys.stdout.isatty() else "", *lines]), flush=True)


async def _demo(folder: Path, port: int, connection: str, seconds: float | None) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            work: list[Awaitable[None]] = [
                DemoUnit(number, folder, port).run() for number in range(1, UNITS + 1)
            ]
            await asyncio.gather(*work, show_units(connection))


def main() -> int:
    """Run until Ctrl-C."""
    parser = Parser("benchmarks.demo_fleet", "Twenty simulated units.")
    parser.number("--seconds", None, "end after this time (default: never)")
    options = parser.parse_args()
    with (
        contextlib.suppress(KeyboardInterrupt),
        tempfile.TemporaryDirectory() as folder,
        servers([]) as served,
    ):
        port, connection, _ = served
        print(f"broker: 127.0.0.1 port {port}; database: {connection}", flush=True)
        asyncio.run(_demo(Path(folder), port, connection, options.seconds))
    return 0


if __name__ == "__main__":
    end(main, "benchmarks.demo_fleet")
