"""``altd.toml`` as pydantic models, related tables in one file; reading it and wording its faults.

The model of a driver's or interface's settings is called ``…Settings``; the driver or interface has the name
without it.
"""

from altd.config.cameras import (
    AnyCameraSettings,
    AravisCameraSettings,
    ExposureSettings,
    LiveCameraSettings,
    RecordingCameraSettings,
    V4l2CameraSettings,
    software_triggered,
)
from altd.config.devices import (
    AnyLampsSettings,
    AnySwitchesSettings,
    CameraLampsSettings,
    CameraSwitchesSettings,
    GpiodLampsSettings,
    GpiodSwitchesSettings,
    GrblStageSettings,
    InclinometerSettings,
    IndicatorsSettings,
    Scan,
    ScanLimits,
)
from altd.config.interfaces import (
    AnySerialPortSettings,
    ConsolePortSettings,
    HttpSettings,
    LocalSettings,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
    Rs485Settings,
    SerialPortSettings,
    SparkplugSettings,
    TelegramPortSettings,
)
from altd.config.keeping import HistorySettings, KeptFrames
from altd.config.loading import load_config
from altd.config.measuring import HwmonThermometerSettings, Maintenance, Measuring, SelfCheckSettings
from altd.config.table import Table
from altd.config.unit import Installation, Plate, RowSettings, Target, Unit
from altd.config.whole import Config

__all__ = [
    "AnyCameraSettings",
    "AnyLampsSettings",
    "AnySerialPortSettings",
    "AnySwitchesSettings",
    "AravisCameraSettings",
    "CameraLampsSettings",
    "CameraSwitchesSettings",
    "Config",
    "ConsolePortSettings",
    "ExposureSettings",
    "GpiodLampsSettings",
    "GpiodSwitchesSettings",
    "GrblStageSettings",
    "HistorySettings",
    "HttpSettings",
    "HwmonThermometerSettings",
    "InclinometerSettings",
    "IndicatorsSettings",
    "Installation",
    "KeptFrames",
    "LiveCameraSettings",
    "LocalSettings",
    "Maintenance",
    "Measuring",
    "ModbusRtuPortSettings",
    "ModbusTcpSettings",
    "MqttSettings",
    "OpcUaSettings",
    "Plate",
    "RecordingCameraSettings",
    "RowSettings",
    "Rs485Settings",
    "Scan",
    "ScanLimits",
    "SelfCheckSettings",
    "SerialPortSettings",
    "SparkplugSettings",
    "Table",
    "Target",
    "TelegramPortSettings",
    "Unit",
    "V4l2CameraSettings",
    "load_config",
    "software_triggered",
]
