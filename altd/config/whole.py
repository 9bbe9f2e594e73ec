"""The whole of ``altd.toml``, and what must fit between its tables."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from altd.config.cameras import AravisCamera, CameraTable, LiveCamera
from altd.config.faces import Http, ModbusTcp, SerialPort
from altd.config.lamps import CameraLamps, GpiodLamps, IndicatorLamps, LampsTable
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

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        for what, names in (
            ("name", [target.name for target in self.targets]),
            ("camera", [target.camera for target in self.targets]),
            ("z_mm", [target.z_mm for target in self.targets]),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"targets: two targets have the same {what}")
        missing = [target.camera for target in self.targets if target.camera not in self.cameras]
        if self.cameras and missing:
            raise ValueError(f"targets: no [cameras.{missing[0]}] for camera {missing[0]!r}")
        live = any(isinstance(camera, LiveCamera) for camera in self.cameras.values())
        if live and self.measuring.pair_by == "sequence":
            raise ValueError('measuring.pair_by: must be "time", for cameras count each from its own start')
        devices = [port.device for port in self.serial]
        if len(set(devices)) < len(devices):
            raise ValueError("serial: two ports have the same device")
        if self.stage is not None and self.stage.device in devices:
            raise ValueError("stage: a [[serial]] port has the same device")
        self._lamps_fit()
        return self

    def _lamps_fit(self) -> None:
        if isinstance(self.lamps, CameraLamps):
            for name in self.lamps.cameras:
                if not isinstance(self.cameras.get(name), AravisCamera):
                    raise ValueError(f'lamps: camera {name!r} is no camera with driver "aravis"')
                if name not in [target.camera for target in self.targets]:
                    raise ValueError(f"lamps: camera {name!r} looks at no target and is not opened")
        named: list[tuple[str, str]] = []
        if isinstance(self.lamps, GpiodLamps):
            named += [(self.lamps.chip, line) for line in self.lamps.lines]
        if self.indicators is not None:
            named += [(self.indicators.chip, line) for line in self.indicators.lines.values()]
        if len(set(named)) < len(named):
            raise ValueError("lamps, indicators: two lamps are on the same line")
