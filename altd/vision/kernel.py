"""Compiled code for what the locating of a spot spends most time on (``kernel.c``), called by ctypes.

It is built with altd where there is a C compiler (``hatch_build.py``). Elsewhere numpy does the same, four
times as slow; ``description`` tells which of them runs.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_double, c_int, c_void_p
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from altd.records import FloatArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from altd.vision.blocks import Blocks
    from altd.vision.misfit import Residuals

FILE = Path(__file__).with_name("libkernel.so")
_PARAMETERS = 10
_RINGS = 5


class FitLimits(ctypes.Structure):
    """``struct fit_limits``."""

    _fields_ = [
        ("initial_contrast2", c_double),
        ("min_contrast2", c_double),
        ("max_contrast2", c_double),
        ("min_peak_share_for_contrast", c_double),
        ("converged_contrast2", c_double),
        ("converged_sigmas", c_double),
        ("converged_shape", c_double),
        ("late_converged_sigmas", c_double),
        ("max_step", c_double),
        ("min_order", c_double),
        ("max_order", c_double),
        ("order_prior_sigma", c_double),
        ("order_held_sigma", c_double),
        ("max_iterations", c_int),
        ("late_iteration", c_int),
    ]


class Rings(ctypes.Structure):
    """``struct rings``."""

    _fields_ = [
        ("levels", c_double * (_RINGS + 1)),
        ("ridge_share", c_double),
        ("first", c_int * _RINGS),
        ("last", c_int * _RINGS),
        ("min_blocks", c_int),
    ]


class FoundMisfit(ctypes.Structure):
    """``struct misfit``."""

    _fields_ = [
        ("chi2", c_double),
        ("degrees_of_freedom", c_double),
        ("centre_uu_px2", c_double),
        ("centre_uv_px2", c_double),
        ("centre_vv_px2", c_double),
        ("pattern_px2", c_double),
    ]


class _Blocks(ctypes.Structure):
    _fields_ = [("n", c_int), *((f"array_{number}", c_void_p) for number in range(8))]


class _Fitted(ctypes.Structure):
    _fields_ = [
        *((name, c_void_p) for name in ("rows", "noise_variance", "texture_variance", "spot", "weighted")),
        ("centre_variance", c_double),
        ("contrast2", c_double),
    ]


class _Residuals(ctypes.Structure):
    _fields_ = [("n", c_int), *((f"array_{number}", c_void_p) for number in range(10))]


def _loaded() -> tuple[ctypes.CDLL | None, str]:
    try:
        library = ctypes.CDLL(str(FILE))
        library.altd_fit.argtypes = [
            *(POINTER(FitLimits), POINTER(_Blocks), c_double, c_int, c_void_p),
            POINTER(_Fitted),
        ]
        library.altd_misfit.argtypes = [POINTER(Rings), POINTER(_Residuals), c_double, POINTER(FoundMisfit)]
    except OSError as error:
        return None, "numpy: " + (f"{error}" if FILE.exists() else "altd was built without a C compiler")
    return library, "compiled"


_library, description = _loaded()


def is_compiled() -> bool:
    """Whether compiled code runs."""
    return _library is not None


def fit(
    limits: FitLimits, blocks: Blocks, state: Sequence[float], rise: float, order_free_iteration: int
) -> tuple[list[float], float, FloatArray, FloatArray, FloatArray, float, FloatArray] | None:
    """``fit.solve_by_numpy``: the values of a ``Solution`` in their order; None when it does not converge."""
    arrays = [
        _packed(values)
        for values in (
            *(blocks.light, blocks.monomials, blocks.half_moments, blocks.f1, blocks.f2),
            *(blocks.read_variance, blocks.shot_variance, blocks.texture_variance),
        )
    ]
    n = blocks.light.size
    room, found = np.empty((_PARAMETERS + 5, n)), np.array(state)
    rows = [
        _address(room) + number * room.strides[0] for number in (0, *range(_PARAMETERS + 1, _PARAMETERS + 5))
    ]
    fitted = _Fitted(*rows)
    assert _library is not None  # noqa: S101  asked before
    is_found = _library.altd_fit(
        *(byref(limits), byref(_Blocks(n, *map(_address, arrays))), rise, order_free_iteration),
        *(_address(found), byref(fitted)),
    )
    if not is_found:
        return None
    noise, texture, spot = room[_PARAMETERS + 1 : _PARAMETERS + 4]
    return (
        found.tolist(),
        fitted.centre_variance,
        room[: _PARAMETERS + 1],
        noise,
        texture,
        fitted.contrast2,
        spot,
    )


def misfit(rings: Rings, of: Residuals, texture_contrast: float) -> FoundMisfit | None:
    """``misfit.misfit_by_numpy``; None where there are too few blocks to tell."""
    arrays = [
        _packed(values)
        for values in (
            *(of.light, of.derivatives, of.prior, of.prior_gradient, of.noise_variance, of.texture_variance),
            *(
                of.irradiance,
                of.spot_light,
                of.flat_light,
                np.ascontiguousarray(of.direction).view(np.float64),
            ),
        )
    ]
    found = FoundMisfit()
    assert _library is not None  # noqa: S101  asked before
    of_n = _Residuals(of.light.size, *map(_address, arrays))
    return found if _library.altd_misfit(byref(rings), byref(of_n), texture_contrast, byref(found)) else None


def _packed(values: np.ndarray[Any, Any] | None) -> FloatArray | None:
    return None if values is None else np.ascontiguousarray(values, dtype=np.float64)


def _address(values: FloatArray | None) -> int | None:
    return None if values is None else values.__array_interface__["data"][0]
