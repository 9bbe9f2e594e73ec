"""``altd.toml`` as pydantic models, related tables in one file; reading it and wording its faults.

The model of an interface's or a driver's settings is called ``…Settings``; a driver's is in its package.
"""

from altd.config.drivers import AnyCameraSettings, AnySwitchesSettings
from altd.config.interfaces import (
    ConsolePortSettings,
    HttpSettings,
    LocalSettings,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
    SerialPortSettings,
    TelegramPortSettings,
)
from altd.config.keeping import HistorySettings, KeptFrames
from altd.config.loading import load_config
from altd.config.measuring import Maintenance, Measuring, Scan, SelfCheckSettings
from altd.config.unit import Expansion, Installation, Machine, MachinePoint, RowSettings, Target, Unit
from altd.config.whole import Config
from altd.devices.aravis import AravisCameraSettings
from altd.devices.camera_lamps import CameraLampsSettings
from altd.devices.grbl import GrblStageSettings
from altd.devices.inclinometer import InclinometerSettings
from altd.devices.settings import READOUT_SHARE, ExposureSettings, LiveCameraSettings
from altd.files.table import Table

__all__ = [
    "READOUT_SHARE",
    "AnyCameraSettings",
    "AnySwitchesSettings",
    "AravisCameraSettings",
    "CameraLampsSettings",
    "Config",
    "ConsolePortSettings",
    "Expansion",
    "ExposureSettings",
    "GrblStageSettings",
    "HistorySettings",
    "HttpSettings",
    "InclinometerSettings",
    "Installation",
    "KeptFrames",
    "LiveCameraSettings",
    "LocalSettings",
    "Machine",
    "MachinePoint",
    "Maintenance",
    "Measuring",
    "ModbusRtuPortSettings",
    "ModbusTcpSettings",
    "MqttSettings",
    "OpcUaSettings",
    "RowSettings",
    "Scan",
    "SelfCheckSettings",
    "SerialPortSettings",
    "Table",
    "Target",
    "TelegramPortSettings",
    "Unit",
    "load_config",
]
