"""Check whether a camera's view is the calibrated one, by features of a frame that no spot changes.

Hot pixels identify the sensor; the texture under the spot, of print or plate, shows where the camera points
(``texture``). Neither gives a verdict if it is uncertain: nothing is known under the spot, the spot is too
dim or too small, or there are no hot pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Literal, Self

from altd.records import FaultCause, FloatArray
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.hot_pixels import HotPixels
from altd.vision.texture import Texture, TextureMatch, TextureSample, match, sample_of, stacked

TextureSource = Literal["flat", "scan"]

_MIN_SIGNIFICANCE = 8.0
_NOISE_SIGMAS = 3.0
_MODEL_ERROR_PX = 0.02
"""Error of a shift: on good views of the campaign's units at most 0.02 px on print, 0.06 px on plates."""
_MODEL_DOUBLED_PX = 0.2
"""The same for ``doubled_px``: at most 0.13 px, 0.2 with spots of 6 mm and with clipped ones; twice that if
the image moved by a fraction of a pixel, for which the model is interpolated."""
_DOUBLED_PER_SHIFT = 3.0
_MAX_USUAL_RATIO = 1.5
"""Maximum ratio to the usual value. Dots of 1 mm, nine pixels apart, are modelled worse: 0.7 px is usual."""
_MIN_PRINT_CONTRAST = 0.2
"""Contrast of a target's texture from which it is printed: plates are below 0.1, dots of any size above
this."""
_MIN_SEEN_PRINT_CONTRAST = 0.35
_MIN_EXPLAINED = 0.7
"""Minimum explained share of the contrast under a spot on print: 0.85 to 1 in the calibrated view, less than
0.6 in 19 of 20 others."""
_MIN_PRINT_GAIN = 0.8
"""Minimum gain of a print. Dust on the window adds contrast of its own, but leaves the print its gain: with 3
to 10 % of the window covered 0.5 to 0.8 is explained at a gain of 0.92 to 0.97. For another print in about
the same place both are low."""
_MIN_AREA_PX2 = 850.0
"""Minimum area of a smoothed spot that shows its print, that of 24 px: six sigmas of the smoothing that
separates texture from shape. Spots of four sigmas have a contrast of 0.5 on even surfaces too."""
_MIN_STRENGTH = 50.0
_MIN_GAIN = 0.4
_MISMATCH_SIGMAS = 5.0
_NO_SPOT = "no spot to see it by"


class ViewOutcome(Enum):
    """Whether a frame shows the calibrated view."""

    VERIFIED = auto()
    REFUTED = auto()
    UNDECIDED = auto()


@dataclass(frozen=True, slots=True)
class ViewVerdict:
    """Verdict on one frame; ``reason`` is a text on what is refuted or undecided, ``cause`` what refutes it.

    ``is_same_sensor``: the hot pixels are in their places; ``is_other_sensor``: they are what refutes the
    view. ``shift_px`` is the shift of the image, None if it could not be measured. ``displaced_px`` is the
    part of it certain enough to add to the uncertainty of a spot, with the effect of a doubled image; None if
    it is not known. ``doubled_px`` is the possible effect of that image, or of an error of the print's model.
    ``is_print_seen``: a spot shows print on a target that has none; None without a spot. ``faint`` is the
    sample of a frame with too little light to decide alone, where several together may.
    """

    outcome: ViewOutcome
    reason: str = ""
    cause: FaultCause | None = None
    is_same_sensor: bool = False
    is_other_sensor: bool = False
    shift_px: float | None = None
    displaced_px: float | None = None
    doubled_px: float | None = None
    is_print_seen: bool | None = None
    faint: TextureSample | None = None

    @classmethod
    def refuted(cls, reason: str, cause: FaultCause) -> Self:
        """Return the verdict that the view is not the calibrated one."""
        return cls(ViewOutcome.REFUTED, reason, cause)

    @classmethod
    def undecided(cls, reason: str) -> Self:
        """Return the verdict that neither outcome is certain."""
        return cls(ViewOutcome.UNDECIDED, reason)


@dataclass(frozen=True, slots=True, eq=False)
class Fingerprint:
    """Fixed pattern of one camera's images, from the calibration.

    A ``texture`` from a flat is known everywhere and does not depend on the laser, so that both its absence
    and its shift refute a view. One from the ``scan`` holds only near the nodes, and contains parts of the
    laser and of the edges of its spots, which move with a spot: it verifies a view and refutes none. None:
    nothing is known of the target's surface. ``usual_doubled_px`` is the value of ``doubled_px`` below which
    95 % of good spots are; None: not known. ``moved`` (2, 3) maps (u, v, 1) of the calibrated picture to its
    known current position, None: unmoved; shifts count from there, up to ``max_shift_px``.
    """

    hot: HotPixels
    texture: Texture | None
    source: TextureSource | None
    usual_doubled_px: float | None = None
    moved: FloatArray | None = None
    max_shift_px: float = 0.4

    def examine(
        self, analysis: FrameAnalysis, has_spot: bool, earlier: Sequence[TextureSample] = ()
    ) -> ViewVerdict:
        """Return the verdict on one frame; ``has_spot``: a good spot was found in it.

        ``earlier`` are the faint samples of earlier frames that show the same view.
        """
        sensor = self.hot.compare(analysis.frame.pixels)
        if sensor.is_other:
            reason = (
                f"{sensor.present} of {sensor.expected} hot pixels are in their places, {sensor.foreign} in "
                "others"
            )
            if sensor.offset_px is not None:
                reason += f", u {sensor.offset_px[0]:+d} v {sensor.offset_px[1]:+d} px beside"
            return replace(ViewVerdict.refuted(reason, FaultCause.OTHER_CAMERA), is_other_sensor=True)
        view = self._examine_spot(analysis, earlier) if has_spot else ViewVerdict.undecided(_NO_SPOT)
        return replace(view, is_same_sensor=sensor.is_same)

    def _examine_spot(self, analysis: FrameAnalysis, earlier: Sequence[TextureSample]) -> ViewVerdict:
        if self.texture is None:
            return ViewVerdict.undecided("the calibration knows nothing of the target's surface")
        sample = sample_of(analysis)
        if sample is None:
            return ViewVerdict.undecided(_NO_SPOT)
        is_small, is_printed = _is_small(analysis), self.texture.contrast > _MIN_PRINT_CONTRAST
        is_patterned = is_printed and not is_small
        if not (is_printed or is_small) and sample.contrast > _MIN_SEEN_PRINT_CONTRAST:
            reason = f"print is seen (contrast {sample.contrast:.2f}) on a target without"
            return replace(ViewVerdict.refuted(reason, FaultCause.OTHER_TARGET), is_print_seen=True)
        verdict = self._compare(sample, self.texture, is_patterned)
        if verdict.faint is not None and earlier:
            verdict = self._compare(stacked([*earlier, sample]), self.texture, is_patterned)
            verdict = replace(verdict, faint=sample)
        return replace(verdict, is_print_seen=None if is_small else False)

    def _compare(self, sample: TextureSample, texture: Texture, is_patterned: bool) -> ViewVerdict:
        found = match(sample, texture, self.moved)
        if found is None:
            return ViewVerdict.undecided("nothing is known of the target under the spot")
        mismatch = _mismatch(found, is_patterned) if self.source == "flat" else None
        if mismatch is not None:
            return mismatch
        if found.significance < _MIN_SIGNIFICANCE:
            reason = f"too little is seen of the target ({found.significance:.1f} sigma)"
            faint = sample if self.source == "flat" else None
            return replace(ViewVerdict.undecided(reason), faint=faint)
        displaced_px = self._displaced_px(found, is_patterned) if self.source == "flat" else None
        if found.shift_px > self.max_shift_px:
            place = "where it was calibrated" if self.moved is None else "where the self-check found it"
            shift = f"the picture lies u {found.u_px:+.2f} v {found.v_px:+.2f} px from {place}"
            if found.shift_px < _MIN_SIGNIFICANCE * found.sigma_px:
                reason = f"{shift}, uncertain by {found.sigma_px:.2f} px"
            elif self.source == "flat":
                return replace(ViewVerdict.refuted(shift, FaultCause.VIEW_MOVED), shift_px=found.shift_px)
            else:
                reason = f"{shift}, or the spot has another edge than in the scan"
            return replace(ViewVerdict.undecided(reason), displaced_px=displaced_px)
        return ViewVerdict(
            ViewOutcome.VERIFIED,
            shift_px=found.shift_px,
            displaced_px=displaced_px,
            doubled_px=found.doubled_px,
        )

    def _displaced_px(self, found: TextureMatch, is_patterned: bool) -> float:
        """Return the shift and the effect of a second image, less the part by noise and the model of a print.

        The texture of a plate is too faint to show a second image.
        """
        noise_px2 = (_NOISE_SIGMAS * found.sigma_px) ** 2 + _MODEL_ERROR_PX**2
        doubled_px2 = 0.0
        if is_patterned and self.usual_doubled_px is not None:
            expected_px = max(_MODEL_DOUBLED_PX, _MAX_USUAL_RATIO * self.usual_doubled_px)
            explained_px = expected_px + self._interpolated_px(found)
            doubled_px2 = max(found.doubled_px**2 - explained_px**2, 0.0)
        return math.sqrt(max(found.shift_px**2 - noise_px2, 0.0) + doubled_px2)

    def _interpolated_px(self, found: TextureMatch) -> float:
        """Return the doubled image that the interpolated model may cause, px; the maximum if ``moved``."""
        if self.moved is not None:
            return _MODEL_DOUBLED_PX
        return min(_DOUBLED_PER_SHIFT * found.shift_px, _MODEL_DOUBLED_PX)


def _is_small(analysis: FrameAnalysis) -> bool:
    patch = analysis.brightest_patch
    return patch is not None and patch.outline.area < _MIN_AREA_PX2


def _mismatch(found: TextureMatch, is_patterned: bool) -> ViewVerdict | None:
    """Return why this cannot be the target as it was calibrated; None if it can."""
    if found.expected * (_MIN_GAIN - found.gain) > _MISMATCH_SIGMAS:
        other = f"the target's surface is not what is seen (gain {max(found.gain, 0):.2f} of 1)"
        return ViewVerdict.refuted(other, FaultCause.OTHER_SURFACE)
    is_clear = is_patterned and found.strength > _MIN_STRENGTH
    if is_clear and found.explained < _MIN_EXPLAINED and found.gain < _MIN_PRINT_GAIN:
        other = f"another print is seen ({found.explained:.0%} of it is that of the calibration)"
        return ViewVerdict.refuted(other, FaultCause.OTHER_TARGET)
    return None
