"""Compiled code (``kernel.c``) for the slowest parts of locating a spot, called by ctypes.

It is built with altd if there is a C compiler (``hatch_build.py``). Otherwise numpy does the same, four times
as slow; ``description`` names the one in use.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_double, c_int, c_void_p
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from altd.records import FloatArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from altd.vision.blocks import Blocks
    from altd.vision.fit import FitState

FILE = Path(__file__).with_name("libkernel.so")
_FIT_ROWS = 14
_RINGS = 5
_MAX_PATTERNS = 27


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
        ("centre_uu", c_double),
        ("centre_uv", c_double),
        ("centre_vv", c_double),
        ("pattern_variance", c_double),
        ("scores", c_double * (2 * _MAX_PATTERNS)),
    ]


def _loaded() -> tuple[ctypes.CDLL | None, str]:
    try:
        library = ctypes.CDLL(str(FILE))
        library.altd_fit.argtypes = [
            *(POINTER(FitLimits), c_int, c_int, c_void_p, c_double, c_int),
            *(c_void_p, c_void_p, POINTER(c_double), POINTER(c_double)),
        ]
        library.altd_misfit.argtypes = [
            *(POINTER(Rings), c_int, c_void_p, c_void_p, c_void_p, c_double, c_double, c_double),
            POINTER(FoundMisfit),
        ]
    except OSError as error:
        return None, "numpy: " + (f"{error}" if FILE.exists() else "altd was built without a C compiler")
    return library, "compiled"


_library, description = _loaded()


def is_compiled() -> bool:
    """Return whether compiled code runs."""
    return _library is not None


def fit(
    limits: FitLimits, blocks: Blocks, state: Sequence[float], rise: float, order_free_iteration: int
) -> tuple[list[float], FloatArray, float, float] | None:
    """Run ``fit.solve_by_numpy`` compiled: the values of a ``FitState`` in order, None if not converged."""
    count = blocks.rows.shape[1]
    given, found = _packed(blocks.rows), np.array(state, np.float64)
    rows = np.empty((_FIT_ROWS + 1, count))
    centre_variance, contrast2 = c_double(), c_double()
    assert _library is not None  # noqa: S101  asked before
    is_found = _library.altd_fit(
        *(byref(limits), count, blocks.has_moments, _address(given), rise, order_free_iteration),
        *(_address(found), _address(rows), byref(centre_variance), byref(contrast2)),
    )
    return (found.tolist(), rows[:_FIT_ROWS], centre_variance.value, contrast2.value) if is_found else None


def misfit(
    rings: Rings, blocks: Blocks, solution: FitState, rise: float, order_sigma: float, texture_contrast: float
) -> FoundMisfit | None:
    """Run ``misfit.misfit_by_numpy`` compiled; None if there are too few blocks."""
    given, state, rows = map(_packed, (blocks.rows, np.array(solution.state), solution.rows))
    if given.shape[1] != rows.shape[1]:
        raise ValueError(f"{given.shape[1]} blocks, but a fit of {rows.shape[1]}")
    found = FoundMisfit()
    assert _library is not None  # noqa: S101  asked before
    is_found = _library.altd_misfit(
        *(byref(rings), rows.shape[1], _address(given), _address(state), _address(rows)),
        *(rise, order_sigma, texture_contrast, byref(found)),
    )
    return found if is_found else None


def _packed(values: FloatArray) -> FloatArray:
    """Return the values as compiled code reads them: doubles, row after row."""
    return np.ascontiguousarray(values, np.float64)


def _address(values: FloatArray) -> int:
    address: int = values.__array_interface__["data"][0]
    return address
