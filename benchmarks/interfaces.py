"""All interfaces of a unit on ports of this computer, and their far ends."""

import contextlib
import os
import shutil
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.harness import HOST, child
from benchmarks.poller import connected
from hw_sim.ports import free_port

BAUD = 115200
BROKER = shutil.which("mosquitto") or ""
"""Path of the broker for measurements with MQTT; empty if it is not installed."""


@dataclass(frozen=True, slots=True)
class Interfaces:
    """Tables of a config; TCP ports, and descriptors of the far ends of the serial lines."""

    tables: dict[str, Any]
    modbus_port: int
    http_port: int
    mqtt_port: int
    telegram: int
    rtu: tuple[int, ...]


def raw_terminal() -> tuple[int, int]:
    """Both ends of a pseudo terminal that transfers bytes unchanged."""
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    return ours, theirs


@contextlib.contextmanager
def interfaces(rtu_lines: int = 1) -> Iterator[Interfaces]:
    """Provide free TCP ports, and pseudo terminals for the telegram and ``rtu_lines`` of Modbus RTU."""
    modbus_port, http_port, mqtt_port, opcua_port = (free_port() for _ in range(4))
    terminals = [raw_terminal() for _ in range(1 + rtu_lines)]
    telegram, *rtu = [{"device": os.ttyname(device), "baud": BAUD} for _, device in terminals]
    tables = {
        "modbus_tcp": {"host": HOST, "port": modbus_port},
        "http": {"host": HOST, "port": http_port},
        "mqtt": {"host": HOST, "port": mqtt_port, "every_measurement": True},
        "opcua": {"host": HOST, "port": opcua_port},
        "serial": [
            telegram | {"speaks": "telegram", "interval_s": 0.1},
            *(line | {"speaks": "modbus_rtu"} for line in rtu),
        ],
    }
    ends = tuple(end for end, _ in terminals)
    try:
        yield Interfaces(tables, modbus_port, http_port, mqtt_port, ends[0], ends[1:])
    finally:
        for terminal in terminals:
            for end in terminal:
                os.close(end)


@contextlib.contextmanager
def broker(port: int, is_wanted: bool = True) -> Iterator[None]:
    """Run Mosquitto on this port if wanted, in the idle scheduling class: a plant's has its own computer."""
    if not is_wanted:
        yield
        return
    with child([BROKER, "-p", str(port)]) as mosquitto:
        os.sched_setscheduler(mosquitto.process.pid, os.SCHED_IDLE, os.sched_param(0))
        connected(port).close()
        yield
