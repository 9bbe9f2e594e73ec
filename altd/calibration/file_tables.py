"""Tables in the calibration file: keys, limits, and how they hold a target's map, flat, spot, fingerprint."""

from __future__ import annotations

import base64
from typing import Annotated, Any, Literal, Self, get_type_hints

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    WrapSerializer,
    create_model,
    model_validator,
)

from altd.files.picture import decode_png
from altd.files.record_tables import At, attributes_of, held_in
from altd.files.table import Millimetres, Table, complaint
from altd.mapping.grid import Axis
from altd.mapping.tensor_map import ROUND, Model, TensorMap
from altd.records import FloatArray, Origin
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import BLOCK_PX, Flat, Learnt, Source
from altd.vision.hot_pixels import MAX_PIXELS, HotPixels, places_of
from altd.vision.settings import (
    UNKNOWN_SPOT,
    LightReference,
    ShapeReference,
    SpotReference,
)
from altd.vision.texture import Texture


def array_of(key: str, values: list[Any], shape: tuple[int, ...]) -> FloatArray:
    """Return the numbers as an array; refuse the ``key`` of a table if they do not have this shape."""
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:
        array = np.empty(0)
    if array.shape != shape:
        raise complaint(((key,), f"expected {' × '.join(map(str, shape))} numbers"))
    return array


def listed(array: FloatArray) -> Any:
    """Return an array as a file has it."""
    return array.tolist()


ARRAY = AfterValidator(np.array), PlainSerializer(listed)
"""Marks numbers that are a list in the file and an array in the record."""

_ZERO_LEVEL = 128
_LEVELS_PER_UNIT = 200.0
"""Grey levels per unit of relative brightness − 1: a range of −0.64 to 0.63 in steps of 0.005. The grain of
a plain plate is a few hundredths."""

_Pixel = tuple[Annotated[int, Field(ge=0, le=20_000)], Annotated[int, Field(ge=0, le=20_000)]]
_Pixels = Annotated[list[_Pixel], Field(max_length=MAX_PIXELS), PlainSerializer(listed)]


def _scan_png(fingerprint: Fingerprint) -> str | None:
    if fingerprint.source != "scan" or fingerprint.texture is None:
        return None
    levels = np.rint(fingerprint.texture.relative * _LEVELS_PER_UNIT + _ZERO_LEVEL)
    return png_text(np.clip(levels, 0, 255).astype(np.uint8))


class FingerprintTable(Table):
    """``fingerprint``: hot pixels as (u, v), and the source of the texture.

    ``texture`` ``flat``: the target's flat in the same file; ``scan``: the grey picture ``png``, base64, in
    which level 128 is even ground and 200 levels above it twice its brightness. ``doubled_px``: effect of a
    doubled picture on good spots, px; 95 % of them show less.
    """

    hot_px: Annotated[_Pixels, At("hot.permanent")]
    sometimes_hot_px: Annotated[_Pixels, At("hot.intermittent")]
    texture: Annotated[Literal["flat", "scan"] | None, At("source")]
    png: Annotated[str | None, At(""), PlainSerializer(_scan_png)]
    doubled_px: Annotated[float | None, Field(ge=0, le=100), At("usual_doubled_px")] = None


def _fingerprint_of(table: FingerprintTable, info: ValidationInfo) -> Fingerprint | None:
    """Build the fingerprint, if the target that it belongs to has a size; refuse inconsistent values."""
    if not {"width", "height"} <= info.data.keys():
        return None
    width, height, flat = info.data["width"], info.data["height"], info.data.get("flat")
    if (table.texture == "scan") != (table.png is not None):
        raise complaint((("png",), "belongs to texture 'scan' and to no other"))
    hot = HotPixels(places_of(table.hot_px), places_of(table.sometimes_hot_px))
    for key, pixels in (("hot_px", hot.permanent), ("sometimes_hot_px", hot.intermittent)):
        if (pixels >= (width, height)).any():
            raise complaint(((key,), f"a pixel lies outside {width} × {height}"))
    texture = None
    if table.png is not None:
        levels = _levels_of(table.png, width, height)
        texture = Texture((levels.astype(np.float32) - _ZERO_LEVEL) / np.float32(_LEVELS_PER_UNIT))
    elif table.texture == "flat":
        if flat is None:
            raise complaint((("texture",), "'flat', but the target has none"))
        texture = Texture.of_flat(flat)
    return Fingerprint(hot, texture, table.texture, table.doubled_px)


FingerprintInFile = Annotated[Fingerprint, held_in(FingerprintTable, Fingerprint, _fingerprint_of)]


def png_text(levels: npt.NDArray[np.uint8]) -> str:
    """A grey picture (rows, columns) as a PNG in base64."""
    return base64.b64encode(cv2.imencode(".png", levels)[1].tobytes()).decode("ascii")


def _levels_of(
    text: str, width: int, height: int, place: tuple[str, ...] = ("png",)
) -> npt.NDArray[np.uint8]:
    """Decode the grey picture at a place of a table."""
    try:
        png = base64.b64decode(text, validate=True)
        return np.asarray(decode_png(png, width, height, bits=8), dtype=np.uint8)
    except ValueError as error:
        raise complaint((place, str(error))) from error


_MIN_SHAPE_DETERMINANT = 0.01
"""Minimum determinant of a noise shape of trace 2; a spot 20 times as long as wide has less."""

Pixels = Annotated[float, Field(ge=-100_000, le=100_000)]
"""Coordinate in or near a picture of at most 20 000 px."""
PositivePixels = Annotated[float, Field(gt=0, le=1000)]
"""Misfit, noise or limit, px."""
Coefficient = Annotated[float, Field(ge=-1e7, le=1e7)]
"""Position in px times the root of the grid's number of nodes: the Gram polynomials are orthonormal."""
UpTo1000 = Annotated[float, Field(ge=0, le=1000)]
Side = Annotated[int, Field(ge=16, le=20_000)]


def table_of(record: type, **given: Any) -> GetPydanticSchema:
    """Read a dataclass from a table with its fields and their limits, all of which a file must have.

    ``given`` contains the types of fields that are not plain ones; with a default, of those that it may lack.
    """
    types = get_type_hints(record, include_extras=True) | given
    fields: dict[str, Any] = {
        name: type_ if isinstance(type_, tuple) else (type_, ...) for name, type_ in types.items()
    }
    return held_in(create_model(f"{record.__name__}Table", __base__=Table, **fields), record)


_Spot = Annotated[
    SpotReference,
    table_of(
        SpotReference,
        shape=Annotated[ShapeReference, table_of(ShapeReference)] | None,
        light=(Annotated[LightReference, table_of(LightReference)] | None, None),
    ),
]


def _written_spot(spot: SpotReference, write: SerializerFunctionWrapHandler) -> Any:
    return None if spot == UNKNOWN_SPOT else write(spot)


SpotInFile = Annotated[
    _Spot | None, AfterValidator(lambda spot: spot or UNKNOWN_SPOT), WrapSerializer(_written_spot)
]
"""Figures of the laser spots; null: not known."""

_Share = Annotated[float, Field(ge=0, le=2)]
_Mixed = Annotated[float, Field(ge=-1, le=1)]


def _checked_shape(shape: tuple[float, float, float]) -> tuple[float, float, float]:
    uu, uv, vv = shape
    if not (abs(uu + vv - 2) < 1e-6 and uu * vv - uv * uv >= _MIN_SHAPE_DETERMINANT):
        raise ValueError("is not a covariance (uu, uv, vv) with trace 2")
    return shape


_Rows = Annotated[list[list[Coefficient]], PlainSerializer(listed)]


class MapTable(Table):
    """Map of a target, or the second map that checks it."""

    basis: Literal["gram"]
    model: Model
    x_axis: Annotated[Axis, table_of(Axis)]
    y_axis: Annotated[Axis, table_of(Axis)]
    degree: tuple[Annotated[int, Field(ge=0, le=100)], Annotated[int, Field(ge=0, le=100)]]
    spectrum_u_px: Annotated[_Rows, At("spectra.0")]
    spectrum_v_px: Annotated[_Rows, At("spectra.1")]
    spread_u_px: Annotated[_Rows, At("covariance_factor_px.0")]
    spread_v_px: Annotated[_Rows, At("covariance_factor_px.1")]
    noise_px: PositivePixels
    noise_shape: Annotated[tuple[_Share, _Mixed, _Share], AfterValidator(_checked_shape)] = ROUND
    hull_mm: Annotated[list[tuple[Millimetres, Millimetres]], Field(min_length=3), *ARRAY]
    margin_mm: UpTo1000 = 0.0
    beyond_px_per_mm: UpTo1000 = 0.0


def _map_of(table: MapTable, _: ValidationInfo) -> TensorMap:
    values = attributes_of(table)
    columns, rows = (degree + 1 for degree in values.pop("degree"))
    spectra, spread = (
        [values.pop(f"{name}.{along}") for along in range(2)] for name in ("spectra", "covariance_factor_px")
    )
    errors = len(spread[0][0]) if spread[0] else 0
    return TensorMap(
        spectra=array_of("spectrum", spectra, (2, rows, columns)),
        covariance_factor_px=array_of("spread", spread, (2, rows * columns, errors)),
        **values,
    )


MapInFile = Annotated[TensorMap, held_in(MapTable, TensorMap, _map_of)]


class _Learnt(Table):
    png: Annotated[str, At("share"), PlainSerializer(png_text)]
    unlearnt_px: PositivePixels
    diameter_px: Annotated[float, Field(gt=0, le=20_000)]


class _Flat(Table):
    source: Source
    origin: Origin = Origin.CAMERA
    png: Annotated[str, At("levels"), PlainSerializer(png_text)]
    learnt: Annotated[_Learnt | None, At("learnt", or_absent=True)] = None

    @model_validator(mode="after")
    def _check_learnt(self) -> Self:
        if (self.source == "service") != (self.learnt is not None):
            raise complaint((("learnt",), "belongs to source = 'service'"))
        return self


def _flat_of(table: _Flat, info: ValidationInfo) -> Flat | None:
    """Build the flat, if the target that it belongs to has a size."""
    if not {"width", "height"} <= info.data.keys():
        return None
    levels = _levels_of(table.png, info.data["width"], info.data["height"])
    learnt = None
    if table.learnt is not None:
        rows, columns = (info.data[side] // BLOCK_PX for side in ("height", "width"))
        share = _levels_of(table.learnt.png, columns, rows, ("learnt", "png"))
        learnt = Learnt(share, table.learnt.unlearnt_px, table.learnt.diameter_px)
    return Flat(levels, table.source, table.origin, learnt)


FlatInFile = Annotated[Flat, held_in(_Flat, Flat, _flat_of)]
