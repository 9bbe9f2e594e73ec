"""The instruments of the daemon: all differences between kinds of units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from altd.acquisition.glasses import MAX_PAUSE_SHARE, round_s
from altd.acquisition.pictures import outlined, view_of
from altd.app.baseline import baseline_file
from altd.app.calibration_summary import planar_summary_of, summary_of, target_areas_of
from altd.app.parts import AnyCalibration
from altd.app.self_check import fps_of
from altd.config import AnyCameraSettings, Config, LiveCameraSettings, RowSettings
from altd.instruments.beam.instrument import BeamInstrument
from altd.instruments.planar.chain import PlanarChain
from altd.instruments.planar.instrument import QUANTITIES, PlanarCalibration
from altd.instruments.row.frames import RowChain
from altd.instruments.row.measurement import quantities_of
from altd.instruments.row.switched_window import SwitchedWindow
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain, View
from altd.measuring.frame_chain import FrameChain, Provenance
from altd.records import CameraIdentity, MeanSpots, Quantities
from altd.status.calibration_summary import CalibrationFigures
from altd.status.services import TargetView
from altd.status.target_area import TargetArea

STALE_AFTER_ROUNDS = 2.5
"""Age of a stale row measurement, in rounds: it is published one round late and shown until the next."""
_PLATE = "plate"
"""Name of a plate's picture, and of its camera if the caller of the daemon chose the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveInstrument:
    """An instrument with its calibration. ``views`` and ``areas`` are in the order of its cameras.

    A measurement is stale ``stale_after_s`` after its last exposure.
    """

    quantities: Quantities
    chain: Callable[[Provenance], FrameChain[Any]]
    figures: CalibrationFigures
    views: tuple[TargetView, ...]
    areas: tuple[TargetArea, ...]
    stale_after_s: float


def live_instrument(
    config: Config,
    calibration: AnyCalibration,
    celsius: Callable[[], float | None] = lambda: None,
    correct: Callable[[MeanSpots], MeanSpots] | None = None,
) -> LiveInstrument:
    """Return the instrument of a config; the calibration was checked against the config.

    ``celsius`` returns the temperature of a beam's frame, °C; None: not known. ``correct`` removes a known
    drift of a beam's cameras from the mean spots.
    """
    if isinstance(calibration, PlanarCalibration):
        return _planar(config, calibration)
    for target in calibration.targets:
        _ = target.inverse  # computed now: in the first measurement it would block the loop
    by_name = {target.name: target for target in calibration.targets}
    is_row = config.unit.instrument == "chain"
    parts = _row(config, calibration) if is_row else _beam(config, calibration, celsius, correct)
    quantities, chain, stale_after_s = parts
    figures = summary_of(
        calibration, [target.name for target in config.targets], config.unit.calibration.name
    )
    if is_row:
        # it applies only to a beam through all targets
        figures = figures.model_copy(update={"expected_sigma": {}})
    return LiveInstrument(
        quantities,
        chain,
        figures,
        tuple(view_of(of.camera, by_name[of.name]) for of in config.targets),
        target_areas_of(config, calibration),
        stale_after_s,
    )


_Parts = tuple[Quantities, Callable[[Provenance], FrameChain[Any]], float]
"""Quantities, chain factory, and the age at which a measurement is stale, s."""


def _beam(
    config: Config,
    calibration: Calibration,
    celsius: Callable[[], float | None],
    correct: Callable[[MeanSpots], MeanSpots] | None,
) -> _Parts:
    measuring = config.measuring
    has_inclinometer = config.inclinometer is not None
    instrument = BeamInstrument(
        calibration, measuring, config.installation, celsius, has_inclinometer, config.machine
    )
    stale_after_s, is_switched = measuring.stale_after_s, bool(config.switched_targets)
    if config.switches is not None:  # no measurement while the glasses settle
        stale_after_s += config.switches.settle_s * (1.0 + MAX_PAUSE_SHARE)

    def chain(provenance: Provenance) -> FrameChain[Any]:
        names = tuple(target.name for target in config.targets)
        switched = SwitchedWindow(names, measuring.window, measuring.every) if is_switched else None
        return MeasuringChain(
            views_of(config), calibration, measuring, instrument, provenance, switched, correct
        )

    return instrument.quantities, chain, stale_after_s


def _row(config: Config, calibration: Calibration) -> _Parts:
    """Return the parts for a row; raises BadInputError for a stored baseline that does not match."""
    settings = config.chain or RowSettings()
    file = baseline_file(config, calibration)
    means = None if file is None else file.load()
    longest_s = round_s(config, fps_of(config))[1]

    def chain(provenance: Provenance) -> FrameChain[Any]:
        return RowChain(views_of(config), calibration, settings, config.measuring, provenance, means)

    return (
        quantities_of(calibration.target_names),
        chain,
        max(config.measuring.stale_after_s, STALE_AFTER_ROUNDS * longest_s),
    )


def views_of(config: Config) -> list[View]:
    """Return the targets of a config with their cameras."""
    return [View(of.name, of.camera, _expected(config.cameras.get(of.camera))) for of in config.targets]


def _planar(config: Config, calibration: PlanarCalibration) -> LiveInstrument:
    (camera,) = config.measuring_cameras or (_PLATE,)
    of_camera = calibration.fit.camera
    size = of_camera.width, of_camera.height
    view = outlined(_PLATE, camera, size, calibration.hull_mm, of_camera.to_px, np.empty((0, 2)))
    return LiveInstrument(
        QUANTITIES,
        lambda provenance: PlanarChain(
            camera, calibration, config.measuring, provenance, _expected(config.cameras.get(camera))
        ),
        planar_summary_of(calibration, config.unit.calibration.name),
        (view,),
        (),
        config.measuring.stale_after_s,
    )


def _expected(camera: AnyCameraSettings | None) -> CameraIdentity | None:
    """Return the identity that the config expects of a live camera; None: none."""
    return CameraIdentity(serial=camera.serial) if isinstance(camera, LiveCameraSettings) else None
