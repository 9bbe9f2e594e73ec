"""Fitted simulated lenses, and how far another map lies from the one that checks it."""

import numpy as np

from altd.calibration.fitting import TargetFit, fit_nodes
from altd.mapping.nodes import Nodes
from altd.mapping.tensor_map import TensorMap
from support.lenses import SIZE, LensKind, grid, make_lens, seen

NODES = grid()


def fitted_unit(kind: LensKind, seed: int) -> tuple[TargetFit, np.random.Generator]:
    rng = np.random.default_rng([seed, round(kind.focal_mm * 10)])
    return fit_nodes(Nodes.ordinary(NODES, seen(make_lens(kind, rng), NODES, rng)), SIZE, 0), rng


def difference_px(fitted: TargetFit, wrong: TensorMap, points_mm: np.ndarray) -> np.ndarray:
    px = wrong.to_px(points_mm)
    check = fitted.cross_check
    apart = [check.difference_px(x, y, u, v) for (x, y), (u, v) in zip(points_mm, px, strict=True)]
    return np.hypot(*np.transpose(apart))
