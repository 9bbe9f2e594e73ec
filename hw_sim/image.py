"""Images of the simulator: light, electrons or shares of a pixel, before conversion to grey values."""

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
"""Image of shape (rows, columns)."""
