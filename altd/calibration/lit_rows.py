"""Which frames of a flat or of a plate are lit: by what their rows say, else by their light."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

from altd.calibration.result import Progress
from altd.recording.reader import Recording

_MAX_STEADY_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class LitRows:
    """Which of a camera's rows are lit and which are dark, in the order of the rows; some may be neither."""

    lit: tuple[bool, ...]
    dark: tuple[bool, ...]


def lit_rows(
    recording: Recording,
    camera: str,
    max_dark_ratio: float,
    progress: Progress = lambda done, total: None,
) -> LitRows:
    """The lit and the dark rows of a camera.

    By ``leds`` where the rows differ in it. Otherwise by the mean of each frame: those within a tenth of the
    brightest are lit, those within a tenth of the dimmest are dark. All are lit where the dimmest has more
    than ``max_dark_ratio`` of the light of the brightest.
    """
    flags = array("b", (row.leds_on for row in recording.rows.of(camera)))
    if not flags or min(flags) < max(flags):
        return LitRows(tuple(map(bool, flags)), tuple(not flag for flag in flags))
    levels = array("d")
    for row in recording.rows.of(camera):
        levels.append(float(recording.frame(row).pixels.mean()))
        progress(len(levels), len(flags))
    dimmest, brightest = min(levels), max(levels)
    if dimmest > max_dark_ratio * brightest or dimmest == brightest:
        return LitRows((True,) * len(levels), (False,) * len(levels))
    margin = _MAX_STEADY_SHARE * (brightest - dimmest)
    return LitRows(
        tuple(level >= brightest - margin for level in levels),
        tuple(level <= dimmest + margin for level in levels),
    )
