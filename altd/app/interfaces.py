"""The interfaces that a config asks for, each with its place in the config; imported only when wanted."""

from __future__ import annotations

import random
from collections.abc import Iterator
from datetime import date

from altd import __version__
from altd.app.keeping import DaemonHistory
from altd.app.settings import local_socket_of
from altd.config import Config, ModbusRtuPortSettings, TelegramPortSettings
from altd.ports import Clock
from altd.runtime.supervision import Publisher
from altd.status.board import Board
from altd.status.health import Health


def interfaces_of(
    config: Config, board: Board, health: Health, past: DaemonHistory, calibrated: date, clock: Clock
) -> Iterator[tuple[str, Publisher]]:
    """Place and publisher of each; ``calibrated`` is the date of the calibration."""
    if config.modbus_tcp is not None:
        from altd.publish.modbus.tcp import ModbusTcpPublisher

        place = f"modbus_tcp {config.modbus_tcp.host}:{config.modbus_tcp.port_or_default}"
        yield place, ModbusTcpPublisher(config.modbus_tcp, board, health.component(place), health)
    if config.http is not None:
        from altd.publish.http.publisher import HttpPublisher

        place = f"http {config.http.host}:{config.http.port}"
        component = health.component(place)
        yield place, HttpPublisher(config.http, board, health, component, past.history, past.events)
    if config.mqtt is not None:
        place = f"mqtt {config.mqtt.host}:{config.mqtt.port_or_default}"
        spread = random.Random()  # noqa: S311  of reconnections
        if config.mqtt.sparkplug is None:
            from altd.publish.mqtt.publisher import MqttPublisher

            component = health.component(place)
            yield place, MqttPublisher(config.mqtt, board, health, component, spread, past.outbox)
        else:
            from altd.publish.mqtt.edge_node import EdgeNodePublisher

            yield place, EdgeNodePublisher(config.mqtt, board, health, health.component(place), spread)
    if (opcua := config.opcua) is not None:
        from altd.publish.opcua.publisher import OpcUaPublisher

        place = f"opcua {opcua.host}:{opcua.port}"
        component = health.component(place)
        yield place, OpcUaPublisher(opcua, board, health, component, past.history, config.installation)
    if (path := local_socket_of(config)) is not None:
        from altd.publish.http.publisher import LocalPublisher

        place = f"local {path}"
        yield place, LocalPublisher(path, board, health, health.component(place), past.history)
    for port in config.serial:
        from altd.publish.modbus.rtu import ModbusRtuPublisher
        from altd.publish.serial.publisher import ConsolePublisher, TelegramPublisher
        from altd.publish.serial.telegram import Nameplate

        place = f"serial {port.device}"
        component = health.component(place)
        if isinstance(port, ModbusRtuPortSettings):
            yield place, ModbusRtuPublisher(port, board, component, health)
        elif isinstance(port, TelegramPortSettings):
            unit, serial = board.identity.unit, config.unit.serial
            nameplate = Nameplate(unit=unit, serial=serial, firmware=__version__, calibrated=calibrated)
            yield place, TelegramPublisher(port, board, component, clock, nameplate)
        else:
            yield place, ConsolePublisher(port, board, health, component, clock, past.for_console())
