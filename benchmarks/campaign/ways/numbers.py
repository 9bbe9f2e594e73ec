"""Ways with invalid numbers, in the config and in the calibration file, which must be refused."""

import hashlib
import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from altd.calibration.file import load_calibration, save_calibration
from altd.config import Installation, Measuring, load_config
from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from benchmarks.campaign.way import Draw, Registry
from benchmarks.unit_toml import unit_toml

WAYS = Registry("numbers")
_ABSURD = ("nan", "inf", "-inf", "1e200", "-1e200", "1e15", "-1e9", "1e308")
_CONFIG_KEYS = (
    *("measuring.max_skew_ms", "measuring.max_lag_ms", "measuring.max_sigma_mm"),
    *("measuring.max_sigma_mm_per_m", "measuring.silent_after_s", "measuring.stale_after_s"),
    *("installation.reference_plane_mm", "installation.offset_x_mm", "installation.offset_y_mm"),
    *("installation.offset_yaw_deg", "installation.offset_pitch_deg"),
)
_RECORDED = 'driver = "recording"\npath = "recording"'


@dataclass(frozen=True, slots=True)
class Misnumbered:
    """An absurd number at a key of the config; no key: at a place of the calibration drawn by ``seed``."""

    note: str
    key: str
    value: str
    seed: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether the number is NaN or infinite, so that every measurement with it is wrong."""
        return not math.isfinite(float(self.value))


def _number_in_config(draw: Draw) -> Misnumbered:
    key, value = draw.of(*_CONFIG_KEYS), draw.of(*_ABSURD)
    return Misnumbered(f"{key} = {value}", key, value)


def _number_in_calibration(draw: Draw) -> Misnumbered:
    value, seed = draw.of(*_ABSURD), draw.uniform(0, 1)
    return Misnumbered(f"{value} at {seed:.4f}", "", value, seed)


WAYS.row("number_in_config", "NaN, infinity or an absurd number in the config.", _number_in_config)
WAYS.row(
    "number_in_calibration",
    "The same in the calibration file, with a right checksum.",
    _number_in_calibration,
)


def accepted(
    way: Misnumbered, calibration: Calibration
) -> tuple[Calibration, Measuring, Installation] | None:
    """Calibration and settings from the files if these are accepted; None if refused, as required."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            if way.key:
                file = Path(folder) / "altd.toml"
                table, _, key = way.key.partition(".")
                config_text = unit_toml("X", "calibration.json", _RECORDED, _RECORDED)
                file.write_text(f"{config_text}\n[{table}]\n{key} = {way.value}\n")
                config = load_config(file)
                return calibration, config.measuring, config.installation
            file = Path(folder) / "calibration.json"
            save_calibration(calibration, file)
            _spoil(file, way)
            return load_calibration(file), Measuring(), Installation()
        except BadInputError:
            return None


def _spoil(file: Path, way: Misnumbered) -> None:
    """Write the number, with a checksum of the changed content."""
    document: dict[str, Any] = json.loads(file.read_text())
    document.pop("checksum")
    groups: dict[str, list[tuple[Any, Any]]] = {}
    for group, holder, key in _numbers(document, ""):
        groups.setdefault(group, []).append((holder, key))
    at = way.seed * len(groups)
    alike = list(groups.values())[int(at)]
    holder, key = alike[int((at - int(at)) * len(alike))]
    holder[key] = float(way.value)
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    document["checksum"] = "sha256:" + hashlib.sha256(text.encode()).hexdigest()
    file.write_text(json.dumps(document))


def _numbers(value: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    """Positions of a document's numbers, with their keys; the numbers of a list are one group."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        if isinstance(inner, float | int) and not isinstance(inner, bool):
            yield f"{path}.{key if isinstance(key, str) else ''}", value, key
        else:
            yield from _numbers(inner, f"{path}.{key}" if isinstance(key, str) else path)
