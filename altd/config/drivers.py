"""The table of drivers: a new one is named here, in the union of its kind, and nowhere else in altd."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from altd.config.fields import tables_at, tags_of
from altd.devices.aravis import AravisCameraSettings
from altd.devices.camera_lamps import CameraLampsSettings, CameraSwitchesSettings
from altd.devices.gpio import GpiodLampsSettings, GpiodSwitchesSettings, IndicatorsSettings
from altd.devices.grbl import GrblStageSettings
from altd.devices.hwmon import HwmonThermometerSettings
from altd.devices.inclinometer import InclinometerSettings
from altd.devices.playback import RecordingCameraSettings
from altd.devices.settings import CameraSettings, DeviceTable, LiveCameraSettings
from altd.devices.v4l2 import V4l2CameraSettings

AnyCameraSettings = Annotated[
    RecordingCameraSettings | V4l2CameraSettings | AravisCameraSettings, Field(discriminator="driver")
]
AnyLampsSettings = Annotated[GpiodLampsSettings | CameraLampsSettings, Field(discriminator="driver")]
AnySwitchesSettings = Annotated[GpiodSwitchesSettings | CameraSwitchesSettings, Field(discriminator="driver")]
AnyIndicatorsSettings = IndicatorsSettings
AnyInclinometerSettings = InclinometerSettings
AnyThermometerSettings = HwmonThermometerSettings
AnyStageSettings = GrblStageSettings

_KINDS = (
    *(AnyCameraSettings, AnyLampsSettings, AnySwitchesSettings, AnyIndicatorsSettings),
    *(AnyInclinometerSettings, AnyThermometerSettings, AnyStageSettings),
)
_TABLES = [table for kind in _KINDS for table in tables_at(kind, None) if issubclass(table, DeviceTable)]
DRIVERS = tuple(dict.fromkeys(table.about for table in _TABLES if table.about))
"""Drivers whose devices altd can list or check."""
_CAMERAS = [table for table in _TABLES if issubclass(table, CameraSettings)]
LIVE = frozenset(tag for c in _CAMERAS if issubclass(c, LiveCameraSettings) for tag in tags_of(c, "driver"))
"""Values of ``driver`` of live cameras."""
WITH_OUTPUTS = " or ".join(f'"{tag}"' for c in _CAMERAS if c.has_outputs for tag in tags_of(c, "driver"))
"""Those of cameras with outputs, for a message."""
