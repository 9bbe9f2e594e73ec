"""Reading ``altd.toml``: all of its faults at once, each with its place and its key."""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from altd.config.draft import draft_of, draft_without
from altd.config.drivers import LIVE
from altd.config.places import Place, Places
from altd.config.rules import RULES, Rule
from altd.config.whole import Config
from altd.config.wording import Fault, converted_values, faults_of
from altd.errors import BadInputError
from altd.files.documents import TomlError, parse_toml
from altd.files.reading import check_rights, read_file
from altd.files.table import Table
from altd.records import counted

_MAX_BYTES = 1 << 16
_MAX_FAULTS = 100


def load_config(path: Path) -> Config:
    """Read and check a config file; paths in it become relative to its folder.

    Raises BadInputError with the file and, for each fault, line, column and key.
    """
    return config_of(read_config(path), path)


AnyTable = TypeVar("AnyTable", bound=Table)


def load_tables(path: Path, kind: type[AnyTable]) -> AnyTable:
    """Read and check a TOML file other than ``altd.toml``, such as ``fleet.toml``.

    Raises BadInputError that names the file and, for each fault, line, column and key.
    """
    content = read_file(path, _MAX_BYTES)
    document = _parsed(content, path)
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        faults = faults_of(error, document, kind)
        meant = [keys for fault in faults for keys in fault.replaces]
        raise _refusal(path, (each for each in faults if each.keys not in meant), content) from error


def _parsed(content: bytes, path: Path) -> dict[str, Any]:
    try:
        return parse_toml(content)
    except TomlError as error:
        if error.keys:
            raise _refusal(path, [Fault(error.keys, str(error))], content) from error
        place = "" if error.line is None or error.column is None else f"{Place(error.line, error.column)}: "
        raise BadInputError(path, f"{place}{error}") from error


def read_config(path: Path) -> bytes:
    """Return the bytes of a config file; raises BadInputError with its name, also if others may write it."""
    check_rights(path)
    return read_file(path, _MAX_BYTES)


def config_of(content: bytes, path: Path, further: Sequence[Rule] = ()) -> Config:
    """Return the config of a file with this content and path; raises BadInputError as ``load_config``.

    ``further`` are rules beyond those of the settings alone.
    """
    document = _parsed(content, path)
    found = list(converted_values(document))
    document = _anchored(document, path.parent)
    _pair_live_cameras_by_time(document)
    config = None
    try:
        config = Config.model_validate(document)
    except ValidationError as error:
        known = {fault.keys for fault in found}
        found += [fault for fault in faults_of(error, document) if fault.keys not in known]
    meant = [keys for fault in found for keys in fault.replaces]
    found = [fault for fault in found if not any(fault.keys == keys for keys in meant)]
    faulty = [*(fault.keys for fault in found), *meant]
    draft = draft_without(document, faulty) if config is None else draft_of(config)
    unfit = itertools.chain.from_iterable(rule(draft) for rule in (*RULES, *further))
    found += [fault for fault in unfit if not fault.rests_on(faulty)]
    if found or config is None:
        raise _refusal(path, found, content)
    return config


def _refusal(path: Path, faults: Iterable[Fault], content: bytes) -> BadInputError:
    """Return the faults in the order of the file; those without a place first."""
    text = content.decode()
    places = Places(text, tomllib.loads(text))
    placed = [(fault.place(places), ".".join(map(str, fault.keys)), fault.text) for fault in faults]
    placed.sort(key=lambda fault: (0, 0) if fault[0] is None else (fault[0].line, fault[0].column))
    lines = [f"{f'{place}: ' if place else ''}{keys}: {said}" for place, keys, said in placed[:_MAX_FAULTS]]
    if len(placed) > _MAX_FAULTS:
        lines.append(f"and {counted(len(placed) - _MAX_FAULTS, 'fault')} more")
    return BadInputError(path, *lines)


def _anchored(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the document with its file paths relative to ``folder``; the models check the types."""
    document = copy.deepcopy(document)
    tables: list[tuple[Any, str]] = [
        (document.get("unit"), "calibration"),
        (document.get("chain"), "baseline"),
        (document.get("kept_frames"), "folder"),
        (document.get("history"), "file"),
        (document.get("inclinometer"), "level"),
    ]
    cameras = document.get("cameras")
    if isinstance(cameras, dict):
        tables += [(camera, "path") for camera in cameras.values()]
    for name in ("http", "mqtt", "modbus_tcp", "opcua"):
        keys = ("ca", "client_ca", "credentials", "certificate", "key")
        tables += [(document.get(name), key) for key in keys]
    for table, key in tables:
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(folder / table[key])
    return document


def _pair_live_cameras_by_time(document: dict[str, Any]) -> None:
    """Set the default of ``measuring.pair_by``, which depends on the cameras."""
    cameras, measuring = document.get("cameras"), document.setdefault("measuring", {})
    drivers = {
        camera.get("driver")
        for camera in (cameras.values() if isinstance(cameras, dict) else ())
        if isinstance(camera, dict)
    }
    if drivers & LIVE and isinstance(measuring, dict):
        measuring.setdefault("pair_by", "time")
