"""The table of a campaign, as text."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Mapping

from benchmarks.campaign.catalogue import WAYS
from benchmarks.campaign.judge import LIMITS, SIGMAS, Tally, Verdict

HIDDEN_SUFFIX = " (hidden)"
"""After the name of a way: its episodes in which nobody could see it, on that unit, as it was drawn."""

HEAD = (
    "way",
    "kind",
    "episodes",
    "measured",
    "wrong",
    "right",
    "invalid",
    "worst mm",
    "worst °",
    "sigmas",
    "notice",
    "back s",
)


def cells(name: str, tally: Tally) -> tuple[str, ...]:
    """One row."""
    way = WAYS.get(name.removesuffix(HIDDEN_SUFFIX))
    kind = way.kind if way is not None else "two at once"
    seen = f"{statistics.median(tally.noticed):.0f} / {max(tally.noticed)}" if tally.noticed else "–"
    back = (
        f"{statistics.median(tally.recovered_s):.2f} / {max(tally.recovered_s):.2f}"
        if tally.recovered_s
        else ""
    )
    verdicts = tally.verdicts
    wrong = str(verdicts[Verdict.WRONG]) + (" *" if tally.invisible else "")
    worst = ("–", "–", "–")
    if verdicts[Verdict.WRONG]:
        worst = (f"{tally.worst_mm:.3g}", f"{tally.worst_deg:.3g}", f"{tally.worst_sigmas:.3g}")
    counts = (wrong, str(verdicts[Verdict.RIGHT]), str(verdicts[Verdict.INVALID]))
    return name, kind, str(tally.episodes), str(tally.measurements), *counts, *worst, seen, back


def rows(tallies: Mapping[str, Tally]) -> list[tuple[str, ...]]:
    """All rows, the head first."""
    return [HEAD, *(cells(name, tally) for name, tally in tallies.items())]


def totals(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """What follows the table."""
    spoilt = sum(tally.measurements for name, tally in tallies.items())
    clean = sum(tally.clean for tally in tallies.values())
    refused: Counter[str] = Counter()
    for name, tally in tallies.items():
        refused += tally.clean_refused
        if name in WAYS and WAYS[name].kind == "good":
            refused += Counter(
                {reason: count for reason, count in tally.reasons.items() if reason != "warming_up"}
            )
    yield (
        f"{spoilt + clean} measurements, {clean} of them before an onset, in "
        f"{sum(tally.episodes for tally in tallies.values())} episodes; wrong is above {SIGMAS:g} sigma "
        f"and above {LIMITS[0]:g} mm or {LIMITS[2]:g}°"
    )
    yield f"wrong ones called valid: {wrong_count(tallies)}"
    yield f"wrong ones called valid in ways that are physically invisible: {invisible_count(tallies)}"
    yield f"wrong although nothing was spoilt: {sum(tally.clean_wrong for tally in tallies.values())}"
    yield "good ones refused: " + (
        ", ".join(f"{reason} {count}" for reason, count in refused.most_common()) or "none"
    )


def wrong_count(tallies: Mapping[str, Tally]) -> int:
    """Wrong ones called valid, those of physically invisible ways aside."""
    return sum(
        tally.verdicts[Verdict.WRONG] + tally.clean_wrong for tally in tallies.values() if not tally.invisible
    )


def invisible_count(tallies: Mapping[str, Tally]) -> int:
    """Wrong ones called valid that nobody could tell."""
    return sum(tally.verdicts[Verdict.WRONG] for tally in tallies.values() if tally.invisible)


def worst(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """The worst of each way, with what brings them back."""
    for name, tally in tallies.items():
        for sigmas, error_mm, error_deg, note in tally.worst:
            yield f"{name}: {sigmas:.1f} sigma, {error_mm:.3f} mm, {error_deg:.4f}°: {note}"


def invisible(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """What physics forbids to see."""
    for name, tally in tallies.items():
        if tally.invisible:
            yield f"* {name}: {tally.invisible}"


def text(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """The table with columns under each other."""
    table = rows(tallies)
    widths = [max(len(row[column]) for row in table) for column in range(len(HEAD))]
    for row in table:
        cells_ = [
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells_).rstrip()
    yield "notice: frames from the onset to the first invalid measurement, median / largest"
    yield "back: seconds from the end of a disturbance to the next valid measurement, median / largest"
    yield from invisible(tallies)
    yield ""
    yield from totals(tallies)
