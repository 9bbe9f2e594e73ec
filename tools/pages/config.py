"""``docs/config.md`` from the models."""

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

from pydantic.fields import FieldInfo

from altd.config import (
    Config,
    ConsolePortSettings,
    Expansion,
    HistorySettings,
    HttpSettings,
    Installation,
    KeptFrames,
    LocalSettings,
    Machine,
    MachinePoint,
    Maintenance,
    Measuring,
    ModbusRtuPortSettings,
    ModbusTcpSettings,
    MqttSettings,
    OpcUaSettings,
    RowSettings,
    Scan,
    SelfCheckSettings,
    Table,
    Target,
    TelegramPortSettings,
    Unit,
    drivers,
)
from altd.config.fields import expected, tables_at, tags_of
from altd.config.interfaces import Rs485Settings, SerialPortSettings, SparkplugSettings
from altd.config.loading import config_of
from altd.config.measuring import ScanLimits
from altd.config.unit import Plate
from altd.devices.inclinometer import RegisterSettings, SensorSettings
from altd.devices.settings import ExposureSettings, LiveCameraSettings
from altd.errors import BadInputError
from altd.fleet.settings import DatabaseSettings, FleetBrokerSettings, RetentionSettings
from tools.markdown import wrapped


def _drivers(heading: str, kind: Any) -> list[tuple[str, type[Table], str]]:
    """Return a row for each driver of a kind of device, live cameras first."""
    tables = sorted(tables_at(kind, None), key=lambda table: "path" in table.model_fields)
    return [(f'{heading}, driver = "{tags_of(table, "driver")[0]}"', table, "") for table in tables]


TABLES: tuple[tuple[str, type[Table], str], ...] = (
    ("[unit]", Unit, "Required."),
    ("[[targets]]", Target, "At least two."),
    (
        "[cameras.NAME]",
        LiveCameraSettings,
        "One table for each target's `camera`.",
    ),
    *_drivers("[cameras.NAME]", drivers.AnyCameraSettings),
    (
        "[cameras.NAME.exposure]",
        ExposureSettings,
        "For the drivers `v4l2` and `aravis`.",
    ),
    ("[measuring]", Measuring, ""),
    ("[installation]", Installation, "Default: the beam in the unit frame."),
    ("[installation.expansion]", Expansion, ""),
    ("[machine]", Machine, "Without the table: no points."),
    ("[[machine.points]]", MachinePoint, "Up to eight points."),
    ("[chain]", RowSettings, 'With `instrument = "chain"` alone: `chain.md`.'),
    ("[plate]", Plate, 'With `instrument = "planar"` alone: `planar.md`.'),
    (
        "[modbus_tcp]",
        ModbusTcpSettings,
        "Without the table: off. Registers: `modbus.md`.",
    ),
    ("[http]", HttpSettings, "Without the table: off. Routes: `http.md`."),
    ("[mqtt]", MqttSettings, "Without the table: off. Topics: `mqtt.md`."),
    ("[opcua]", OpcUaSettings, "Without the table: off. Nodes: `opcua.md`."),
    (
        "[mqtt.sparkplug]",
        SparkplugSettings,
        "Metrics: `sparkplug.md`.",
    ),
    (
        "[local]",
        LocalSettings,
        "Without the table it is `altd.sock` in the folder that systemd makes for the service "
        "(`RuntimeDirectory`), and there is none for a daemon that is started by hand: `console.md`.",
    ),
    (
        "[[serial]]",
        SerialPortSettings,
        "One table for each port.",
    ),
    ('[[serial]], speaks = "telegram"', TelegramPortSettings, "Sentences: `telegram.md`."),
    ('[[serial]], speaks = "console"', ConsolePortSettings, "Its commands: `console.md`."),
    ('[[serial]], speaks = "modbus_rtu"', ModbusRtuPortSettings, "Registers: `modbus.md`."),
    (
        "[serial.rs485]",
        Rs485Settings,
        "It follows the `[[serial]]` that it belongs to.",
    ),
    *_drivers("[lamps]", drivers.AnyLampsSettings),
    *_drivers("[switches]", drivers.AnySwitchesSettings),
    ("[indicators]", drivers.AnyIndicatorsSettings, ""),
    (
        "[self_check]",
        SelfCheckSettings,
        "Without `[lamps]`, or with a calibration that has no LED references, "
        "nothing is checked: `selfcheck.md`.",
    ),
    ("[inclinometer]", drivers.AnyInclinometerSettings, ""),
    ("[inclinometer.sensor]", SensorSettings, ""),
    ("[[inclinometer.sensor.registers]]", RegisterSettings, ""),
    *_drivers("[[thermometers]]", drivers.AnyThermometerSettings),
    ("[maintenance]", Maintenance, "The reasons they lead to: `reasons.md`."),
    ("[kept_frames]", KeptFrames, "How to list and replay them: `history.md`."),
    ("[history]", HistorySettings, "Contents and retention: `history.md`."),
    ("[stage]", drivers.AnyStageSettings, ""),
    ("[scan]", Scan, ""),
    ("[scan.limits]", ScanLimits, "Terms of the uncertainty budget: `budget.md`."),
    ("[broker] of fleet.toml", FleetBrokerSettings, "File of `altd ingest` and `altd fleet`: `fleet.md`."),
    ("[database] of fleet.toml", DatabaseSettings, ""),
    ("[retention] of fleet.toml", RetentionSettings, ""),
)

_COMMON = (LiveCameraSettings, SerialPortSettings)
"""Models whose keys are listed once, not again below the models that inherit them."""

_TAGS = ("driver", "speaks")
"""Keys that select the kind of a table; they are listed first."""

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
    """Page in Markdown."""
    covered = {model for _, model, _ in TABLES}
    missing = {m for f in Config.model_fields.values() for m in _models(f.annotation)} - covered
    assert not missing, f"no section of this page for {missing}"  # noqa: S101
    return wrapped("\n".join(_lines()) + "\n")


def _lines() -> Iterator[str]:
    yield "# Settings"
    yield ""
    yield "<!-- Generated by `make pages`; do not edit. -->"
    yield ""
    yield "This page lists every key of the configuration file `altd.toml`, and at its end of `fleet.toml`."
    yield ""
    yield "[config/live.toml](../config/live.toml) is for a live unit. `altd check-config FILE` prints a"
    yield "line for each fault, with its place and what is possible, and exits with 0 (no fault) or 2:"
    yield ""
    yield from (f"    {line}" for line in _complaints()[1:2])
    yield ""
    yield "`altd run` refuses the same files. A running unit [reloads](maintain.md#reload-the-settings) the"
    yield "tables of its interfaces; changes of other tables need a restart. Faults that depend on the"
    yield "computer are found by [altd doctor](doctor.md). A calibration or recording that does not exist yet"
    yield "is reported, and is no fault."
    yield ""
    yield "Values: *a*…*b* is a range with its ends, `>` and `<` exclude an end. A *name* has 1 to 32 small"
    yield "letters, digits and _, a letter first. A *path* in `[unit]`, `[cameras.…]`, `[http]`, `[mqtt]` and"
    yield "`[opcua]` may be relative to the file. A table without required keys may be left out: its keys"
    yield "then have their defaults, unless noted."
    for heading, model, note in TABLES:
        yield ""
        yield f"## {heading}"
        yield ""
        yield _linked(f"{model.__doc__ or ''} {note}")
        if rows := list(_rows(model)):
            yield from ("", "| key | value | default | meaning |", "|---|---|---|---|", *rows)


def _rows(model: type[Table]) -> Iterator[str]:
    """Yield a row for each key not listed above; keys without text join a row of equal values."""
    inherited = {name for base in _COMMON if base in model.__mro__[1:] for name in base.model_fields}
    own = {name for name in model.model_fields if name in model.__annotations__ or name not in inherited}
    groups: list[tuple[list[str], str, str, str]] = []
    for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in _TAGS):
        meaning = _meanings(model).get(name, "")
        if name not in own or (name in _TAGS and not meaning) or field.annotation == Path | str:
            continue
        about = _value(field), _default(field), _linked(meaning)
        if groups and not about[2] and about[:2] == groups[-1][1:3]:
            groups[-1][0].append(name)
        else:
            groups.append(([name], *about))
    for names, value, default, meaning in groups:
        yield f"| {', '.join(f'`{name}`' for name in names)} | {value} | {default} | {meaning} |"


@cache
def _meanings(model: type[Table]) -> dict[str, str]:
    """Docstrings of a model's keys; reading them through pydantic would cost 0.1 s at each start of altd."""
    found = {}
    for base in reversed(model.__mro__[: model.__mro__.index(Table)]):
        (of_class,) = ast.parse(inspect.getsource(base)).body
        assert isinstance(of_class, ast.ClassDef)  # noqa: S101
        for key, text in pairwise(of_class.body):
            match key, text:
                case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(meaning))):
                    found[name] = inspect.cleandoc(meaning)
    return found


def _linked(text: str) -> str:
    """Docstring as Markdown; the pages it names become links."""
    text = " ".join(text.replace("``", "`").split())
    return re.sub(r"`([a-z-]+)\.md`", r"[\1](\1.md)", text)


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
    """Type and limits of a key, in TOML terms."""
    text = expected(field.annotation, field.metadata, lambda value: f"`{value}`")
    text = text.replace("text of small letters, digits and _, a letter first, 1 to 32 characters", "*name*")
    text = re.sub(r"number from (\S+) to below (\S+)", r"number \1…<\2", text)
    text = re.sub(
        r"number (from|above) (\S+) to (\S+)", lambda m: f"number {'>' * (m[1] != 'from')}{m[2]}…{m[3]}", text
    )
    text = re.sub(r", (\d+) to (\d+) characters", r", \1…\2 characters", text)
    return (
        text.replace("whole number", "integer").replace("` or `", "`, `").replace("true or false", "boolean")
    )
