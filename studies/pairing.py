"""Pairing of free-running cameras: whole frame sets by lag, jitter of the stamps and rate."""

from itertools import count, product

import numpy as np

from altd.config import Measuring
from altd.measuring.pairing import Pairer
from altd.records import FloatArray
from studies.plot import OURS, THESIS, THIRD, panels
from studies.result import Column, Progress, Result, Row

TITLE = "Pairing by time: lag, jitter and rate of free-running cameras"
QUESTION = "How much may the time stamps of two free-running cameras scatter?"

SEED = 66
RATES_HZ, JITTERS_MS, LAGS_PERIODS = (15, 20, 30), (0.0, 2.0, 4.0, 8.0, 15.0), (0.0, 0.25, 0.5, 0.75, 1.0)
EXPOSURES, START = 2000, 60
"""Exposures of a cell, and those at its start that do not count."""
DRIFT_PPM = 20.0
"""Difference of the two crystals."""
WRONG_PERIODS = 0.7
"""Distance of the true times in a wrong frame set. A lag of half a period has two right partners."""
BURSTS = ((1, 2), (2, 2), (2, 3), (1, 4))
"""Numbers of frames that each camera's driver delivers, and stamps, at once."""
BUDGET_FROM_MS, BUDGET_STEP_MS, BUDGET_WHOLE = 3.0, 0.5, 99.0
BEFORE = {
    (15, 0.0): (100.0, 100.0, 0.0, 100.0, 100.0, 0.0),
    (15, 2.0): (99.9, 99.8, 5.3, 99.9, 99.9, 0.0),
    (15, 4.0): (90.9, 91.8, 21.1, 91.4, 90.5, 0.0),
    (15, 8.0): (58.8, 60.5, 32.1, 59.0, 61.2, 0.0),
    (15, 15.0): (36.4, 34.6, 28.5, 33.9, 35.4, 1.80),
    (20, 0.0): (100.0, 100.0, 100.0, 100.0, 100.0, 0.0),
    (20, 2.0): (99.9, 99.9, 100.0, 99.9, 99.9, 0.0),
    (20, 4.0): (92.1, 89.8, 87.9, 90.6, 90.1, 0.0),
    (20, 8.0): (60.3, 59.6, 54.0, 61.1, 59.6, 0.10),
    (20, 15.0): (37.3, 37.5, 36.9, 37.8, 37.2, 10.00),
    (30, 0.0): (100.0, 100.0, 100.0, 100.0, 100.0, 0.0),
    (30, 2.0): (99.9, 100.0, 99.4, 99.8, 99.9, 0.0),
    (30, 4.0): (90.9, 90.4, 88.3, 90.7, 90.5, 0.0),
    (30, 8.0): (60.7, 59.8, 57.4, 58.8, 62.4, 8.25),
    (30, 15.0): (42.9, 44.3, 43.2, 44.5, 45.6, 20.10),
}
"""The same of the pairing by single stamps until 2026-11-30, from the same draws."""


def exposures_ms(rate_hz: float, lag_periods: float) -> FloatArray:
    """The true times of both cameras' exposures, (2, exposures)."""
    period_ms, n = 1000.0 / rate_hz, np.arange(EXPOSURES)
    return np.array([n * period_ms, (n + lag_periods) * period_ms * (1.0 + DRIFT_PPM * 1e-6)])


def stamps_ms(times_ms: FloatArray, jitter_ms: float, bursts: bool, rng: np.random.Generator) -> FloatArray:
    """Stamps with normal jitter, or in bursts with exponential delays; no frame overtakes another."""
    draw = (
        rng.exponential(jitter_ms, times_ms.shape) if bursts else rng.normal(0.0, jitter_ms, times_ms.shape)
    )
    return np.asarray(np.maximum.accumulate(times_ms + draw, axis=1))


def shares(rate_hz: float, lag_periods: float, jitter_ms: float, bursts: bool = False) -> tuple[float, float]:
    """Shares of the exposures in whole and in wrong frame sets at the default limits, %."""
    rng = np.random.default_rng([SEED, round(rate_hz), round(2 * jitter_ms), round(4 * lag_periods)])
    times_ms = exposures_ms(rate_hz, lag_periods)
    return shares_of(times_ms, stamps_ms(times_ms, jitter_ms, bursts, rng), rate_hz)


def stamped_at_once_ms(times_ms: FloatArray, sizes: tuple[int, int]) -> FloatArray:
    """Stamps of frames that each camera's driver delivers so many at a time, 0.3 ms apart."""
    n = np.arange(EXPOSURES)
    last = np.array([np.minimum(n // size * size + size - 1, EXPOSURES - 1) for size in sizes])
    return np.take_along_axis(times_ms, last, axis=1) - 0.3 * (last - n)


def shares_of(times_ms: FloatArray, stamps: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Shares of exposures with these stamps in whole and in wrong frame sets, %."""
    limits = Measuring()
    pairer: Pairer[int] = Pairer(("front", "rear"), "time", limits.max_skew_ns, limits.max_lag_ns)
    apart_ms: list[float] = []
    for index in np.argsort(stamps.ravel(), kind="stable").tolist():
        camera, n = divmod(index, EXPOSURES)
        pairs = pairer.add(("front", "rear")[camera], n, round(stamps[camera, n] * 1e6), n)
        whole = [pair.items for pair in pairs if not pair.missing and pair.items["front"] >= START]
        apart_ms += [abs(times_ms[1, items["rear"]] - times_ms[0, items["front"]]) for items in whole]
    wrong = sum(apart > WRONG_PERIODS * 1000.0 / rate_hz for apart in apart_ms)
    return 100.0 * len(apart_ms) / (EXPOSURES - START), 100.0 * wrong / (EXPOSURES - START)


def budget_ms(rate_hz: int) -> float:
    """The largest jitter up to which enough frame sets are whole, at both lags and distributions."""
    for step in count():
        jitter_ms = BUDGET_FROM_MS + step * BUDGET_STEP_MS
        for lag, bursts in product((0.0, 0.5), (False, True)):
            if shares(rate_hz, lag, jitter_ms, bursts)[0] < BUDGET_WHOLE:
                return jitter_ms - BUDGET_STEP_MS
    raise AssertionError


def run(progress: Progress) -> Result:
    """Pair drawn stamps for each rate, jitter and lag, and find the budget of each rate."""
    rows = []
    for rate_hz, jitter_ms in BEFORE:
        progress(f"pairing: {rate_hz} frames/s, {jitter_ms:g} ms")
        cells = [shares(rate_hz, lag, jitter_ms) for lag in LAGS_PERIODS]
        values = (*(whole for whole, _ in cells), max(wrong for _, wrong in cells))
        rows.append(Row(f"{rate_hz}/s, {jitter_ms:g} ms", values, BEFORE[rate_hz, jitter_ms]))
    progress("pairing: budget")
    budgets = [budget_ms(rate_hz) for rate_hz in RATES_HZ]
    at_once = []
    for rate_hz, lag, sizes in product(RATES_HZ, LAGS_PERIODS, BURSTS):
        times_ms = exposures_ms(rate_hz, lag)
        at_once.append(shares_of(times_ms, stamped_at_once_ms(times_ms, sizes), rate_hz))
    most_whole_at_once, most_wrong_at_once = np.max(at_once, axis=0)
    most_wrong = max(row.ours[-1] or 0.0 for row in rows)
    most_before = max(values[-1] for values in BEFORE.values())
    figure, (axis,) = panels()
    for start, (rate_hz, colour) in enumerate(zip(RATES_HZ, (OURS, THESIS, THIRD), strict=True)):
        some = rows[start * len(JITTERS_MS) :][: len(JITTERS_MS)]
        ours = [row.ours[0] or 0.0 for row in some]
        before = [BEFORE[rate_hz, jitter_ms][0] for jitter_ms in JITTERS_MS]
        axis.plot(JITTERS_MS, ours, "o-", color=colour, label=f"{rate_hz} frames/s")
        axis.plot(JITTERS_MS, before, "--", color=colour, lw=0.9)
    axis.set(xlabel="jitter, ms", ylabel="whole frame sets, %", ylim=(0, 103))
    axis.legend()
    listed = ", ".join(f"{budget:g}" for budget in budgets[:-1]) + f" and {budgets[-1]:g}"
    return Result(
        of="rate, jitter",
        thesis_source="none; App. A.3 has two synchronised cameras",
        columns=(
            *(Column(f"lag {lag:g}, %", 1, judged=False) for lag in LAGS_PERIODS),
            Column("wrong, %", 2, judged=False),
        ),
        rows=tuple(rows),
        headline=(
            f"At 15, 20 and 30 frames per second the stamps may have a jitter of {listed} ms for 99 % whole "
            f"frame sets at any lag; wrong are {most_wrong:.2f} % at most, before {most_before:.2f} %."
        ),
        text=f"""

Two cameras expose regularly, with crystals {DRIFT_PPM:g} ppm apart. *Lag* is that of the rear camera in
periods, *jitter* the standard deviation of a normal distribution, from which each stamp is drawn. A value is
the share of {EXPOSURES - START} exposures of the front camera that are in a whole, valid frame set at the
default limits. *Wrong* is the largest share, of the five lags, of exposures in a set whose frames are truly
more than {WRONG_PERIODS:g} periods apart. *Before* compared single stamps; `max_lag_ms` was 30.

The frame sets were lost at a fixed limit of 10 ms for the difference of two stamps. Now a line through the
stamps of each camera, by the frames' numbers, tells which frames belong together. A set is valid if its
stamps are within that limit, or each of them is near its line: within six standard deviations, and at least
four from the place of a frame one period off. Where the jitter exceeds a fifth of the period, no frame sets
are whole: there fewer than before are measured, but before, up to {most_before:.0f} % were wrong.

The headline's jitter is the largest, in steps of {BUDGET_STEP_MS:g} ms, for normal jitter and for bursts
(exponential delays of this standard deviation), at a lag of 0 and of half a period.

Stamps may tell when frames arrived, not when they were exposed: of a driver that delivers two, three or four
at once, each is near several frames of the other camera. Two stamps within 0.3 periods are not those of two
exposures. A camera with more than a quarter of such stamps, or with any while no line is known, is
`out_of_step`. Of {len(at_once)} such cases at most {most_whole_at_once:.1f} % of the sets are
whole and {most_wrong_at_once:.2f} % are wrong.
""",
        figure=figure,
        caption="Whole frame sets by jitter at no lag; dashed: before",
        beside="before",
    )
