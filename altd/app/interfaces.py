"""The configured and the running interfaces; each is imported only if used."""

from __future__ import annotations

import asyncio
import errno
import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

from altd import __version__
from altd.app.keeping import DaemonHistory
from altd.app.settings import local_socket_of
from altd.config import (
    Config,
    HttpSettings,
    Installation,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
    TelegramPortSettings,
)
from altd.config.interfaces import AnySerialPortSettings
from altd.errors import BadInputError
from altd.ports import Clock
from altd.runtime.supervision import Publisher, keep_running
from altd.runtime.threads import call_in_thread
from altd.status.health import Component
from altd.status.unit import PublishedUnit
from altd.tcp_port import listen

_FIRST_TRY_TIMEOUT_S = 1.0

_Settings = ModbusTcpSettings | HttpSettings | MqttSettings | OpcUaSettings | Path | AnySerialPortSettings
"""Settings table of an interface; a path is that of the local socket."""


def interfaces_of(config: Config) -> dict[str, _Settings]:
    """Return the tables of a config's interfaces by their places, which name their components."""
    tables: dict[str, _Settings] = {}
    if (modbus := config.modbus_tcp) is not None:
        tables[f"modbus_tcp {modbus.host}:{modbus.port_or_default}"] = modbus
    if (http := config.http) is not None:
        tables[f"http {http.host}:{http.port}"] = http
    if (mqtt := config.mqtt) is not None:
        tables[f"mqtt {mqtt.host}:{mqtt.port_or_default}"] = mqtt
    if (opcua := config.opcua) is not None:
        tables[f"opcua {opcua.host}:{opcua.port}"] = opcua
    if (path := local_socket_of(config)) is not None:
        tables[f"local {path}"] = path
    return tables | {f"serial {port.device}": port for port in config.serial}


def _address_of(settings: _Settings) -> tuple[str, int] | None:
    """Return host and port at which an interface listens; None: it does not listen on TCP."""
    if isinstance(settings, ModbusTcpSettings):
        return settings.host, settings.port_or_default
    return (settings.host, settings.port) if isinstance(settings, HttpSettings | OpcUaSettings) else None


@dataclass(slots=True)
class _Interface:
    settings: _Settings
    publisher: Publisher
    task: asyncio.Task[None] | None = None


@dataclass(slots=True)
class Interfaces:
    """The interfaces of a unit, each supervised in one of ``tasks``; ``calibrated``: calibration date."""

    unit: PublishedUnit
    past: DaemonHistory
    clock: Clock
    calibrated: date
    installation: Installation
    tasks: asyncio.TaskGroup
    _running: dict[str, _Interface] = field(default_factory=dict)
    _http: HttpSettings | None = None

    async def start(self, config: Config) -> None:
        """Start all interfaces; raises BadInputError for an unusable file or if another daemon runs.

        An interface whose address is taken is retried: it may be free later, and the others serve meanwhile.
        Every interface tries to start before the first frame.
        """
        self._http = config.http
        self._running = await self._made(interfaces_of(config))
        local = {place: each for place, each in self._running.items() if isinstance(each.settings, Path)}
        await self._begin(local, refuses=True)  # only another daemon listens at its socket
        await self._begin({place: each for place, each in self._running.items() if place not in local})

    async def change_to(self, config: Config) -> None:
        """Restart only the interfaces whose tables differ.

        Raises BadInputError for an unusable file or address; all interfaces are then as before.
        """
        wanted, running, http = interfaces_of(config), self._running, self._http
        self._http = config.http
        kept = {place: each for place, each in running.items() if wanted.get(place) == each.settings}
        old = {place: each for place, each in running.items() if place not in kept}
        try:
            new = await self._made({place: table for place, table in wanted.items() if place not in kept})
            self._check_addresses(new)
            await _end(old)
            try:
                await self._begin(new, refuses=True)
            except Exception:
                await _end(new)
                await self._begin(old)
                raise
            self._running = kept | new
        except BaseException:
            self._http = http
            raise
        finally:
            for place in (old.keys() | wanted.keys()) - self._running.keys():
                self.unit.health.remove(place)

    async def _made(self, tables: Mapping[str, _Settings]) -> dict[str, _Interface]:
        """Create the interfaces in a thread: importing one takes up to half a second."""
        components = {place: self.unit.health.component(place) for place in tables}

        def made() -> dict[str, _Interface]:
            return {
                place: _Interface(table, self._publisher(table, components[place]))
                for place, table in tables.items()
            }

        return await call_in_thread(made, "interfaces")

    def _check_addresses(self, new: Mapping[str, _Interface]) -> None:
        """Raise BadInputError for an unavailable address while the old interfaces still serve."""
        held = {address[1] for each in self._running.values() if (address := _address_of(each.settings))}
        for place, interface in new.items():
            if (address := _address_of(interface.settings)) is None:
                continue
            try:
                listen(*address).close()
            except OSError as error:
                if error.errno != errno.EADDRINUSE or address[1] not in held:
                    raise BadInputError(place, error.strerror or str(error)) from error

    async def _begin(self, interfaces: Mapping[str, _Interface], *, refuses: bool = False) -> None:
        """Start interfaces and wait for the first attempt of each, up to ``_FIRST_TRY_TIMEOUT_S``.

        ``refuses``: raises BadInputError for an address that is in use or forbidden.
        """
        tried: list[asyncio.Future[None]] = []
        for place, interface in interfaces.items():
            tried.append(first_try := asyncio.get_running_loop().create_future())
            serving = self._serve(place, interface.publisher, first_try, refuses=refuses)
            interface.task = self.tasks.create_task(serving, name=place)
        if tried:
            await asyncio.wait(tried, timeout=_FIRST_TRY_TIMEOUT_S)
        errors = [None if each.cancel() else each.exception() for each in tried]
        for error in filter(None, errors):
            raise error

    async def _serve(
        self, place: str, publisher: Publisher, first_try: asyncio.Future[None], *, refuses: bool
    ) -> None:
        component, clock = self.unit.health.component(place), self.clock

        def up() -> None:
            if not first_try.done():
                first_try.set_result(None)

        try:
            await keep_running(place, publisher, component, clock, up, refuses=refuses)
        except BadInputError as error:
            if not first_try.done():
                first_try.set_exception(error)
            else:  # too late to refuse the config
                await keep_running(place, publisher, component, clock)

    def _publisher(self, settings: _Settings, component: Component) -> Publisher:
        """Return the publisher of a table; raises BadInputError for an unusable file in it."""
        unit, past = self.unit, self.past
        if isinstance(settings, ModbusTcpSettings):
            from altd.publish.modbus.tcp import ModbusTcpPublisher

            return ModbusTcpPublisher(settings, unit, component)
        if isinstance(settings, HttpSettings):
            from altd.publish.http.publisher import HttpPublisher

            return HttpPublisher(settings, unit, component, past.history, past.events)
        if isinstance(settings, MqttSettings):
            spread = random.Random()  # noqa: S311  spreads reconnections
            if settings.sparkplug is None:
                from altd.publish.mqtt.publisher import MqttPublisher

                about = unit, component, spread, past.outbox
                return MqttPublisher(settings, *about, lambda: self._http)
            from altd.publish.mqtt.edge_node import EdgeNodePublisher

            return EdgeNodePublisher(settings, unit, component, spread)
        if isinstance(settings, OpcUaSettings):
            from altd.publish.opcua.publisher import OpcUaPublisher

            return OpcUaPublisher(settings, unit, component, past.history, self.installation)
        if isinstance(settings, Path):
            from altd.publish.http.publisher import LocalPublisher

            return LocalPublisher(settings, unit, component, past.history)
        return self._serial_publisher(settings, component)

    def _serial_publisher(self, port: AnySerialPortSettings, component: Component) -> Publisher:
        from altd.publish.modbus.rtu import ModbusRtuPublisher
        from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher
        from altd.publish.serial.telegram import Nameplate

        unit = self.unit
        if isinstance(port, ModbusRtuPortSettings):
            return ModbusRtuPublisher(port, unit, component)
        if isinstance(port, TelegramPortSettings):
            nameplate = Nameplate(
                unit=unit.board.identity.unit,
                serial=unit.facts.serial,
                firmware=__version__,
                calibrated=self.calibrated,
            )
            return TelegramPublisher(port, unit.board, component, self.clock, nameplate)
        return ConsolePublisher(port, unit, component, self.past.for_console())


async def _end(interfaces: Mapping[str, _Interface]) -> None:
    """Stop interfaces and wait until their addresses are free."""
    tasks = [interface.task for interface in interfaces.values() if interface.task is not None]
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
