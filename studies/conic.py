"""Section 2.1.2: an ellipse through the points of a contour, under constraint C1 and under C2."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from altd.records import FloatArray
from altd.vision.ellipse import fit_conic
from studies.bench import rms
from studies.plot import OURS, THESIS, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Section 2.1.2: constraints C1 and C2 of a fitted ellipse"
QUESTION = "What does the constraint b² − 4ac = α do for the centre that a² + b² + c² = 1 does not?"

AXES = (1.2, 0.8)
"""Semiaxes; the unit is about the radius of a spot."""
SHARES = (1.0, 0.5, 0.25)
NOISES = (0.005, 0.02, 0.05)
POINTS, DRAWS, SEED = 64, 1000, 212


def fit_c2(x: FloatArray, y: FloatArray) -> tuple[FloatArray, bool]:
    """Centre (2,) of the conic through points (n,) with a² + b² + c² = 1, and whether it is an ellipse.

    Least squares of the algebraic distances, with the linear and constant terms eliminated as in
    ``fit_conic``: the quadratic terms are then the right singular vector of the smallest singular value.
    """
    squares = np.stack([x * x, x * y, y * y], axis=1)
    rest = np.stack([x, y, np.ones_like(x)], axis=1)
    eliminated = np.linalg.lstsq(rest, squares, rcond=None)[0]
    a, b, c = np.linalg.svd(squares - rest @ eliminated)[2][-1]
    d, e, _ = -eliminated @ (a, b, c)
    centre = -np.linalg.solve(np.array([[2 * a, b], [b, 2 * c]]), (d, e))
    return centre, bool(4 * a * c > b * b)


def run(progress: Progress) -> Result:
    """Noisy points on a whole ellipse and on parts of it."""
    progress("conic")
    found = {(share, noise): _values(share, noise) for share in SHARES for noise in NOISES}
    whole, part = found[SHARES[0], NOISES[1]], found[SHARES[-1], NOISES[1]]
    return Result(
        of="part of the ellipse, noise",
        thesis_source="Sec. 2.1.2, Eq. 2.2–2.6, constraints C1 and C2; no figures are printed",
        differs="the source names both constraints and does not compare them",
        columns=(
            Column("C1: centre rms", judged=False),
            Column("C2: centre rms", judged=False),
            Column("C1: no ellipse, %", 1, judged=False),
            Column("C2: no ellipse, %", 1, judged=False),
        ),
        rows=tuple(Row(f"{100 * share:g} %, {noise:g}", values) for (share, noise), values in found.items()),
        headline=(
            f"On a whole ellipse both constraints find the same centre, to {whole[0]:.4f} and {whole[1]:.4f} "
            f"radii; on a quarter of it C2 makes {part[3]:.1f} % of the conics a hyperbola, C1 none."
        ),
        text=f"""
{POINTS} points lie on a part of an ellipse with the semiaxes {AXES[0]:g} and {AXES[1]:g}, with noise along
both axes; {DRAWS} draws each. The error is that of the centre, rms of x and y over the conics that are
ellipses. C1 is altd's `fit_conic` ([second localiser](../locate.md)), which is given closed contours only; C2
is in this study only.
""",
        figure=_figure(found),
        caption="Error of the centre by noise, for a whole ellipse, half of it and a quarter",
    )


def _values(share: float, noise: float) -> tuple[float, ...]:
    """Rms of the centres by C1 and by C2 over their ellipses, and how many are none, %."""
    rng = np.random.default_rng([SEED, round(1000 * share), round(1000 * noise)])
    by_c1, by_c2 = list[FloatArray](), list[FloatArray]()
    for _ in range(DRAWS):
        angle = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * share * np.arange(POINTS) / POINTS
        x, y = np.array(AXES)[:, None] * (np.cos(angle), np.sin(angle)) + rng.normal(0.0, noise, (2, POINTS))
        middle = np.array([x.mean(), y.mean()])
        x, y = x - middle[0], y - middle[1]
        if (conic := fit_conic(x, y)) is not None:
            by_c1.append(middle + np.array([conic.x, conic.y]))
        centre, is_ellipse = fit_c2(x, y)
        if is_ellipse:
            by_c2.append(middle + centre)
    return (
        rms(np.array(by_c1)),
        rms(np.array(by_c2)),
        100.0 * (1.0 - len(by_c1) / DRAWS),
        100.0 * (1.0 - len(by_c2) / DRAWS),
    )


def _figure(found: Mapping[tuple[float, float], tuple[float, ...]]) -> Figure:
    figure, (axis,) = panels(1, 1, width=6.0, height=3.4)
    for share, style in zip(SHARES, ("-", "--", ":"), strict=True):
        for at, colour in enumerate((OURS, THESIS)):
            label = f"C{at + 1}, {100 * share:g} %"
            errors = [found[share, noise][at] for noise in NOISES]
            axis.loglog(NOISES, errors, "o" + style, color=colour, ms=4, label=label)
    axis.set(xlabel="noise of a point, radii", ylabel="rms of the centre, radii")
    axis.legend(ncols=2)
    return figure
