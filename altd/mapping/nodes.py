"""The nodes of a target: where they are, and where a camera sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from altd.records import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Places (n, 2) mm, where they are seen (n, 2) px, and each one's relative sigma (n,).

    The relative sigma says by how much one node scatters more than an ordinary one.
    """

    mm: FloatArray
    px: FloatArray
    relative_sigma: FloatArray

    @classmethod
    def ordinary(cls, mm: FloatArray, px: FloatArray) -> Nodes:
        """Nodes of which none scatters more than another."""
        return cls(mm, px, np.ones(len(mm)))

    def __len__(self) -> int:
        return len(self.mm)

    def select(self, rows: npt.NDArray[np.intp]) -> Nodes:
        """These alone."""
        return Nodes(self.mm[rows], self.px[rows], self.relative_sigma[rows])

    def without(self, rows: npt.NDArray[np.intp]) -> Nodes:
        """All but these."""
        return self.select(np.delete(np.arange(len(self)), rows))
