"""Composition of the self-check from a config, a calibration and the lamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from altd.acquisition.self_check.correction import Correction
from altd.acquisition.self_check.frames import LedLog
from altd.acquisition.self_check.geometry_state import GeometryState
from altd.acquisition.self_check.judging import CheckJudge, limits_of
from altd.acquisition.self_check.memory import CheckMemory
from altd.acquisition.self_check.schedule import Schedule
from altd.acquisition.self_check.service import CheckParts
from altd.app.parts import AnyCalibration
from altd.config import Config, LiveCameraSettings
from altd.instruments.planar.instrument import PlanarCalibration
from altd.measuring.calibration import Calibration
from altd.measuring.chain import View
from altd.measuring.spot_locator import SpotLocator
from altd.ports import Camera, Clock

_USUAL_FPS = 20.0


def why_unchecked(
    calibration: Calibration, cameras: Mapping[str, Camera], has_lamps: bool, is_desk: bool = False
) -> str:
    """Return why a unit cannot check itself, as text; empty: it can."""
    if not has_lamps and is_desk:
        return "does not apply to a desk unit: it has no frame LEDs"
    if not has_lamps:
        return "the settings have no [lamps]: there are no frame LEDs to be switched"
    if any(camera.playback for camera in cameras.values()):
        return "a recording is played: its frames do not show the frame LEDs that are switched now"
    without = [target.name for target in calibration.targets if not len(target.leds_px)]
    if without:
        return f"the calibration has no LED references for {', '.join(without)}"
    return ""


def fps_of(config: Config) -> float:
    """Return the exposures per second; all live cameras have the same rate."""
    rates = [camera.fps for camera in config.cameras.values() if isinstance(camera, LiveCameraSettings)]
    return min(rates, default=_USUAL_FPS)


def geometry_of(config: Config, calibration: AnyCalibration, clock: Clock) -> GeometryState | None:
    """Return the state of the geometry, before the first check; None: of a plate, which has no frame LEDs."""
    if isinstance(calibration, PlanarCalibration):
        return None
    return GeometryState(config.self_check, limits_of(config.self_check), calibration, clock)


def check_parts_of(
    config: Config,
    geometry: GeometryState,
    views: Sequence[View],
    locators: Mapping[str, SpotLocator],
    clock: Clock,
) -> CheckParts:
    """Return the parts for the checks of a config."""
    settings, calibration = config.self_check, geometry.calibration
    period_ns = round(1e9 / fps_of(config))
    return CheckParts(
        LedLog(clock, {view.camera: period_ns for view in views}),
        Schedule(clock, settings.interval_s, settings.enabled),
        CheckJudge(views, calibration, limits_of(settings), config.installation),
        geometry,
        Correction(locators, calibration, {view.camera: view.target for view in views}),
        CheckMemory(calibration, clock),
    )
