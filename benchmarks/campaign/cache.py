"""Calibrations of the campaign's units, kept outside the tree; made again when their code changes."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from benchmarks.campaign.units import RECORDED, SIMULATED, UnitSpec
from hw_sim.flat import record_flat
from hw_sim.scan import STAGE_STREAM, record_scan
from hw_sim.stage import Stage
from hw_sim.unit import CAMERAS, Unit

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT.parent / "shared/data" / RECORDED

_EXPOSURES_A_NODE = 2
_FLAT_EXPOSURES = 10
_CALIBRATES = ("vision", "mapping", "measuring", "calibration", "recording", "records")


def folder() -> Path:
    """Where scans and calibrations are kept."""
    base = os.environ.get("ALTD_CAMPAIGN_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return Path(base or Path.home() / ".cache") / "altd-campaign"


def calibrated(name: str) -> Calibration:
    """The calibration of a unit; made, and kept, when there is none of this code."""
    scan, flat = _scan_of(name)
    kept_name = name if name == RECORDED else scan.parent.name
    file = folder() / f"{kept_name}-{_CODE}.json"
    if not file.exists():
        _say(f"calibrating {name}")
        file.parent.mkdir(parents=True, exist_ok=True)
        result = calibrate([open_recording(scan)], None if flat is None else open_recording(flat))
        save_calibration(result.calibration, file)
    return load_calibration(file)


def _scan_of(name: str) -> tuple[Path, Path | None]:
    """The folders of a unit's scan and of its flat, recorded when they are not there."""
    if name == RECORDED:
        return RECORDINGS / "scan", None
    spec = SIMULATED[name]
    kept = folder() / f"{name}-{_hash_of([ROOT / 'hw_sim', Path(__file__).with_name('units.py')])}"
    if not kept.exists():
        _say(f"recording {name}")
        draft = kept.with_name(f".{kept.name}.{os.getpid()}")
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        _record(spec, draft)
        if kept.exists():  # another process was faster
            shutil.rmtree(draft)
        else:
            draft.rename(kept)
    return kept / "scan", kept / "flat" if spec.flat else None


def _record(spec: UnitSpec, place: Path) -> None:
    unit = Unit(spec.config)
    for camera in CAMERAS:
        unit.set_camera(camera, exposure_ms=spec.exposure_ms)
    stage = Stage(np.random.default_rng([spec.config.seed, STAGE_STREAM]))
    record_scan(place / "scan", unit, stage, _EXPOSURES_A_NODE, lambda done, planned: None)
    if spec.flat:
        for camera in CAMERAS:
            unit.set_camera(camera, exposure_ms=1.6)
        record_flat(place / "flat", unit, _FLAT_EXPOSURES, lambda done, planned: None)


def _hash_of(paths: Iterable[Path]) -> str:
    """Of the content of Python files and folders of them."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted(path.glob("**/*.py")) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


_CODE = _hash_of(ROOT / "altd" / part for part in _CALIBRATES)
"""Of the code as it was when this process read it."""


def _say(what: str) -> None:
    print(what, file=sys.stderr, flush=True)
