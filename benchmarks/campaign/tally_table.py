"""The table of a campaign, as text and as the page ``docs/studies/campaign.md``."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from altd.errors import BadInputError
from benchmarks.campaign.catalogue import WAYS
from benchmarks.campaign.judge import LIMITS, SIGMAS, Tally, Verdict
from tools.markdown import wrapped

HIDDEN_SUFFIX = " (hidden)"
"""After the name of a way: its episodes that the drawn unit cannot detect."""

HEAD = (
    *("way", "kind", "episodes", "measured", "wrong", "right", "invalid"),
    *("worst mm", "worst °", "sigmas", "notice", "back s"),
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
    """Wrong ones called valid that cannot be detected."""
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


_HEAD = """\
# Campaign: spoilt measurements, judged by truth

{headline}

Written by `{command}` ({took_s:.0f} s; seed {seed}; units {units}). Each episode draws a unit, a beam, a way
to spoil it and its parameters from the seed; clean exposures come first in four of five, then spoilt ones,
all through the daemon's own measuring chain (window {window}), which measures at every exposure. *Wrong* is
one that is called valid with an error above 5 sigma and above 0.05 mm or 0.01°; where no laser is left, any
number is wrong. *Invalid* are refused ones. *Notice*: frames from the onset to the first invalid measurement,
median / largest; a mean of several exposures is wrong only once enough of them are. *Back*: seconds from the
end of a disturbance to the next valid measurement. Ways of times run through pipeline and board on a clock
that is driven, and a reader of the board is judged every 25 ms: its numbers must be those of some moment
within the last second and a window. Stamps of a clock in the camera are mapped as the GigE driver maps them.

*(hidden)* episodes were drawn so that the unit cannot detect them, by the limits of
`benchmarks/campaign/detectability.py`, which are written down below; such ways were found by this campaign,
and what it counts as wrong rests on where these limits lie.

What it is worth: all but unit-a is simulated, and ways are those that their authors thought of.

"""


@dataclass(frozen=True, slots=True)
class RunDescription:
    """How a campaign was run: its command, the seed and units drawn from, its duration and window."""

    command: str
    seed: int
    units: str
    took_s: float
    window: int


def write_page(path: Path, tallies: Mapping[str, Tally], run: RunDescription) -> None:
    """Write the page; raises BadInputError when the disk refuses."""
    wrong = wrong_count(tallies)
    total = sum(tally.measurements + tally.clean for tally in tallies.values())
    ways = {name.removesuffix(HIDDEN_SUFFIX) for name in tallies} & WAYS.keys()
    headline = (
        f"Of {total:,} measurements in {len(ways)} ways, and in pairs of them, {wrong:,} wrong ones were "
        f"called valid, beside {invisible_count(tallies):,} that cannot be detected (marked *)."
    )
    text = _HEAD.format(headline=headline, **asdict(run))
    head, *body = rows(tallies)
    lines = ["| " + " | ".join(head) + " |", "|---|---|" + "---:|" * (len(head) - 2)]
    lines += ["| " + " | ".join(row) + " |" for row in body]
    hidden = [f"- {line[2:]}" for line in invisible(tallies)]
    if hidden:
        lines += ["", "What physics forbids to see (marked *), with its size:", "", *hidden]
    lines += ["", *(f"- {line}." for line in totals(tallies)), "", "## The ways", ""]
    lines += [f"- `{name}` ({way.kind}): {_first_line(way.make)}" for name, way in WAYS.items()]
    try:
        path.write_text(wrapped(text + "\n".join(lines) + "\n"))
    except OSError as error:
        raise BadInputError(path, f"cannot be written: {error.strerror or error}") from error


def _first_line(make: object) -> str:
    return (make.__doc__ or "Nothing is spoilt.").strip().splitlines()[0]
