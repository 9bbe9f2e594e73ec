"""The whole of ``altd.toml``; what must fit between its tables: ``rules.py``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from altd.config.cameras import CameraTable
from altd.config.faces import Http, ModbusTcp, SerialPort
from altd.config.lamps import IndicatorLamps, LampsTable
from altd.config.measuring import Measuring
from altd.config.stage import GrblStage, Scan
from altd.config.table import Name, Table
from altd.config.unit import Installation, Target, Unit


class Config(Table):
    """The whole of ``altd.toml``."""

    unit: Unit
    targets: Annotated[tuple[Target, ...], Field(min_length=2)]
    cameras: dict[Name, CameraTable] = Field(default={})
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    modbus_tcp: ModbusTcp | None = None
    http: Http | None = None
    serial: tuple[SerialPort, ...] = ()
    lamps: LampsTable | None = None
    indicators: IndicatorLamps | None = None
    stage: GrblStage | None = None
    scan: Scan = Scan()
