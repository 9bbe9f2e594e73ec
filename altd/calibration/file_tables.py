"""The tables of the calibration file: its keys, the limits of its numbers, and a camera's fingerprint."""

from __future__ import annotations

import base64
from datetime import datetime
from typing import Annotated, Any, Literal, get_type_hints

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetPydanticSchema,
    create_model,
)
from pydantic_core import CoreSchema, core_schema

from altd.config.table import Celsius
from altd.files.picture import decode_png
from altd.mapping.grid import Axis
from altd.mapping.tensor_map import ROUND, Model
from altd.records import GLASS_INDEX, Limits, Origin
from altd.records.limits import LIMIT_KEYS, MAX_LIMIT, NO_LIMITS
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat, Source
from altd.vision.hot_pixels import MAX_PIXELS, HotPixels, places_of
from altd.vision.settings import LightReference, ShapeReference, SpotReference, SpotSettings
from altd.vision.texture import Texture

_ZERO_LEVEL = 128
_LEVELS_PER_UNIT = 200.0
"""Grey levels per unit of relative brightness − 1: a range of −0.64 to 0.63 in steps of 0.005. The grain of
a plain plate is a few hundredths."""

_Pixel = tuple[Annotated[int, Field(ge=0, le=20_000)], Annotated[int, Field(ge=0, le=20_000)]]
_Pixels = Annotated[list[_Pixel], Field(max_length=MAX_PIXELS)]


class FingerprintTable(BaseModel):
    """``fingerprint``: hot pixels as (u, v), and the source of the texture.

    ``texture`` ``flat``: the target's flat in the same file; ``scan``: the grey picture ``png``, base64, in
    which level 128 is even ground and 200 levels above it twice its brightness. ``doubled_px``: effect of a
    doubled picture on good spots, px; 95 % of them show less.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    hot_px: _Pixels
    sometimes_hot_px: _Pixels
    texture: Literal["flat", "scan"] | None
    png: str | None
    doubled_px: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] | None = None


def fingerprint_document(fingerprint: Fingerprint | None) -> dict[str, Any] | None:
    """Return the table of a fingerprint; None without one."""
    if fingerprint is None:
        return None
    png = None
    if fingerprint.source == "scan" and fingerprint.texture is not None:
        levels = np.rint(fingerprint.texture.relative * _LEVELS_PER_UNIT + _ZERO_LEVEL)
        png = png_text(np.clip(levels, 0, 255).astype(np.uint8))
    return {
        "hot_px": fingerprint.hot.permanent.tolist(),
        "sometimes_hot_px": fingerprint.hot.intermittent.tolist(),
        "texture": fingerprint.source,
        "png": png,
        "doubled_px": fingerprint.usual_doubled_px,
    }


def fingerprint_of(
    place: str, table: FingerprintTable | None, width: int, height: int, flat: Flat | None
) -> Fingerprint | None:
    """Build the fingerprint from a table; raises ValueError with the ``place`` of an inconsistent value."""
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
        levels = png_levels(f"{place}.png", table.png, width, height)
        texture = Texture((levels.astype(np.float32) - _ZERO_LEVEL) / np.float32(_LEVELS_PER_UNIT))
    elif table.texture == "flat":
        if flat is None:
            raise ValueError(f"{place}.texture: 'flat', but the target has none")
        texture = Texture.of_flat(flat)
    return Fingerprint(hot, texture, table.texture, table.doubled_px)


def png_text(levels: npt.NDArray[np.uint8]) -> str:
    """A grey picture (rows, columns) as a PNG in base64."""
    return base64.b64encode(cv2.imencode(".png", levels)[1].tobytes()).decode("ascii")


def png_levels(place: str, text: str, width: int, height: int) -> npt.NDArray[np.uint8]:
    """Decode the grey picture in a text of ``png_text``; raises ValueError with the ``place``."""
    try:
        png = base64.b64decode(text, validate=True)
        return np.asarray(decode_png(png, width, height, bits=8), dtype=np.uint8)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


FORMAT = "altd-calibration/1"

_MIN_SHAPE_DETERMINANT = 0.01
"""Minimum determinant of a noise shape of trace 2; a spot 20 times as long as wide has less."""

Millimetres = Annotated[float, Field(ge=-100_000, le=100_000)]
Pixels = Annotated[float, Field(ge=-100_000, le=100_000)]
"""Coordinate in or near a picture of at most 20 000 px."""
PositivePixels = Annotated[float, Field(gt=0, le=1000)]
"""Misfit, noise or limit, px."""
Coefficient = Annotated[float, Field(ge=-1e7, le=1e7)]
"""Position in px times the root of the grid's number of nodes: the Gram polynomials are orthonormal."""
Side = Annotated[int, Field(ge=16, le=20_000)]


class Table(BaseModel):
    """Table that permits only its own keys and finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _table_of(record: type, **narrower: Any) -> GetPydanticSchema:
    """Read a dataclass from a table that has exactly its fields.

    ``narrower`` contains the types of the fields whose values are limited in a file; with a default, of those
    that a file may lack.
    """
    types = get_type_hints(record) | narrower
    fields: dict[str, Any] = {
        name: type_ if isinstance(type_, tuple) else (type_, ...) for name, type_ in types.items()
    }
    table = create_model(f"{record.__name__}Table", __base__=Table, **fields)

    def schema(_: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(
            lambda read: record(**{name: getattr(read, name) for name in types}),
            handler.generate_schema(table),
        )

    return GetPydanticSchema(schema)


_Localiser = Annotated[
    SpotSettings,
    _table_of(
        SpotSettings,
        smoothing_px=Annotated[float, Field(ge=0, le=100)],
        threshold=Annotated[float, Field(gt=0, lt=1)],
        power=Annotated[float, Field(gt=0, le=10)],
        min_diameter_px=Annotated[float, Field(gt=0, le=10_000)],
        max_diameter_px=Annotated[float, Field(gt=0, le=20_000)] | None,
        max_aspect=Annotated[float, Field(ge=1, le=100)],
        min_fill=Annotated[float, Field(ge=0, le=1)],
        like_size=Annotated[float, Field(gt=0, le=1)],
        max_saturated=Annotated[float, Field(ge=0, le=1)],
        max_sigma_px=PositivePixels,
        full_well_electrons=Annotated[float, Field(ge=100, le=10_000_000)],
    ),
]
_Axis = Annotated[
    Axis,
    _table_of(
        Axis,
        first_mm=Millimetres,
        step_mm=Annotated[float, Field(gt=0, le=10_000)],
        nodes=Annotated[int, Field(ge=2, le=10_000)],
    ),
]
_Feature = Annotated[float, Field(ge=-10, le=10)]
_Scatter = Annotated[float, Field(ge=0, le=10)]
_Shape = Annotated[
    ShapeReference,
    _table_of(
        ShapeReference,
        mean=tuple[_Feature, _Feature, _Feature, Annotated[float, Field(gt=0, le=1000)]],
        sigma=tuple[_Scatter, _Scatter, _Scatter, _Scatter],
    ),
]
_LogLight = Annotated[float, Field(ge=-1000, le=1000)]
_Light = Annotated[
    LightReference,
    _table_of(
        LightReference,
        log_light=tuple[_LogLight, _LogLight, _LogLight, _LogLight, _LogLight, _LogLight],
        sigma=Annotated[float, Field(gt=0, le=10)],
    ),
]
_Spot = Annotated[
    SpotReference,
    _table_of(
        SpotReference,
        grain=Annotated[float, Field(gt=0, le=10)] | None,
        misfit_ratio=Annotated[float, Field(ge=1, le=1000)],
        pattern_px=Annotated[float, Field(ge=0, le=100)] | None,
        noise_px=Annotated[float, Field(ge=0, le=100)],
        shape=_Shape | None,
        light=(_Light | None, None),
    ),
]


_Share = Annotated[float, Field(ge=0, le=2)]
_Mixed = Annotated[float, Field(ge=-1, le=1)]


def _checked_shape(shape: tuple[float, float, float]) -> tuple[float, float, float]:
    uu, uv, vv = shape
    if not (abs(uu + vv - 2) < 1e-6 and uu * vv - uv * uv >= _MIN_SHAPE_DETERMINANT):
        raise ValueError("is not a covariance (uu, uv, vv) with trace 2")
    return shape


class MapTable(Table):
    """Map of a target, or the second map that checks it."""

    basis: Literal["gram"]
    model: Model
    x_axis: _Axis
    y_axis: _Axis
    degree: tuple[Annotated[int, Field(ge=0, le=100)], Annotated[int, Field(ge=0, le=100)]]
    spectrum_u_px: list[list[Coefficient]]
    spectrum_v_px: list[list[Coefficient]]
    spread_u_px: list[list[Coefficient]]
    spread_v_px: list[list[Coefficient]]
    noise_px: PositivePixels
    noise_shape: Annotated[tuple[_Share, _Mixed, _Share], AfterValidator(_checked_shape)] = ROUND
    hull_mm: Annotated[list[tuple[Millimetres, Millimetres]], Field(min_length=3)]
    margin_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    beyond_px_per_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0


class _CrossCheck(Table):
    map: MapTable
    left_out_px: PositivePixels
    bound_px: PositivePixels
    largest_px: Annotated[float, Field(ge=0, le=1000)]


class _Residuals(Table):
    mean_mm: Annotated[float, Field(ge=0, le=1000)]
    std_mm: Annotated[float, Field(ge=0, le=1000)]
    max_mm: Annotated[float, Field(ge=0, le=1000)]


class _Flat(Table):
    source: Source
    origin: Origin = Origin.CAMERA
    png: str


class TargetTable(Table):
    """Entry of ``targets``."""

    name: str
    z_mm: Millimetres
    camera_serial: str | None
    camera_model: str | None = None
    camera_driver: str | None = None
    origin: Origin = Origin.CAMERA
    width: Side
    height: Side
    localiser: _Localiser
    flat: _Flat | None
    map: MapTable
    cross_check: _CrossCheck
    left_out_px: PositivePixels
    residuals: _Residuals
    repeatability_px: tuple[Annotated[float, Field(ge=0, le=1000)], Annotated[float, Field(ge=0, le=1000)]]
    leds_px: list[tuple[Pixels, Pixels]]
    spot: _Spot | None = None
    fingerprint: FingerprintTable | None = None
    glass_mm: Annotated[float, Field(gt=0, le=100)] | None = None
    glass_index: Annotated[float, Field(ge=1, le=3)] = GLASS_INDEX


_Limit = Annotated[float, Field(ge=0, le=MAX_LIMIT)] | None
_Limits = Annotated[
    Limits, _table_of(Limits, **dict.fromkeys(LIMIT_KEYS, _Limit) | {"temperature_k": (_Limit, None)})
]


class UnitTable(Table):
    """Table ``unit``."""

    serial: str


class RecordingTable(Table):
    """Table ``recording``: the source of the calibration."""

    note: str
    sha256: str


class CalibrationTable(Table):
    """The whole file except its checksum."""

    format: Literal["altd-calibration/1"]
    unit: UnitTable
    created: datetime
    recording: RecordingTable
    limits: _Limits = NO_LIMITS
    temperature_c: Celsius | None = None
    targets: Annotated[list[TargetTable], Field(min_length=1)]
