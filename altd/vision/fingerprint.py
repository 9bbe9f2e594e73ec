"""Whether a camera's view is the one that was calibrated, from what no spot changes in a frame.

Hot pixels tell the sensor; print and grain under the spot tell where it looks (``texture``). Each says
nothing where it cannot be sure: nothing known under the spot, a spot too dim or too small, no hot pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.hot_pixels import HotPixels
from altd.vision.texture import Match, Sample, Texture, match, sample_of

TextureSource = Literal["flat", "scan"]

MAX_SHIFT_PX = 0.5
"""0.1 mm on the target, twice the accuracy that the thesis reached. Heat moves a picture by 0.1 to 0.3 px."""
_MIN_SIGMAS = 8.0
_NOISE_SIGMAS = 3.0
_MODEL_PX = 0.02
"""On good views of the campaign's units shifts of 0.02 px at most are found on print, of 0.06 on plates."""
_MODEL_DOUBLED_PX = 0.2
"""Likewise: 0.13 px at most, 0.2 with spots of 6 mm and with clipped ones; twice that where the picture moved
by a part of a pixel, for which the model is interpolated."""
_SHIFTED_DOUBLED = 3.0
_UNUSUAL = 1.5
"""Dots of 1 mm, nine pixels from each other, are modelled less well: there 0.7 px are usual."""
_PATTERNED_FROM = 0.2
"""Contrast from which a target is printed: grain of a plate stays below 0.1, dots of any size are above."""
_PRINT_SEEN_FROM = 0.35
_MIN_EXPLAINED = 0.7
"""Of the contrast under a spot on print: 0.85 to 1 of it is explained in the calibrated view, less than
0.6 in 19 of 20 others."""
_MIN_PRINT_GAIN = 0.8
"""Dust on the window adds contrast of its own, but leaves the print its gain: with 3 to 10 % of the window
covered 0.5 to 0.8 is explained at a gain of 0.92 to 0.97. Another print in about the same place has both
low."""
_MIN_STRENGTH = 50.0
_MIN_GAIN = 0.4
_ABSENT_SIGMAS = 5.0
_NO_SPOT = "no spot to see it by"


@dataclass(frozen=True, slots=True)
class ViewVerdict:
    """What one frame tells. ``wrong`` is a sentence, empty unless this is not the view that was calibrated.

    ``is_verified``: it is. ``doubt`` says why neither is certain. ``is_same_sensor``: the hot pixels are in
    their places; ``is_other_sensor``: they are what is wrong. ``shift_px`` is by how much the picture moved,
    None where that could not be measured.
    ``displaced_px`` is the part of it that is certain enough to add to the uncertainty of a spot, with what a
    doubled picture does; None where nobody knows. ``doubled_px`` is what may be that picture's doing, or that
    of the print's model. ``is_print_seen`` tells whether a spot shows print on a target that has none, None
    where no spot tells.
    """

    wrong: str = ""
    is_verified: bool = False
    doubt: str = ""
    is_same_sensor: bool = False
    is_other_sensor: bool = False
    shift_px: float | None = None
    displaced_px: float | None = None
    doubled_px: float | None = None
    is_print_seen: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fingerprint:
    """What a calibration knows of one camera's fixed picture.

    ``texture`` from a flat is known everywhere and does not depend on the laser, so its absence is as telling
    as its shift. One from the ``scan`` holds only near the nodes, and in it what belongs to the laser and to
    the edges of its spots, which moves with a spot: it verifies a view and refutes none. None: nothing is
    known of the target's surface. ``usual_doubled_px`` is what good spots show of a doubled picture, 95 % of
    them less; None: not known.
    """

    hot: HotPixels
    texture: Texture | None
    source: TextureSource | None
    usual_doubled_px: float | None = None

    def examine(self, analysis: FrameAnalysis, has_spot: bool) -> ViewVerdict:
        """The verdict of one frame; ``has_spot``: a good spot was found in it."""
        sensor = self.hot.compare(analysis.frame.pixels)
        if sensor.is_other:
            wrong = (
                f"{sensor.present} of {sensor.expected} hot pixels are in their places, {sensor.foreign} in "
                f"others{_beside(sensor.offset_px)}"
            )
            return ViewVerdict(wrong, is_other_sensor=True)
        view = self._examine_spot(analysis) if has_spot else ViewVerdict(doubt=_NO_SPOT)
        return replace(view, is_same_sensor=sensor.is_same)

    def _examine_spot(self, analysis: FrameAnalysis) -> ViewVerdict:
        if self.texture is None:
            return ViewVerdict(doubt="the calibration knows nothing of the target's surface")
        sample = sample_of(analysis)
        if sample is None:
            return ViewVerdict(doubt=_NO_SPOT)
        patterned = self.texture.contrast > _PATTERNED_FROM
        if not patterned and sample.contrast > _PRINT_SEEN_FROM:
            why = f"print is seen (contrast {sample.contrast:.2f}) on a target without"
            return ViewVerdict(wrong=why, is_print_seen=True)
        return replace(self._matched(sample, self.texture, patterned), is_print_seen=False)

    def _matched(self, sample: Sample, texture: Texture, patterned: bool) -> ViewVerdict:
        found = match(sample, texture)
        if found is None:
            return ViewVerdict(doubt="nothing is known of the target under the spot")
        if self.source == "flat" and (why := _absent(found, patterned)):
            return ViewVerdict(wrong=why)
        if found.significance < _MIN_SIGMAS:
            return ViewVerdict(doubt=f"too little is seen of the target ({found.significance:.1f} sigma)")
        if found.shift_px > max(MAX_SHIFT_PX, _MIN_SIGMAS * found.sigma_px):
            shift = (
                f"the picture lies u {found.u_px:+.2f} v {found.v_px:+.2f} px from where it was calibrated"
            )
            if self.source == "flat":
                return ViewVerdict(wrong=shift, shift_px=found.shift_px)
            return ViewVerdict(doubt=f"{shift}, or the spot has another edge than in the scan")
        return ViewVerdict(
            is_verified=True,
            shift_px=found.shift_px,
            displaced_px=self._displaced_px(found, patterned) if self.source == "flat" else None,
            doubled_px=found.doubled_px,
        )

    def _displaced_px(self, found: Match, patterned: bool) -> float:
        """The shift, and what a second picture does, without what noise and the model of a print explain.

        Grain of a plate is too faint to show a second picture.
        """
        noise_px2 = (_NOISE_SIGMAS * found.sigma_px) ** 2 + _MODEL_PX**2
        of_second_px2 = 0.0
        if patterned and self.usual_doubled_px is not None:
            usual_px = max(_MODEL_DOUBLED_PX, _UNUSUAL * self.usual_doubled_px)
            of_model_px = usual_px + min(_SHIFTED_DOUBLED * found.shift_px, _MODEL_DOUBLED_PX)
            of_second_px2 = max(found.doubled_px**2 - of_model_px**2, 0.0)
        return math.sqrt(max(found.shift_px**2 - noise_px2, 0.0) + of_second_px2)


def _absent(found: Match, patterned: bool) -> str:
    """Why what is seen is not the target as it was calibrated, in words; empty when it may be."""
    if found.expected * (_MIN_GAIN - found.gain) > _ABSENT_SIGMAS:
        return f"the target's surface is not what is seen (gain {max(found.gain, 0):.2f} of 1)"
    is_clear = patterned and found.strength > _MIN_STRENGTH
    if is_clear and found.explained < _MIN_EXPLAINED and found.gain < _MIN_PRINT_GAIN:
        return f"another print is seen ({found.explained:.0%} of it is that of the calibration)"
    return ""


def _beside(offset_px: tuple[int, int] | None) -> str:
    return "" if offset_px is None else f", u {offset_px[0]:+d} v {offset_px[1]:+d} px beside"
