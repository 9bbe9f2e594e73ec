"""Runs the hours of good measuring, in one or two processes; what is done is kept and not run again."""

from __future__ import annotations

import hashlib
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from benchmarks.campaign.cache import ROOT, calibrated
from benchmarks.campaign.good import BURST, GOOD, WINDOW, Count, measure_hour
from benchmarks.campaign.runner import prepare


def run_good(
    hours: int, step_s: float, seed: int, processes: int, kept: Path, progress: Callable[[int, int], None]
) -> dict[str, Count]:
    """The sums by unit; hours whose result lies in ``kept``, of this very code, are taken from there."""
    for circumstances in GOOD.values():
        calibrated(circumstances.unit)
    folder = kept / f"good-{_code()}-{step_s:g}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [(hour, name) for hour in range(hours) for name in GOOD]
    open_ = [(hour, name) for hour, name in wanted if not (folder / f"{name}-{hour}.json").exists()]
    progress(len(wanted) - len(open_), len(wanted))
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=prepare) as pool:
        running = {pool.submit(measure_hour, name, hour, step_s, seed): (name, hour) for hour, name in open_}
        for done, future in enumerate(as_completed(running), start=len(wanted) - len(open_) + 1):
            name, hour = running[future]
            (folder / f"{name}-{hour}.json").write_text(future.result().as_json())
            progress(done, len(wanted))
    sums = {name: Count() for name in GOOD}
    for hour, name in wanted:
        sums[name].merge(Count.of_json((folder / f"{name}-{hour}.json").read_text()))
    return sums


def _code() -> str:
    """A hash of all that decides a result."""
    digest = hashlib.sha256()
    for folder in ("altd", "hw_sim", "benchmarks/campaign"):
        for file in sorted((ROOT / folder).glob("**/*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def lines(sums: Mapping[str, Count], hours: int, step_s: float) -> Iterator[str]:
    """The table."""
    yield (
        f"{hours} h of {len(sums)} units; every {step_s:g} s of it {BURST} exposures at 20 a second, "
        f"window {WINDOW}: {BURST - WINDOW + 1} measurements"
    )
    yield (
        f"{'unit':<9}{'frames':>9}{'refused':>9}{'measured':>10}{'invalid':>9}{'warned':>8}{'wrong':>7}"
        f"{'rms(error/sigma) x y yaw pitch':>33}{'largest':>9}"
    )
    for name, count in sums.items():
        rms = " ".join(f"{value:.2f}" for value in count.rms)
        yield (
            f"{name:<9}{count.frames:>9}{count.frames_refused.total():>9}{count.measurements:>10}"
            f"{count.invalid.total():>9}{count.warned.total():>8}{count.wrong:>7}{rms:>33}"
            f"{count.largest_sigmas:>9.1f}"
        )
    total = Count()
    for count in sums.values():
        total.merge(count)
    alarms = total.invalid.total() + total.warned.total()
    yield (
        f"{total.measurements} measurements: {total.invalid.total()} invalid, {total.warned.total()} warned: "
        f"{1e5 * alarms / max(total.measurements, 1):.1f} false alarms in 100,000"
    )
    yield f"rms(error/sigma), median of units and quantities: {_median_rms(sums):.2f}"
    for what, counter in (
        ("invalid", total.invalid),
        ("warned", total.warned),
        ("frames refused", total.frames_refused),
    ):
        yield f"{what}: {_words(counter)}"


def _median_rms(sums: Mapping[str, Count]) -> float:
    return statistics.median(value for count in sums.values() for value in count.rms)


def _words(counter: Counter[str]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in counter.most_common()) or "none"
