"""Images of the simulator: light, electrons or shares of a pixel, before they become grey values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
"""(rows, columns)."""
