"""The whole of ``altd.toml``; what must fit between its tables: ``rules.py``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from altd.config.cameras import AnyCameraSettings
from altd.config.history import HistorySettings
from altd.config.inclinometer import InclinometerSettings
from altd.config.interfaces import AnySerialPortSettings, HttpSettings, ModbusTcpSettings
from altd.config.kept_frames import KeptFrames
from altd.config.lamps import AnyLampsSettings, IndicatorsSettings
from altd.config.local import LocalSettings
from altd.config.maintenance import HwmonThermometerSettings, Maintenance
from altd.config.measuring import Measuring
from altd.config.self_check import SelfCheckSettings
from altd.config.stage import GrblStageSettings, Scan
from altd.config.table import Name, Table
from altd.config.unit import Installation, Target, Unit


class Config(Table):
    """The whole of ``altd.toml``."""

    unit: Unit
    targets: Annotated[tuple[Target, ...], Field(min_length=2)]
    cameras: dict[Name, AnyCameraSettings] = Field(default={})
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    modbus_tcp: ModbusTcpSettings | None = None
    http: HttpSettings | None = None
    local: LocalSettings | None = None
    serial: tuple[AnySerialPortSettings, ...] = ()
    lamps: AnyLampsSettings | None = None
    indicators: IndicatorsSettings | None = None
    self_check: SelfCheckSettings = SelfCheckSettings()
    inclinometer: InclinometerSettings | None = None
    thermometers: tuple[HwmonThermometerSettings, ...] = ()
    maintenance: Maintenance = Maintenance()
    kept_frames: KeptFrames = KeptFrames()
    history: HistorySettings = HistorySettings()
    stage: GrblStageSettings | None = None
    scan: Scan = Scan()
