"""The fingerprint of a camera as a table of the calibration file."""

from __future__ import annotations

import base64
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from altd.files.picture import decode_png
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.hot_pixels import MAX_PIXELS, HotPixels, places_of
from altd.vision.texture import Texture

_ZERO_LEVEL = 128
_LEVELS_PER_UNIT = 200.0
"""Relative brightness − 1 from −0.64 to 0.63 in steps of 0.005: a plain plate's grain has
a few hundredths."""

_Pixel = tuple[Annotated[int, Field(ge=0, le=20_000)], Annotated[int, Field(ge=0, le=20_000)]]
_Pixels = Annotated[list[_Pixel], Field(max_length=MAX_PIXELS)]


class FingerprintTable(BaseModel):
    """``fingerprint``: hot pixels as (u, v), and where the texture comes from.

    ``texture`` ``flat``: from the target's flat in the same file; ``scan``: as the grey picture ``png``,
    base64, whose level 128 means even ground and 200 levels above it twice its brightness. ``doubled_px``:
    what good spots show of a doubled picture.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    hot_px: _Pixels
    sometimes_hot_px: _Pixels
    texture: Literal["flat", "scan"] | None
    png: str | None
    doubled_px: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] | None = None


def as_document(fingerprint: Fingerprint | None) -> dict[str, Any] | None:
    """The table; None where nothing is known."""
    if fingerprint is None:
        return None
    png = None
    if fingerprint.source == "scan" and fingerprint.texture is not None:
        levels = np.rint(fingerprint.texture.relative * _LEVELS_PER_UNIT + _ZERO_LEVEL)
        picture = np.clip(levels, 0, 255).astype(np.uint8)
        png = base64.b64encode(cv2.imencode(".png", picture)[1].tobytes()).decode("ascii")
    return {
        "hot_px": fingerprint.hot.permanent.tolist(),
        "sometimes_hot_px": fingerprint.hot.intermittent.tolist(),
        "texture": fingerprint.source,
        "png": png,
        "doubled_px": fingerprint.usual_doubled_px,
    }


def from_table(
    place: str, table: FingerprintTable | None, width: int, height: int, flat: Flat | None
) -> Fingerprint | None:
    """The fingerprint of a table; raises ValueError that names the ``place`` of what does not fit."""
    if table is None:
        return None
    if (table.texture == "scan") != (table.png is not None):
        raise ValueError(f"{place}.png: belongs to texture 'scan' and to no other")
    hot = HotPixels(places_of(table.hot_px), places_of(table.sometimes_hot_px))
    for key, pixels in (("hot_px", hot.permanent), ("sometimes_hot_px", hot.intermittent)):
        if (pixels >= (width, height)).any():
            raise ValueError(f"{place}.{key}: a pixel lies outside {width} × {height}")
    texture = None
    if table.png is not None:
        texture = _texture(f"{place}.png", table.png, width, height)
    elif table.texture == "flat":
        if flat is None:
            raise ValueError(f"{place}.texture: 'flat', but the target has none")
        texture = Texture.of_flat(flat)
    return Fingerprint(hot, texture, table.texture, table.doubled_px)


def _texture(place: str, text: str, width: int, height: int) -> Texture:
    try:
        png = base64.b64decode(text, validate=True)
        levels = decode_png(png, width, height, bits=8)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error
    return Texture((levels.astype(np.float32) - _ZERO_LEVEL) / np.float32(_LEVELS_PER_UNIT))
