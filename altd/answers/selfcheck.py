"""``altd selfcheck``: compares the frame LEDs of a recording with their references."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from altd.calibration.file import check_recording, load_calibration
from altd.errors import BadInputError
from altd.measuring.calibration import TargetCalibration
from altd.recording.frames_table import FrameLine
from altd.recording.reader import Recording, open_recording
from altd.records import Frame, Origin, Spot
from altd.selfcheck.records import DriftLimits, LedView
from altd.selfcheck.verdict import judge
from altd.status.models import self_check_of
from altd.vision.localise import locate

_KINDS = ("self-check", "measurement", "scan")
_MAX_PAIRS = 20
_SPOT_FRAMES = 3
"""Number of frames that give the spot's position; its noise does not change the effect of a drift."""


def judge_recording(recording_path: Path, calibration_path: Path) -> dict[str, Any]:
    """Return the result as plain JSON types; raises BadInputError.

    The recording and the calibration must be readable and belong together.
    """
    recording = open_recording(recording_path)
    header = recording.header
    if header.kind not in _KINDS:
        raise BadInputError(
            recording_path, f"is of kind {header.kind!r}; a self-check needs one of: {', '.join(_KINDS)}"
        )
    calibration = load_calibration(calibration_path, header.unit.serial)
    views: dict[str, LedView] = {}
    at: dict[str, tuple[float, float]] = {}
    simulated = calibration.simulated
    check_recording(calibration, calibration_path, header)
    for target in header.shown_targets:
        known = calibration.target(target.name)
        if known is None:
            continue
        lit, dark = _led_rows(recording, target.camera)
        if not lit or not dark:
            continue
        view = LedView(_frames(recording, lit), _frames(recording, dark))
        views[target.name] = view
        if (place := _spot_place(view.dark, known)) is not None:
            at[target.name] = place
        simulated |= header.cameras[target.camera].origin is Origin.SIMULATED
    if not views:
        names = ", ".join(calibration.target_names)
        raise BadInputError(recording_path, f"has no frames with the LEDs on and off of {names}")
    origin = Origin.SIMULATED if simulated else Origin.CAMERA
    return {**self_check_of(judge(views, calibration, at, DriftLimits())).as_object(), "origin": str(origin)}


def _led_rows(recording: Recording, camera: str) -> tuple[list[FrameLine], list[FrameLine]]:
    """A camera's rows with the LEDs on, and for each the row with them off that is nearest in time.

    Rows in which a stage moved the beam are excluded. Of many rows, some evenly distributed ones are used.
    """
    rows = [row for row in recording.rows.of(camera) if row.position_mm is None]
    lit, free = [row for row in rows if row.leds_on], [row for row in rows if not row.leds_on]
    chosen = _spread(lit)
    dark = []
    for row in chosen:
        if not free:
            break
        nearest = min(range(len(free)), key=lambda index: abs(free[index].t_s - row.t_s))
        dark.append(free.pop(nearest))
    return chosen, dark


def _spread(rows: Sequence[FrameLine]) -> list[FrameLine]:
    if len(rows) <= _MAX_PAIRS:
        return list(rows)
    return [rows[int(index)] for index in np.linspace(0, len(rows) - 1, _MAX_PAIRS)]


def _frames(recording: Recording, rows: Sequence[FrameLine]) -> tuple[Frame, ...]:
    return tuple(recording.frame(row) for row in rows)


def _spot_place(dark: Sequence[Frame], target: TargetCalibration) -> tuple[float, float] | None:
    """Position of the spot while the LEDs are off, px; None: there is none."""
    spots = [locate(frame, target.localiser, target.flat) for frame in dark[:_SPOT_FRAMES]]
    places = [(spot.u_px, spot.v_px) for spot in spots if isinstance(spot, Spot)]
    if not places:
        return None
    u_px, v_px = np.median(places, axis=0).tolist()
    return u_px, v_px
