"""The complete ``altd.toml``; ``rules.py`` contains the rules between its tables."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from altd.config import drivers
from altd.config.interfaces import (
    AnySerialPortSettings,
    HttpSettings,
    LocalSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
)
from altd.config.keeping import HistorySettings, KeptFrames
from altd.config.measuring import Maintenance, Measuring, Scan, SelfCheckSettings
from altd.config.unit import Installation, Machine, Plate, RowSettings, Target, Unit
from altd.devices.settings import DeviceTable, Driver
from altd.files.table import Name, Table, complaint


class Config(Table):
    """The complete ``altd.toml``."""

    unit: Unit
    targets: tuple[Target, ...] = ()
    cameras: dict[Name, drivers.AnyCameraSettings] = Field(default={})
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    machine: Machine | None = None
    chain: RowSettings | None = None
    plate: Plate | None = None
    modbus_tcp: ModbusTcpSettings | None = None
    http: HttpSettings | None = None
    mqtt: MqttSettings | None = None
    opcua: OpcUaSettings | None = None
    local: LocalSettings | None = None
    serial: tuple[AnySerialPortSettings, ...] = ()
    lamps: drivers.AnyLampsSettings | None = None
    switches: drivers.AnySwitchesSettings | None = None
    indicators: drivers.AnyIndicatorsSettings | None = None
    self_check: SelfCheckSettings = SelfCheckSettings()
    inclinometer: drivers.AnyInclinometerSettings | None = None
    thermometers: tuple[drivers.AnyThermometerSettings, ...] = ()
    maintenance: Maintenance = Maintenance()
    kept_frames: KeptFrames = KeptFrames()
    history: HistorySettings = HistorySettings()
    stage: drivers.AnyStageSettings | None = None
    scan: Scan = Scan()

    @model_validator(mode="after")
    def _check_roll(self) -> Self:
        is_known = self.inclinometer is not None or (self.machine and self.machine.roll_deg is not None)
        if self.machine and self.machine.points and not is_known:
            text = "the points need a roll; possible: roll_deg, or a table [inclinometer]"
            raise complaint((("machine", "roll_deg"), text))
        return self

    @model_validator(mode="after")
    def _check_view(self) -> Self:
        if self.self_check.compensate and self.installation.expansion.view_ppm_per_k:
            text = "the self-check corrects the views already; possible: 0, or compensate = false"
            raise complaint((("installation", "expansion", "view_ppm_per_k"), text))
        return self

    @property
    def switched_targets(self) -> tuple[Target, ...]:
        """Targets with a switched glass, in beam order."""
        is_row = self.unit.instrument == "chain"
        return tuple(target for target in self.targets if is_row or target.switched)

    @property
    def has_outbox(self) -> bool:
        """Whether the history keeps its seconds for an ingest."""
        return self.mqtt is not None and self.mqtt.store_and_forward

    @property
    def measuring_cameras(self) -> tuple[str, ...]:
        """Cameras of the targets, in beam order; without targets, the plate's camera."""
        return tuple(target.camera for target in self.targets) or tuple(self.cameras)

    def tables_by_driver(self) -> dict[Driver, dict[str, DeviceTable]]:
        """Return the tables of the drivers that can check them, by the table's key or the camera's name."""
        found: dict[Driver, dict[str, DeviceTable]] = {}
        for key, value in self:
            named = value if isinstance(value, dict) else {key: value}
            if isinstance(value, tuple):
                named = {f"{key}.{number}": table for number, table in enumerate(value)}
            for name, table in named.items():
                if isinstance(table, DeviceTable) and table.about:
                    found.setdefault(table.about, {})[name] = table
        return {driver: found[driver] for driver in drivers.DRIVERS if driver in found}
