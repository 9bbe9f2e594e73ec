"""Units of the campaign: the conditions under which each measures, and its calibration.

Scans and calibrations are stored outside the tree, and made again when their code changes.
"""

import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.config import Installation, Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.recording.reader import open_recording
from hw_sim.beam import Laser
from hw_sim.flat import record_flat
from hw_sim.motion import Vibration
from hw_sim.scan import STAGE_STREAM, record_scan
from hw_sim.stage import Stage
from hw_sim.unit import CAMERAS, EXPOSURES_MS, Unit, UnitConfig

RECORDED = "unit-a"
"""Recorded unit of ../shared/data; all others are simulated."""

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT.parent / "shared/data" / RECORDED

_EXPOSURES_A_NODE = 2
_FLAT_EXPOSURES = 10
_CALIBRATES = ("vision", "mapping", "measuring", "calibration", "recording", "records")
_REFERENCE = Laser()


@dataclass(frozen=True, slots=True)
class UnitSpec:
    """A simulated unit, and the differences between its measuring and its calibration.

    ``flat``: calibrated with a recorded flat. ``light`` is the laser's power while measuring, relative to the
    calibration; ``lux_of`` is the ambient light at ``t_s`` of an episode, if it changes.
    """

    name: str
    config: UnitConfig
    flat: bool = False
    light: float = 1.0
    lux: float = 200.0
    lux_of: Callable[[float], float] | None = None
    vibration: Vibration | None = None
    drives: bool = False
    dust: float = 0.0

    @property
    def exposure_ms(self) -> float:
        """Exposure time that brings the laser's spot to three quarters of full scale."""
        return EXPOSURES_MS["front"] * _REFERENCE.peak_mw_per_mm2 / self.config.laser.peak_mw_per_mm2

    @property
    def measuring(self) -> UnitConfig:
        """Configuration of the unit while it measures."""
        laser = replace(self.config.laser, power_mw=self.config.laser.power_mw * self.light)
        return replace(self.config, laser=laser, lux=self.lux, vibration=self.vibration, dust=self.dust)


def _switched(t_s: float) -> float:
    """Ambient light that is switched from 0 to 1000 lx."""
    return 0.0 if t_s < 0.25 else 1000.0


SIMULATED: dict[str, UnitSpec] = {
    spec.name: spec
    for spec in (
        UnitSpec("plain", UnitConfig(seed=1)),
        UnitSpec("flat", UnitConfig(seed=2), flat=True),
        UnitSpec("round-6", UnitConfig(seed=3, laser=Laser(1.0, (6.0, 6.0)))),
        UnitSpec("super-15", UnitConfig(seed=4, laser=Laser(3.0, (15.0, 15.0), order=2.0)), flat=True),
        UnitSpec(
            "ellipse", UnitConfig(seed=5, laser=Laser(3.0, (14.0, 7.0), angle_rad=0.9), speckle_contrast=0.2)
        ),
        UnitSpec("bits-12", UnitConfig(seed=6, bits=12, speckle_contrast=0.12), flat=True),
        UnitSpec("dim", UnitConfig(seed=7), light=0.25, lux=600.0),
        UnitSpec("bright", UnitConfig(seed=8, laser=Laser(3.0, (9.0, 8.0), order=1.5)), light=1.5, lux=0.0),
        UnitSpec("shaking", UnitConfig(seed=9), vibration=Vibration()),
        UnitSpec(
            "driving", UnitConfig(seed=10), vibration=Vibration(rms_mm=0.02, rms_mrad=0.05), drives=True
        ),
        UnitSpec("dusty", UnitConfig(seed=11), dust=0.5),
        UnitSpec("lights", UnitConfig(seed=12, hot_pixels=200), lux_of=_switched, flat=True),
    )
}

NAMES = (*SIMULATED, RECORDED)


def cache_folder() -> Path:
    """Folder of scans and calibrations."""
    base = os.environ.get("ALTD_CAMPAIGN_CACHE") or os.environ.get("XDG_CACHE_HOME")
    return Path(base or Path.home() / ".cache") / "altd-campaign"


def calibrated(name: str) -> Calibration:
    """Calibration of a unit; made and stored if there is none of this code."""
    scan, flat = _scan_of(name)
    kept_name = name if name == RECORDED else scan.parent.name
    file = cache_folder() / f"{kept_name}-{_CODE}.json"
    if not file.exists():
        _say(f"calibrating {name}")
        file.parent.mkdir(parents=True, exist_ok=True)
        result = calibrate([open_recording(scan)], None if flat is None else open_recording(flat))
        save_calibration(result.calibration, file)
    return load_calibration(file)


def _scan_of(name: str) -> tuple[Path, Path | None]:
    """Folders of a unit's scan and of its flat, recorded if missing."""
    if name == RECORDED:
        return RECORDINGS / "scan", None
    spec = SIMULATED[name]
    kept = cache_folder() / f"{name}-{hash_of([ROOT / 'hw_sim', Path(__file__).with_name('units.py')])}"
    if not kept.exists():
        _say(f"recording {name}")
        draft = kept.with_name(f".{kept.name}.{os.getpid()}")
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        _record(spec, draft)
        if kept.exists():  # another process has recorded it meanwhile
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


def hash_of(paths: Iterable[Path]) -> str:
    """Hash of the content of Python files, and of those in folders."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted(path.glob("**/*.py")) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


_CODE = hash_of(ROOT / "altd" / part for part in _CALIBRATES)
"""Hash of the calibrating code when this process was started."""


def chain_of(
    calibration: Calibration, measuring: Measuring, installation: Installation | None = None
) -> MeasuringChain:
    """Measuring chain as the daemon makes it."""
    views = [View(name, name) for name in calibration.target_names]
    instrument = BeamInstrument(calibration, measuring, installation)
    return MeasuringChain(views, calibration, measuring, instrument)


def _say(what: str) -> None:
    print(what, file=sys.stderr, flush=True)
