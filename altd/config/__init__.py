"""``altd.toml`` as pydantic models, the tables of one room in one file; reading it, wording its faults."""

from altd.config.cameras import (
    AravisCamera,
    CameraTable,
    ExposureControl,
    LiveCamera,
    RecordingCamera,
    V4l2Camera,
)
from altd.config.faces import Http, ModbusTcp, Rs485, SerialPort
from altd.config.lamps import CameraLamps, GpiodLamps, IndicatorLamps, LampsTable
from altd.config.loading import load_config
from altd.config.measuring import Measuring
from altd.config.stage import GrblStage, Scan
from altd.config.table import Table
from altd.config.unit import Installation, Target, Unit
from altd.config.whole import Config

__all__ = [
    "AravisCamera",
    "CameraLamps",
    "CameraTable",
    "Config",
    "ExposureControl",
    "GpiodLamps",
    "GrblStage",
    "Http",
    "IndicatorLamps",
    "Installation",
    "LampsTable",
    "LiveCamera",
    "Measuring",
    "ModbusTcp",
    "RecordingCamera",
    "Rs485",
    "Scan",
    "SerialPort",
    "Table",
    "Target",
    "Unit",
    "V4l2Camera",
    "load_config",
]
