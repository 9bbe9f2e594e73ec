"""The complete ``altd.toml``; ``rules.py`` contains the rules between its tables."""

from __future__ import annotations

from pydantic import Field

from altd.config.cameras import AnyCameraSettings
from altd.config.devices import (
    AnyLampsSettings,
    AnySwitchesSettings,
    GrblStageSettings,
    InclinometerSettings,
    IndicatorsSettings,
    Scan,
)
from altd.config.interfaces import (
    AnySerialPortSettings,
    HttpSettings,
    LocalSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
)
from altd.config.keeping import HistorySettings, KeptFrames
from altd.config.measuring import HwmonThermometerSettings, Maintenance, Measuring, SelfCheckSettings
from altd.config.table import Name, Table
from altd.config.unit import Installation, Plate, RowSettings, Target, Unit


class Config(Table):
    """The complete ``altd.toml``."""

    unit: Unit
    targets: tuple[Target, ...] = ()
    cameras: dict[Name, AnyCameraSettings] = Field(default={})
    measuring: Measuring = Measuring()
    installation: Installation = Installation()
    chain: RowSettings | None = None
    plate: Plate | None = None
    modbus_tcp: ModbusTcpSettings | None = None
    http: HttpSettings | None = None
    mqtt: MqttSettings | None = None
    opcua: OpcUaSettings | None = None
    local: LocalSettings | None = None
    serial: tuple[AnySerialPortSettings, ...] = ()
    lamps: AnyLampsSettings | None = None
    switches: AnySwitchesSettings | None = None
    indicators: IndicatorsSettings | None = None
    self_check: SelfCheckSettings = SelfCheckSettings()
    inclinometer: InclinometerSettings | None = None
    thermometers: tuple[HwmonThermometerSettings, ...] = ()
    maintenance: Maintenance = Maintenance()
    kept_frames: KeptFrames = KeptFrames()
    history: HistorySettings = HistorySettings()
    stage: GrblStageSettings | None = None
    scan: Scan = Scan()

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
