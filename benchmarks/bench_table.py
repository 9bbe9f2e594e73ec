"""What a run measured, and the table that a person reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.daemon import LoadFigures, RateFigures
from benchmarks.material import FPS, SEED
from benchmarks.stages import StageFigures
from benchmarks.startup import StartFigures

CPU_AIM_MS = 2.0
STAGE_AIMS = {
    "coarse search": "< 150 µs a frame",
    "mapping, one point": "< 40 µs a point",
    "whole chain": "< 1400 µs a pair",
}
LATENCY_AIM_MS = 10.0
START_AIM_S = 3.0


@dataclass(frozen=True, slots=True)
class Figures:
    """All of a run."""

    quick: bool
    pairs: int
    stages: list[StageFigures]
    loads: list[LoadFigures]
    rate: RateFigures
    start: StartFigures
    machine: dict[str, str]


def lines(figures: Figures) -> Iterator[str]:
    """The table."""
    yield (
        f"altd bench{', quick' if figures.quick else ''}: a pair is two frames of 752 × 480, 8 bits;"
        f" {figures.pairs} different pairs of hw_sim (seed {SEED}) in memory"
    )
    yield ""
    yield from _stages(figures.stages)
    yield ""
    yield from _loads(figures.loads)
    yield ""
    yield from _rate(figures.rate)
    yield ""
    yield from _start(figures.start)
    yield ""
    yield ", ".join(f"{what} {value}" for what, value in figures.machine.items())


def _stages(stages: list[StageFigures]) -> Iterator[str]:
    yield f"{'stage':<34}{'calls':>6}{'median µs':>11}{'p99 µs':>9}{'µs a pair':>11}{'× copy':>8}   aim"
    for stage in stages:
        name = f"  of it {stage.name}" if stage.part_of else stage.name
        aim = STAGE_AIMS.get(stage.name, "")
        yield (
            f"{name:<34}{stage.calls_a_pair:>6}{stage.median_us:>11.1f}{stage.p99_us:>9.1f}"
            f"{stage.calls_a_pair * stage.median_us:>11.0f}{stage.passes:>8.1f}   {aim}".rstrip()
        )


def _loads(loads: list[LoadFigures]) -> Iterator[str]:
    yield (
        f"{f'daemon, {FPS:g} pairs/s':<24}{'CPU % of a core':>16}{'CPU ms a pair':>15}"
        f"{'pairs':>7}{'lost':>6}{'p50 ms':>9}{'p99 ms':>8}{'max ms':>8}"
    )
    for load in loads:
        line = f"{load.name:<24}{100 * load.cpu_share:>16.2f}"
        if load.cpu_ms_a_pair is not None and load.latency is not None:
            wait = load.latency
            line += f"{load.cpu_ms_a_pair:>15.2f}{load.pairs:>7}{load.lost:>6}"
            line += f"{wait.p50_ms:>9.2f}{wait.p99_ms:>8.2f}{wait.max_ms:>8.2f}"
        yield line
    yield f"{'aim':<24}{'':>16}{f'< {CPU_AIM_MS:g}':>15}{'':>7}{0:>6}{'':>9}{f'< {LATENCY_AIM_MS:g}':>8}"
    yield "p50, p99, max: from the pair's last frame handed over to the value in a reader's hands"
    attached = next((load.answers for load in loads if load.answers), {})
    yield "clients were given " + ", ".join(f"{count} {what}" for what, count in attached.items())


def _rate(rate: RateFigures) -> Iterator[str]:
    held = f"{rate.held:.0f} pairs/s" if rate.held else "none"
    yield f"highest rate without a lost pair, one core, {rate.seconds:g} s: {held} ({rate.pairs} pairs)"
    yield (
        f"the chain alone, back to back: {rate.chain_alone:.0f} pairs/s;"
        f" other processes took {rate.others_share:.0%} of that core meanwhile"
    )


def _start(start: StartFigures) -> Iterator[str]:
    yield (
        f"altd run, from process start: imports {start.imports_s:.2f} s, first HTTP answer"
        f" {start.first_answer_s:.2f} s, first valid measurement {start.first_valid_s:.2f} s"
        f" (aim < {START_AIM_S:g} s; {start.least_s:.2f} s of it half a window of exposures)"
    )
