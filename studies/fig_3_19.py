"""Figs. 3.19 and 3.20, and App. A.4: covariance of the basis, and what fails with Vandermonde's."""

from itertools import product

import numpy as np
from matplotlib.figure import Figure

from altd.calibration.fitting import fit_nodes
from altd.mapping.camera_model import disc_moment_mm2, light_centre_shift_px
from altd.mapping.grid import convex_hull_mm
from altd.mapping.inverse import InverseMap
from altd.mapping.nodes import Nodes
from altd.mapping.polynomials import gram_basis
from altd.mapping.tensor_map import Fit, fit_tensor_maps
from altd.records import FloatArray
from hw_sim.lens import HEIGHT_PX, WIDTH_PX, Lens
from hw_sim.plate import LED_DIAMETER_MM
from studies.plot import GREY, OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row
from studies.table_3_2 import LENSES, NOISE_PX, SEEDS, simulated_plates

TITLE = "Figs. 3.19, 3.20 and A.4: covariance and conditioning of the basis"
QUESTION = "How does noise of the nodes reach the mapped places, and why do Vandermonde's polynomials fail?"

GRIDS = ((5, 7), (10, 14))
DEGREES = (2, 3)
DRAWS, SEED = 20_000, 219
TOTAL_DEGREES = (2, 3, 4)
"""Those that the thesis' plausibility check offers (App. A.4)."""
ACROSS = 31
CHOICES, NODES = 2, (7, 5)
"""Draws of noise for a lens, each of which a degree is chosen for, and the nodes along x and y."""


def run(progress: Progress) -> Result:
    """Covariances by formula and by drawing noise; errors of four maps on the lenses of Table 3.2."""
    progress("fig-3.19: covariance")
    rows = []
    for grid, degree in product(GRIDS, DEGREES):
        covariance = node_covariance(grid, degree)
        variance = np.diag(covariance)
        drawn = _drawn_variance(grid, degree)
        rows.append(
            Row(
                f"{grid[0]} × {grid[1]}, degree {degree}",
                (
                    (degree + 1) ** 2 / (grid[0] * grid[1]),
                    float(variance.mean()),
                    float(variance.min()),
                    float(variance.max()),
                    100 * float(np.max(np.abs(drawn / variance - 1))),
                ),
            )
        )
    errors: dict[str, FloatArray] = {}
    chosen: dict[str, FloatArray] = {}
    for lenses in LENSES:
        progress(f"fig-3.19: {lenses.name} mm")
        plates = [plate for seed in SEEDS for plate in simulated_plates(seed, lenses)]
        errors[lenses.name] = np.array([_errors_mm(*plate) for plate in plates])
        rng = np.random.default_rng(SEED)
        chosen[lenses.name] = np.array(
            [_by_degree_mm(leds_mm, lens, rng) for leds_mm, _, lens in plates for _ in range(CHOICES)]
        )
    choices = "; ".join(
        f"{name}: {of[:, 0].mean():.4f} and {of[:, 1].mean():.4f} mm, {of[:, 2].mean():.4f} mm, "
        f"{100 * np.mean(of[:, 0] == of[:, 1]):.0f} %"
        for name, of in chosen.items()
    )
    worst = max(float(np.max(np.abs(of[:, 2] / of[:, 3] - 1))) for of in errors.values())
    below = 10.0 ** np.ceil(np.log10(100 * worst))  # a decade: the rest depends on the computer's rounding
    conditions = {degree: _conditions(degree) for degree in range(1, 5)}  # of 5 only the decade is exact
    raw, centred, gram = conditions[4]
    normal_mm = [float(of[:, 4].mean()) for of in errors.values()]
    figures = "; ".join(
        f"{name}: " + ", ".join(f"{value:.4f}" for value in of.mean(axis=0)[[0, 1, 2, 5]])
        for name, of in errors.items()
    )
    return Result(
        of="grid, degree on both axes",
        thesis_source="Sec. 3.5.6, Figs. 3.19 and 3.20 (pictures without numbers), Eqs. 3.43–3.53, App. A.4",
        differs=(
            "the thesis names the balance of covariance and misfit and prints no rule for it; altd chooses "
            "the degree by cross-validation ([decision 4](../decisions/0004-measuring.md))"
        ),
        columns=(
            Column("(d + 1)² / nodes", judged=False),
            Column("mean variance", judged=False),
            Column("smallest", judged=False),
            Column("largest, at the corners", judged=False),
            Column("largest difference to drawn noise, %", 1, judged=False),
        ),
        rows=tuple(rows),
        headline=(
            "The covariance of the basis agrees with drawn noise. At short focal lengths the polynomial of "
            "A.4 fails by its form, not by the condition of Vandermonde's matrix."
        ),
        text=f"""
*Covariance.* The nodes have σ = 1 in x. The fitted nodes have the covariance BₓBₓᵀ ⊗ B_yB_yᵀ, since the
basis is orthonormal. Its mean variance is the number of coefficients over the number of nodes; the corners
have the largest. A higher degree passes more noise, a denser grid less. {DRAWS:,} draws of noise, fitted by
least squares with plain powers, have these variances within their own scatter, about 1 % each.

*Degree.* With the degree the misfit falls and the covariance grows. Their sum, the error at the nodes, is
estimated by the mean square of the residuals − σ² (1 − 2 K/n), with K coefficients for n nodes (Mallows' Cₚ);
the balance is the degree where it is smallest. It needs σ, altd's generalised cross-validation does not. With
{NODES[0]} × {NODES[1]} nodes and {NOISE_PX:g} px of noise, {CHOICES} draws for each lens: mean errors between
the nodes by balance and by cross-validation, by the best degree in hindsight, and how often both choose the
same degree: {choices}.

*App. A.4* reports that Matlab's polynomial, with Vandermonde's matrix up to degree 4, degrades below
f = 5.7 mm. We fit px → mm to the plates of Table 3.2. Mean errors between the LEDs in mm, for total degree
2, 3, 4 and altd's map: {figures}. With pixels as they are, the design of degree 4 has the condition number
{raw:.0e}; centred and scaled it has {centred:.0f}, Gram's polynomials on their nodes {gram:.0f}. In
double precision by orthogonal decomposition this changes no error by more than {below:g} %; by
normal equations in pixels the means are {normal_mm[0]:.4f} mm at f = 12 and {normal_mm[-1]:.4f} mm at
f = 3.6. So conditioning is not the cause: a polynomial of total degree 4 from px to mm does not follow the
distortion.
""",
        figure=_figure(errors, conditions),
        caption=(
            "Covariance of the fitted nodes, stacked column by column (Eq. 3.49), and right: mean error "
            "between the LEDs by focal length, condition of the design by degree"
        ),
    )


def _outer(grid: tuple[int, int], degree: int) -> FloatArray:
    """B of all nodes, stacked column by column: (nodes, (degree + 1)²)."""
    across, along = (gram_basis(-1 + (2 * np.arange(1, n + 1) - 1) / n, n, degree) for n in grid[::-1])
    return np.asarray(np.kron(across, along), dtype=np.float64)


def node_covariance(grid: tuple[int, int], degree: int) -> FloatArray:
    """Covariance (nodes, nodes) of the fitted nodes of a grid (rows, columns) for σ = 1 (Eq. 3.53)."""
    basis = _outer(grid, degree)
    return basis @ basis.T


def _drawn_variance(grid: tuple[int, int], degree: int) -> FloatArray:
    """Variances of the fitted nodes over draws of noise, by least squares with powers of plain indices."""
    down, right = np.meshgrid(np.arange(grid[0]), np.arange(grid[1]), indexing="ij")
    powers = range(degree + 1)
    design = np.stack(
        [down.T.ravel() ** i * right.T.ravel() ** j for i, j in product(powers, powers)], axis=1
    )
    noise = np.random.default_rng(SEED).normal(size=(design.shape[0], DRAWS))
    fitted = design @ np.linalg.lstsq(design.astype(float), noise, rcond=None)[0]
    return np.asarray(fitted.var(axis=1))


def _total(points: FloatArray, degree: int) -> FloatArray:
    """Monomials of points (n, 2) up to a total degree, (n, (degree + 1)(degree + 2)/2)."""
    u, v = points.T
    return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)


def _by_degree_mm(leds_mm: FloatArray, lens: Lens, rng: np.random.Generator) -> tuple[float, float, float]:
    """Mean error between noisy nodes of the degree by balance, by cross-validation, and of the best one."""
    nodes_px = np.stack(lens.project(*leds_mm.T), axis=-1) + rng.normal(0.0, NOISE_PX, leds_mm.shape)
    fits = fit_tensor_maps(leds_mm, nodes_px, convex_hull_mm(leds_mm))
    places_mm, places_px = _between(leds_mm, lens)
    errors_mm = [
        float(np.linalg.norm(InverseMap(fit.map).to_mm(places_px)[0] - places_mm, axis=1).mean())
        for fit in fits
    ]
    balanced = np.argmin([balance_px2(fit, NOISE_PX) for fit in fits])
    validated = np.argmin([fit.gcv_px for fit in fits])
    return errors_mm[balanced], errors_mm[validated], float(np.nanmin(errors_mm))


def balance_px2(fit: Fit, noise_px: float) -> float:
    """Estimated mean square error at the nodes, by misfit and covariance, for nodes with this noise."""
    share = fit.effective_parameters / fit.residuals_px.size
    return float(np.mean(np.square(fit.residuals_px))) - noise_px**2 * (1.0 - 2.0 * share)


def _between(leds_mm: FloatArray, lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) mm on a dense grid between the LEDs, and in the picture, px."""
    low, high = leds_mm.min(axis=0), leds_mm.max(axis=0)
    axes = [np.linspace(low[k], high[k], ACROSS + 2)[1:-1] for k in (0, 1)]
    places_mm = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return places_mm, np.stack(lens.project(*places_mm.T), axis=-1)


def _errors_mm(leds_mm: FloatArray, leds_px: FloatArray, lens: Lens) -> FloatArray:
    """Mean errors between the LEDs: degree 2, 3, 4, 4 scaled, 4 by normal equations, altd's map."""
    places_mm, places_px = _between(leds_mm, lens)
    size = (WIDTH_PX, HEIGHT_PX)
    first = fit_nodes(Nodes.ordinary(leds_mm, leds_px), size, 0).fit.map
    centres_px = leds_px + light_centre_shift_px(first.to_px, leds_mm, -disc_moment_mm2(LED_DIAMETER_MM))
    found = [_polynomial(centres_px, leds_mm, places_px, degree) for degree in TOTAL_DEGREES]
    middle, half = centres_px.mean(axis=0), np.ptp(centres_px, axis=0) / 2
    found.append(_polynomial((centres_px - middle) / half, leds_mm, (places_px - middle) / half, 4))
    design = _total(centres_px, 4)
    normal = np.linalg.solve(design.T @ design, design.T @ leds_mm)
    found.append(np.asarray(_total(places_px, 4) @ normal))
    ours = fit_nodes(Nodes.ordinary(leds_mm, centres_px), size, 0).fit.map
    found.append(InverseMap(ours).to_mm(places_px)[0])
    return np.array([np.linalg.norm(at - places_mm, axis=1).mean() for at in found])


def _polynomial(at: FloatArray, values: FloatArray, wanted_at: FloatArray, degree: int) -> FloatArray:
    coefficients = np.linalg.lstsq(_total(at, degree), values, rcond=None)[0]
    return np.asarray(_total(wanted_at, degree) @ coefficients)


def _conditions(degree: int) -> tuple[float, float, float]:
    """Of a total degree in pixels and centred and scaled, on 10 × 14 nodes, and of Gram's products."""
    down, right = np.meshgrid(np.linspace(-1, 1, 10), np.linspace(-1, 1, 14), indexing="ij")
    nodes = np.column_stack([right.ravel(), down.ravel()])
    raw = _total((nodes + 1) * (WIDTH_PX / 2, HEIGHT_PX / 2), degree)
    designs = (raw, _total(nodes, degree), _outer((10, 14), degree))
    first, second, third = (float(np.linalg.cond(design)) for design in designs)
    return first, second, third


def _figure(errors: dict[str, FloatArray], conditions: dict[int, tuple[float, float, float]]) -> Figure:
    figure, axes = panels(2, 3, width=11.0, height=6.6)
    for axis, (grid, degree) in zip(
        (axes[0], axes[1], axes[3], axes[4]), product(GRIDS, DEGREES), strict=True
    ):
        covariance = node_covariance(grid, degree)
        shown = axis.imshow(covariance, cmap="cividis", interpolation="nearest")
        axis.grid(visible=False)
        axis.set(title=f"{grid[0]} × {grid[1]} nodes, degree {degree}", xlabel="node", ylabel="node")
        figure.colorbar(shown, ax=axis, shrink=0.8)
    drawn = (
        (0, "degree 2", "v:", GREY),
        (1, "degree 3", "s--", THIRD),
        (2, "degree 4", "o-", THESIS),
        (5, "altd's map", "D-", OURS),
    )
    for k, name, style, colour in drawn:
        means = [of[:, k].mean() for of in errors.values()]
        axes[2].plot(range(len(LENSES)), means, style, color=colour, ms=4, lw=1.3, label=name)
    axes[2].set_yscale("log")
    axes[2].set_xticks(range(len(LENSES)), [lenses.name.replace(", ", "\n") for lenses in LENSES])
    axes[2].set(ylabel="mean error between the LEDs, mm", title="px → mm by total degree (A.4)")
    axes[2].legend(fontsize=7)
    for k, (name, colour) in enumerate(
        zip(("pixels", "centred, scaled", "Gram"), (THESIS, THIRD, OURS), strict=True)
    ):
        axes[5].plot(
            list(conditions), [of[k] for of in conditions.values()], "o-", color=colour, ms=4, label=name
        )
    axes[5].set_yscale("log")
    axes[5].set(xlabel="degree", ylabel="condition number", title="Condition of the design")
    axes[5].legend(fontsize=7)
    return figure
