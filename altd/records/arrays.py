"""Arrays of numbers and of grey values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Vectors, matrices and covariances of the measuring chain."""

ComplexArray = npt.NDArray[np.complex128]
"""Waves and their amplitudes."""

PixelArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A frame's grey values, (rows, columns)."""
