"""Reading ``altd.toml``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from altd.config.whole import Config
from altd.config.wording import first_fault
from altd.errors import BadInputError
from altd.files.documents import parse_toml
from altd.files.reading import read_file

_LARGEST_BYTES = 1 << 16


def load_config(path: Path) -> Config:
    """Read and check a config file; paths in it become relative to its folder.

    Raises BadInputError that names the file and the key.
    """
    content = read_file(path, _LARGEST_BYTES)
    try:
        document = _anchored(parse_toml(content), path.parent)
    except ValueError as error:
        raise BadInputError(path, str(error)) from error
    try:
        return Config.model_validate(document)
    except ValidationError as error:
        raise BadInputError(path, first_fault(error, document)) from error


def _anchored(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document with the paths of its files relative to ``folder``; wrong types are left to the models."""
    tables: list[tuple[Any, str]] = [(document.get("unit"), "calibration")]
    cameras = document.get("cameras")
    if isinstance(cameras, dict):
        tables += [(camera, "path") for camera in cameras.values()]
    for table, key in tables:
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(folder / table[key])
    return document
