"""Fig. 3.5: what 0.1 mm of error in the spots does to yaw and pitch."""

import math

import numpy as np
import numpy.typing as npt

from altd.instruments.beam.solver import fit_beam
from altd.records import TargetPoint
from studies.plot import GREY, OURS, THESIS, THIRD, panels, plain_decades
from studies.result import Column, Progress, Result, Row

TITLE = "Fig. 3.5: angle from displacement"
QUESTION = "How well must a spot be located for yaw and pitch to be good to ±0.05°?"

DISTANCE_MM = 280.0
SIGMA_MM = 0.1
REQUIRED_DEG = 0.05
ITERATIONS = 10_000
THESIS_DEG, THESIS_SHARE = 0.0288, 95.0
REACHED_MM = (0.04937, 0.018997)
"""Displacement accuracy of the front and of the rear target that the thesis reached later (Table 3.1)."""


def angle_sigma_deg(front_sigma_mm: float, rear_sigma_mm: float, slope: float = 0.0) -> float:
    """Closed form: atan((rear − front)/D) has σ = √(σ_f² + σ_r²)/D/(1 + slope²), to first order."""
    return math.degrees(math.hypot(front_sigma_mm, rear_sigma_mm) / DISTANCE_MM / (1.0 + slope**2))


def share_within(limit: float, sigma: float) -> float:
    """Share of a normal distribution within ± ``limit``."""
    return math.erf(limit / sigma / math.sqrt(2.0))


def monte_carlo_deg(
    sigma_mm: float, count: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float64], float]:
    """Yaw and pitch (count, 2) in ° that altd finds for a straight beam, and the sigma it states for them."""
    covariance = sigma_mm**2 * np.eye(4)
    one = np.eye(2)
    angles = np.empty((count, 2))
    for row, (front, rear) in enumerate(rng.normal(0.0, sigma_mm, size=(count, 2, 2))):
        points = [TargetPoint(float(x), float(y), one, sigma_mm**2 * one) for x, y in (front, rear)]
        beam = fit_beam((0.0, DISTANCE_MM), points, covariance)
        angles[row] = beam.yaw_deg, beam.pitch_deg
    return angles, beam.sigma_yaw_deg


def run(progress: Progress) -> Result:
    """Monte Carlo through altd's own beam, and the closed form."""
    progress("Monte Carlo")
    rng = np.random.default_rng(305)
    angles, stated = monte_carlo_deg(SIGMA_MM, ITERATIONS, rng)
    yaw, pitch = (float(sigma) for sigma in angles.std(axis=0, ddof=1))
    within = 100.0 * float(np.mean(np.abs(angles) <= REQUIRED_DEG))
    closed = angle_sigma_deg(SIGMA_MM, SIGMA_MM)
    closed_within = 100.0 * share_within(REQUIRED_DEG, closed)

    figure, (left, right) = panels(1, 2)
    left.hist(angles[:, 0], bins=60, density=True, color=OURS, alpha=0.55, label="yaw, altd, 10 000 beams")
    at = np.linspace(-0.12, 0.12, 241)
    left.plot(
        at,
        np.exp(-0.5 * (at / closed) ** 2) / closed / math.sqrt(2 * math.pi),
        color=THESIS,
        lw=1.4,
        label="closed form",
    )
    for limit in (-REQUIRED_DEG, REQUIRED_DEG):
        left.axvline(limit, color=GREY, lw=1.0, ls="--")
    left.text(
        REQUIRED_DEG + 0.003, left.get_ylim()[1] * 0.93, "required\n±0.05°", color=GREY, va="top", fontsize=8
    )
    left.set(xlabel="error of yaw, °", ylabel="density, 1/°", title="Spots with σ = 0.1 mm")
    left.set_ylim(top=1.25 * left.get_ylim()[1])
    left.legend(loc="upper left", fontsize=7)

    sigmas_mm = np.array([0.005, 0.01, 0.02, 0.05, 0.1, 0.2])
    drawn = [float(monte_carlo_deg(float(s), 1000, rng)[0].std()) for s in sigmas_mm]
    right.loglog(
        sigmas_mm,
        [angle_sigma_deg(s, s) for s in sigmas_mm],
        color=THESIS,
        lw=1.4,
        label="closed form √2 σ/D",
    )
    right.loglog(sigmas_mm, drawn, "o", color=OURS, ms=5, label="Monte Carlo, 1000 beams")
    right.loglog([0.1], [THESIS_DEG], "x", color="black", ms=8, mew=1.6, label="thesis, Fig. 3.5")
    right.axhline(0.002, color=THIRD, lw=1.0, ls="--")
    right.text(0.2, 0.0021, "0.002°: spots to 0.007 mm", color=THIRD, ha="right", va="bottom", fontsize=8)
    plain_decades(right.xaxis)
    plain_decades(right.yaxis)
    right.set(xlabel="σ of a spot, mm", ylabel="σ of yaw or pitch, °", title="Any other spot error")
    right.legend(loc="upper left", fontsize=7)

    reached = angle_sigma_deg(*REACHED_MM)
    return Result(
        of="way",
        thesis_source=(
            "Sec. 3.2.1, Fig. 3.5 (Monte Carlo, 10 000 iterations, D = 280 mm, σ = 0.1 mm on both targets)"
        ),
        differs="the closed form and the sigma that altd states are added",
        columns=(
            Column("σ of yaw, °", 4, judged=False),
            Column("σ of pitch, °", 4, judged=False),
            Column("within ±0.05°, %", 1, judged=False),
        ),
        rows=(
            Row("Monte Carlo", (yaw, pitch, within), (THESIS_DEG, THESIS_DEG, THESIS_SHARE)),
            Row("closed form", (closed, closed, closed_within)),
            Row("sigma that altd states", (stated, stated, 100.0 * share_within(REQUIRED_DEG, stated))),
        ),
        headline=(
            f"0.1 mm on each target gives {closed:.4f}°; Monte Carlo through altd's beam "
            f"{yaw:.4f}°, thesis 0.0288°."
        ),
        text=f"""
The closed form is σ = √2 · 0.1 mm / 280 mm. Monte Carlo draws spots on both targets;
`altd.instruments.beam.solver.fit_beam` computes the beam, as in the daemon. For a beam with a slope s the
angle's σ is smaller by 1 + s².

The share within ±0.05° is {closed_within:.1f} %; the thesis gives about 95 %, for which σ would be
0.0255°.

With the spots of the thesis (Table 3.1: 0.0494 mm in front, 0.0190 mm behind) the formula gives
{reached:.4f}°; its Table 3.4 has 0.0226° and 0.0183°. Map, stage and alignment added errors.
""",
        figure=figure,
        caption="Distribution of yaw for spots with σ = 0.1 mm, and σ of the angle against σ of the spots",
    )
