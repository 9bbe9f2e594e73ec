"""A partly valid config: the parts of it that can still be checked."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import TypeAdapter, ValidationError

from altd.config import drivers
from altd.config.interfaces import (
    AnySerialPortSettings,
    HttpSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
)
from altd.config.keeping import HistorySettings
from altd.config.measuring import Measuring
from altd.config.places import Keys
from altd.config.unit import Installation, Machine, Plate, RowSettings, Target, Unit
from altd.config.whole import Config
from altd.devices.settings import LiveCameraSettings

_TABLES = (
    *("unit", "chain", "plate", "measuring", "installation", "machine", "modbus_tcp", "http", "mqtt"),
    *("opcua", "lamps", "switches", "indicators", "inclinometer", "stage", "history"),
)


@dataclass(frozen=True, slots=True)
class Draft:
    """Tables of a config that rules check. None: missing, or faulty."""

    unit: Unit | None
    chain: RowSettings | None
    plate: Plate | None
    targets: tuple[Target | None, ...]
    cameras: Mapping[str, drivers.AnyCameraSettings | None]
    measuring: Measuring | None
    installation: Installation | None
    machine: Machine | None
    modbus_tcp: ModbusTcpSettings | None
    http: HttpSettings | None
    mqtt: MqttSettings | None
    opcua: OpcUaSettings | None
    serial: tuple[AnySerialPortSettings | None, ...]
    lamps: drivers.AnyLampsSettings | None
    switches: drivers.AnySwitchesSettings | None
    indicators: drivers.AnyIndicatorsSettings | None
    inclinometer: drivers.AnyInclinometerSettings | None
    thermometers: tuple[drivers.AnyThermometerSettings | None, ...]
    stage: drivers.AnyStageSettings | None
    history: HistorySettings | None

    @property
    def is_planar(self) -> bool:
        """Whether the unit has one camera with a plate, and no targets."""
        return self.unit is not None and self.unit.instrument == "planar"

    @property
    def is_row(self) -> bool:
        """Whether the unit is a row of switched targets."""
        return self.unit is not None and self.unit.instrument == "chain"

    @property
    def switched(self) -> tuple[Target, ...]:
        """Valid targets with a switched glass."""
        return tuple(target for target in self.targets if target and (target.switched or self.is_row))

    def live(self) -> dict[str, LiveCameraSettings]:
        """Return the live cameras that are opened, by name."""
        named = {target.camera for target in self.targets if target is not None}
        named |= set(self.cameras) if self.is_planar else set()
        cameras = self.cameras.items()
        return {
            name: camera
            for name, camera in cameras
            if isinstance(camera, LiveCameraSettings) and name in named
        }


def draft_of(config: Config) -> Draft:
    """Return the draft of a config that its models accept."""
    return Draft(**{name: getattr(config, name) for name in Draft.__dataclass_fields__})


def draft_without(document: dict[str, Any], faulty: Iterable[Keys]) -> Draft:
    """Return the draft of a document without its faulty keys."""
    document = copy.deepcopy(document)
    for keys in sorted(faulty, key=len, reverse=True):
        _remove(document, keys)

    def table(name: str) -> Any:
        field = Config.model_fields[name]
        default = None if field.is_required() else field.default
        return _validated(field.annotation, document[name], default) if name in document else default

    def rows(name: str) -> tuple[Any, ...]:
        kind, listed = get_args(Config.model_fields[name].annotation)[0], document.get(name)
        return tuple(_validated(kind, row) for row in listed) if isinstance(listed, list) else ()

    cameras = document.get("cameras")
    named = cameras.items() if isinstance(cameras, dict) else ()
    return Draft(
        targets=rows("targets"),
        cameras={name: _validated(drivers.AnyCameraSettings, camera) for name, camera in named},
        serial=rows("serial"),
        thermometers=rows("thermometers"),
        **{name: table(name) for name in _TABLES},
    )


_adapter = functools.cache(TypeAdapter[Any])
"""Type adapters are cached: creating one takes ten times as long as using it."""


def _validated(kind: Any, value: Any, otherwise: Any = None) -> Any:
    try:
        return _adapter(kind).validate_python(value)
    except ValidationError:
        return otherwise


def _remove(document: Any, keys: Keys) -> None:
    """Remove a key; a list element becomes None, so that the elements after it keep their numbers."""
    *above, last = keys or (None,)
    for key in above:
        try:
            document = document[key]
        except (KeyError, IndexError, TypeError):
            return
    if isinstance(document, dict):
        document.pop(last, None)
    elif isinstance(document, list) and isinstance(last, int) and last < len(document):
        document[last] = None
