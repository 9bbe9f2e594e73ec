"""``docs/config.md`` from the models: ``python -m tools.pages.config``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic.fields import FieldInfo

from altd.config import (
    AravisCameraSettings,
    CameraLampsSettings,
    Config,
    ConsolePortSettings,
    ExposureSettings,
    GpiodLampsSettings,
    GrblStageSettings,
    HistorySettings,
    HttpSettings,
    HwmonThermometerSettings,
    InclinometerSettings,
    IndicatorsSettings,
    Installation,
    KeptFrames,
    LocalSettings,
    Maintenance,
    Measuring,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
    RecordingCameraSettings,
    Rs485Settings,
    Scan,
    SelfCheckSettings,
    SparkplugSettings,
    Table,
    Target,
    TelegramPortSettings,
    Unit,
    V4l2CameraSettings,
)
from altd.config.fields import expected
from altd.config.loading import config_of
from altd.errors import BadInputError
from tools.markdown import wrapped

TABLES: tuple[tuple[str, type[Table], str], ...] = (
    ("[unit]", Unit, "Required."),
    ("[[targets]]", Target, "Required, at least two, in beam order."),
    ('[cameras.NAME], driver = "v4l2"', V4l2CameraSettings, "One table for each target's `camera`."),
    (
        '[cameras.NAME], driver = "aravis"',
        AravisCameraSettings,
        "Needs the Debian packages that `cameras.md` names.",
    ),
    ('[cameras.NAME], driver = "recording"', RecordingCameraSettings, "Made by `altd record`."),
    (
        "[cameras.NAME.exposure]",
        ExposureSettings,
        "For the drivers `v4l2` and `aravis`. All keys have defaults.",
    ),
    ("[measuring]", Measuring, "All keys have defaults."),
    ("[installation]", Installation, "All keys have defaults: the beam in the unit frame."),
    (
        "[modbus_tcp]",
        ModbusTcpSettings,
        "Leave the table out and the interface is off. Registers: `modbus.md`.",
    ),
    ("[http]", HttpSettings, "Leave the table out and the interface is off. Routes: `http.md`."),
    ("[mqtt]", MqttSettings, "Leave the table out and the interface is off. Topics: `mqtt.md`."),
    ("[opcua]", OpcUaSettings, "Leave the table out and the interface is off. Nodes: `opcua.md`."),
    (
        "[mqtt.sparkplug]",
        SparkplugSettings,
        "Leave the table out and the unit publishes in JSON. Metrics: `sparkplug.md`.",
    ),
    (
        "[local]",
        LocalSettings,
        "Without the table it is `altd.sock` in the folder that systemd makes for the service "
        "(`RuntimeDirectory`), and there is none for a daemon that is started by hand: `console.md`.",
    ),
    ('[[serial]], speaks = "telegram"', TelegramPortSettings, "One table a port. Sentences: `telegram.md`."),
    ('[[serial]], speaks = "console"', ConsolePortSettings, "What can be typed: `console.md`."),
    ('[[serial]], speaks = "modbus_rtu"', ModbusRtuPortSettings, "Registers: `modbus.md`."),
    (
        "[serial.rs485]",
        Rs485Settings,
        "Stands below the `[[serial]]` that it belongs to. All keys have defaults.",
    ),
    ('[lamps], driver = "gpiod"', GpiodLampsSettings, "Leave the table out and there are no frame LEDs."),
    ('[lamps], driver = "camera"', CameraLampsSettings, "Instead of the table above."),
    ("[indicators]", IndicatorsSettings, "Leave the table out and there are none."),
    (
        "[self_check]",
        SelfCheckSettings,
        "All keys have defaults; without `[lamps]`, or with a calibration that has no LED references, "
        "nothing is checked: `selfcheck.md`.",
    ),
    (
        "[inclinometer]",
        InclinometerSettings,
        "Leave the table out and roll is *not available*. Wiring, and what is shown when it fails: "
        "`inclinometer.md`.",
    ),
    (
        '[[thermometers]], driver = "hwmon"',
        HwmonThermometerSettings,
        "One table a temperature: `reasons.md`.",
    ),
    ("[maintenance]", Maintenance, "All keys have defaults. What they lead to: `reasons.md`."),
    ("[kept_frames]", KeptFrames, "All keys have defaults. What is done with them: `history.md`."),
    ("[history]", HistorySettings, "All keys have defaults. What is kept, and for how long: `history.md`."),
    ("[stage]", GrblStageSettings, "Needed by `altd scan` alone: `calibration.md`."),
    ("[scan]", Scan, "All keys have defaults."),
)

_TAGS = ("driver", "speaks")
"""The keys that say which table it is: they come first."""

_SPOILT = """\
[unit]
serial = "ALT-0001"
calibration = "calibration.json"

[[targets]]
name = "front"
z_mm = 0.0
camera = "front"

[[targets]]
name = "rear"
z_mm = -280.0
camera = "raer"

[cameras.front]
driver = "v4l2"
device = "/dev/video0"

[cameras.rear]
driver = "v4l2"
device = "/dev/video1"

[measuring]
windw = 20
pair_by = "time"
"""


def _complaints() -> tuple[str, ...]:
    try:
        config_of(_SPOILT.encode(), Path("altd.toml"))
    except BadInputError as error:
        return error.lines
    return ()


def page() -> str:
    """The page in Markdown."""
    covered = {model for _, model, _ in TABLES}
    missing = {m for f in Config.model_fields.values() for m in _models(f.annotation)} - covered
    assert not missing, f"no section of this page for {missing}"  # noqa: S101
    return wrapped("\n".join(_lines()) + "\n")


def _lines() -> Iterator[str]:
    yield "# Settings"
    yield ""
    yield "<!-- Generated by `python -m tools.pages.config`; do not edit. -->"
    yield ""
    yield "What `altd.toml` may hold. `config/altd.toml` is a commented example. `altd check-config FILE`"
    yield "says all that is wrong with a file, a line each. Of"
    yield ""
    yield from (f"    {line}".rstrip() for line in _SPOILT.splitlines())
    yield ""
    yield "it says"
    yield ""
    yield from (f"    {line}" for line in _complaints())
    yield ""
    yield "`altd run` refuses the same: keys that nobody knows, and what can come to nothing on any"
    yield "computer, such as two interfaces on one port, a telegram that its line cannot take, one camera or"
    yield "GPIO line twice, a camera that no target has, live cameras of different rates. What depends on"
    yield "the computer, `altd doctor` says ([doctor](doctor.md)). Paths in `[unit]`, `[cameras.…]`,"
    yield "`[http]`, `[mqtt]` and `[opcua]` are relative to the file; a calibration or a recording that is"
    yield "not there yet is named and is no fault of the config, one that is there and does not fit is."
    yield "Exit status: 0 the file is"
    yield "good, 2 it is not."
    for heading, model, note in TABLES:
        yield ""
        yield f"## {heading}"
        yield ""
        yield " ".join(f"{model.__doc__ or ''} {note}".replace("``", "`").split())
        yield ""
        yield "| key | value | default | what it is |"
        yield "|---|---|---|---|"
        for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in _TAGS):
            meaning = " ".join((field.description or "").replace("``", "`").split())
            yield f"| `{name}` | {_value(field)} | {_default(field)} | {meaning} |"


def _models(annotation: Any) -> Iterator[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    if isinstance(field.default, Table):
        return "its defaults"
    if field.default is None:
        return "none"
    return f"`{str(field.default).lower()}`" if isinstance(field.default, bool) else f"`{field.default}`"


def _value(field: FieldInfo) -> str:
    """The type in TOML's words, with its limits."""
    return expected(field.annotation, field.metadata, lambda value: f"`{value}`")


if __name__ == "__main__":
    print(page(), end="")
