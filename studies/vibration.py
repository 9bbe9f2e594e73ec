"""Vibration near the frame rate: what even and uneven exposures make of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
from matplotlib.figure import Figure

from altd.devices.trigger_times import TriggerTimes
from altd.measuring.averaging import FrameSetWindow
from altd.measuring.sampling import SamplingCheck, ScatterMemory
from altd.records import FloatArray, FrameSet, MeanSpots, Spot
from studies.bench import rms
from studies.plot import GREY, OURS, THESIS, THIRD, panels, plain_decades
from studies.result import Column, Progress, Result, Row
from studies.vibration_daemon import summary

TITLE = "Vibration: 1 to 130 Hz, exposures even and uneven"
QUESTION = "Does sigma cover a vibration at a multiple of the frame rate?"

PERIOD_NS = 50_000_000
WINDOW = 20
TARGETS = ("front", "rear")
NOISE_PX, MM_PER_PX = 0.04, 0.25
"""Noise of a spot in one frame, and scale of both cameras: 0.01 mm."""
AMPLITUDES_MM = (0.05, 0.1, 0.3)
FREQUENCIES_HZ = (
    *(1, 2, 3, 5, 7, 10, 13, 16, 18, 19, 19.5, 20, 20.5, 21, 22, 25, 28, 30, 33, 36, 39, 40, 41, 45, 50, 55),
    *(59, 59.9, 60, 60.1, 61, 65, 70, 79, 80, 81, 90, 99, 100, 101, 115, 119, 120, 121, 130),
)
SHOWN_HZ = (1, 3, 10, 16, 19, 19.5, 20, 20.5, 21, 28, 40, 50, 59.9, 60, 60.1, 70, 80, 100, 120, 130)
"""Rows of the table; the plot shows all frequencies."""
FAST_HZ = 16
FAST = [number for number, hertz in enumerate(FREQUENCIES_HZ) if hertz >= FAST_HZ]
EXPOSURE_MS = 2.0
RUNS, WARM_UP, JUDGED = 5, 6, 8
"""Runs for each frequency and amplitude, with other triggers and phases, and their windows."""
WITHIN = (0.8, 1.25)
Times = Callable[[np.random.Generator, int], FloatArray]
"""The times of so many exposures in s, from a random one on."""


def even(rng: np.random.Generator, count: int) -> FloatArray:
    """Multiples of the period."""
    return np.asarray((int(rng.integers(10**6)) + np.arange(count)) * (PERIOD_NS * 1e-9), dtype=np.float64)


def delayed(rng: np.random.Generator, count: int) -> FloatArray:
    """Multiples of the period, each with a delay of its own of up to 0.8 periods."""
    return np.asarray(even(rng, count) + rng.uniform(0.0, 0.8, count) * PERIOD_NS * 1e-9)


def uneven(rng: np.random.Generator, count: int, shortest_ns: int = 0) -> FloatArray:
    """The instants of the unit's software triggers."""
    triggers, t_ns = TriggerTimes(PERIOD_NS, shortest_ns), int(rng.integers(10**6)) * PERIOD_NS
    times_ns = []
    for _ in range(count):
        t_ns = triggers.after(t_ns)
        times_ns.append(t_ns)
    return np.array(times_ns) * 1e-9


def windows(
    rng: np.random.Generator, times: Times, frequency_hz: float, amplitude_mm: float, exposure_ms: float
) -> Iterator[tuple[float, float] | None]:
    """Error and sigma of x, mm, of windows of a machine that vibrates about its place; None: no mean.

    The truth is the mean of the vibration over the window's second, which a slow one does not fill evenly.
    """
    omega = 2.0 * math.pi * frequency_hz
    smeared_mm = amplitude_mm * float(np.sinc(frequency_hz * exposure_ms * 1e-3))
    for _ in range(RUNS):
        t_s, phase = times(rng, WINDOW * (WARM_UP + JUDGED)), rng.uniform(0.0, 2.0 * math.pi)
        x_px = smeared_mm * np.sin(omega * t_s + phase) / MM_PER_PX
        sampling, memory = SamplingCheck(), ScatterMemory()
        window = FrameSetWindow(TARGETS, WINDOW, WINDOW, memory)
        for number, (at_s, moved_px) in enumerate(zip(t_s.tolist(), x_px.tolist(), strict=True)):
            sampling.add(round(at_s * 1e9))
            noise_px = rng.normal(0.0, NOISE_PX, (2, 2)).tolist()
            spots = {
                target: Spot(300.0 + moved_px + u, 200.0 + v, NOISE_PX, 44.0, 150.0)
                for target, (u, v) in zip(TARGETS, noise_px, strict=True)
            }
            mean = window.add(FrameSet(number, round(at_s * 1e9), spots))
            if mean is None:
                continue
            if isinstance(mean, MeanSpots) and times is not even:
                mean = memory.widened(mean, sampling.excess(mean.frames))
            if number < WINDOW * WARM_UP:
                continue
            if not isinstance(mean, MeanSpots):
                yield None
                continue
            ends_s = t_s[number + 1 - WINDOW] - PERIOD_NS * 0.5e-9, at_s + PERIOD_NS * 0.5e-9
            first, last = (math.cos(omega * end_s + phase) for end_s in ends_s)
            truth_mm = amplitude_mm * (first - last) / (omega * (ends_s[1] - ends_s[0]))
            error_mm = (mean.px[0, 0] - 300.0) * MM_PER_PX - truth_mm
            yield float(error_mm), math.sqrt(mean.covariance_px2[0, 0]) * MM_PER_PX


def ratio(
    times: Times, frequency_hz: float, amplitude_mm: float, exposure_ms: float = EXPOSURE_MS, seed: int = 1
) -> tuple[float, float, float]:
    """Rms(error/sigma), largest error/sigma, and share of windows without a mean; 0, 0, 1 if all are."""
    rng = np.random.default_rng([seed, round(10 * frequency_hz), round(1000 * amplitude_mm)])
    results = list(windows(rng, times, frequency_hz, amplitude_mm, exposure_ms))
    known = np.array([result for result in results if result is not None]).reshape(-1, 2)
    in_sigmas = known[:, 0] / known[:, 1]
    if not len(known):
        return 0.0, 0.0, 1.0
    return rms(in_sigmas), float(np.abs(in_sigmas).max()), 1.0 - len(known) / len(results)


def run(progress: Progress) -> Result:
    """All frequencies and amplitudes, with even and uneven exposures."""
    found: dict[tuple[bool, float], list[tuple[float, float, float]]] = {}
    for is_even, amplitude_mm in itertools.product((True, False), AMPLITUDES_MM):
        progress(f"vibration: {amplitude_mm:g} mm, {'even' if is_even else 'uneven'}")
        times = even if is_even else uneven
        found[is_even, amplitude_mm] = [ratio(times, hz, amplitude_mm) for hz in FREQUENCIES_HZ]
    grid = [ratio(delayed, hz, AMPLITUDES_MM[-1])[0] for hz in FREQUENCIES_HZ]
    at_rest = [ratio(times, 1.0, 0.0)[0] for times in (even, uneven)]
    rows = tuple(
        Row(f"{hz:g} Hz", tuple(of[number][0] or None for of in found.values()))
        for number, hz in enumerate(FREQUENCIES_HZ)
        if hz in SHOWN_HZ
    )
    of_even, of_uneven = (
        [each for (is_even, _), of in found.items() if is_even is wanted for each in of]
        for wanted in (True, False)
    )
    at_20 = [found[True, amplitude][FREQUENCIES_HZ.index(20)][0] for amplitude in AMPLITUDES_MM]
    inside = sum(WITHIN[0] <= z <= WITHIN[1] for z, _, _ in of_uneven)
    fast = rms(np.array([of[n][0] for (is_even, _), of in found.items() if not is_even for n in FAST]))
    above = sum(z > WITHIN[1] for z, _, _ in of_uneven)
    return Result(
        of="frequency",
        thesis_source="none; App. A.4 averages up to 20 frames a second",
        columns=tuple(
            Column(f"{'even' if is_even else 'uneven'}, {amplitude:g} mm", 2, judged=False)
            for is_even, amplitude in found
        ),
        rows=(Row("at rest", (at_rest[0],) * 3 + (at_rest[1],) * 3), *rows),
        headline=(
            f"At 20 Hz sigma is {at_20[0]:.0f}, {at_20[1]:.0f} and {at_20[2]:.0f} times too small for a "
            f"vibration of 0.05, 0.1 and 0.3 mm if exposures are even; if they are uneven, "
            f"rms(error/sigma) from {FAST_HZ} Hz on is {fast:.2f}, and the largest error is "
            f"{max(worst for _, worst, _ in of_uneven):.1f} sigma."
        ),
        text=(
            f"x of the mean of {WINDOW} frames, 20 a second, of a machine that vibrates at one frequency in "
            f"x. The spots' positions, with a noise of {NOISE_PX * MM_PER_PX:g} mm, pass the unit's own "
            "window and memory of scatter; the uneven instants are those of the unit's software triggers. "
            f"Exposures are {EXPOSURE_MS:g} ms. Each figure is the rms of error/sigma over {RUNS * JUDGED} "
            "windows with other phases and other triggers, so it scatters by a ninth. Sigma here is the "
            "scatter of single exposures alone, without print and map, which a unit adds.\n\n"
            f"Uneven: {inside} of {len(of_uneven)} figures in the plot lie within {WITHIN[0]:g} to "
            f"{WITHIN[1]:g}, {above} above, up to {max(z for z, _, _ in of_uneven):.2f}. Below "
            "the frame rate a mean is better than its sigma, because the exposures follow the vibration. "
            f"Even: the largest single error is {max(worst for _, worst, _ in of_even):.0f} sigma. Windows "
            f"without a mean (`unsteady`): {max(share for _, _, share in of_even):.0%} even, "
            f"{max(share for _, _, share in of_uneven):.0%} uneven, at most; – if all are.\n\n"
            "The plot also shows a random delay of up to 0.8 periods for each frame of an even grid, with "
            "the same memory: its mean is biased at the multiples of the rate.\n\n"
            f"{summary()}"
        ),
        figure=_figure(found, grid),
        caption="Rms(error/sigma) of x against the frequency of a vibration of 0.05 to 0.3 mm",
    )


def _figure(found: dict[tuple[bool, float], list[tuple[float, float, float]]], grid: list[float]) -> Figure:
    figure, (axis,) = panels(width=7.0, height=3.6)
    axis.axhspan(*WITHIN, color=GREY, alpha=0.2, linewidth=0)
    for (is_even, amplitude), of in found.items():
        style = {0.05: ":", 0.1: "--", 0.3: "-"}[amplitude]
        colour = THESIS if is_even else OURS
        label = f"{'even' if is_even else 'uneven'}, {amplitude:g} mm"
        axis.plot(
            FREQUENCIES_HZ, [z or math.nan for z, _, _ in of], style, color=colour, label=label, linewidth=1.2
        )
    label = f"grid with delays, {AMPLITUDES_MM[-1]:g} mm"
    axis.plot(FREQUENCIES_HZ, grid, color=THIRD, label=label, linewidth=1.0)
    axis.set_yscale("log")
    axis.set_xlabel("frequency of the vibration, Hz")
    axis.set_ylabel("rms(error/sigma) of x")
    plain_decades(axis.yaxis)
    axis.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
