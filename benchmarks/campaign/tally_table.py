"""The table of a campaign, as text and as the page ``docs/studies/campaign.md``."""

import statistics
from collections import Counter
from collections.abc import Iterator, Mapping

from benchmarks.campaign.judge import HIDDEN_SUFFIX, LIMITS, SIGMAS, Tally, Verdict
from benchmarks.campaign.ways import WAYS
from benchmarks.harness import aligned, markdown_table
from tools.markdown import wrapped

_WORST = ("worst mm", "worst °", "sigmas")
HEAD = ("way", "kind", "episodes", "measured", "wrong", "right", "invalid", *_WORST, "notice", "back s")


def cells(name: str, tally: Tally) -> tuple[str, ...]:
    """Cells of one row."""
    noticed, back_s, verdicts = tally.noticed, tally.recovered_s, tally.verdicts
    worst = ("–", "–", "–")
    if verdicts[Verdict.WRONG]:
        worst = (f"{tally.worst_mm:.3g}", f"{tally.worst_deg:.3g}", f"{tally.worst_sigmas:.3g}")
    return (
        name,
        _kind(name.removesuffix(HIDDEN_SUFFIX)),
        str(tally.episodes),
        str(tally.measurements),
        str(verdicts[Verdict.WRONG]) + (" *" if tally.invisible else ""),
        str(verdicts[Verdict.RIGHT]),
        str(verdicts[Verdict.INVALID]),
        *worst,
        f"{statistics.median(noticed):.0f} / {max(noticed)}" if noticed else "–",
        f"{statistics.median(back_s):.2f} / {max(back_s):.2f}" if back_s else "",
    )


def totals(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Text after the table."""
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
    yield f"wrong ones marked valid: {wrong_count(tallies)}"
    yield f"wrong ones marked valid that cannot be detected: {invisible_count(tallies)}"
    yield f"wrong without a disturbance: {sum(tally.clean_wrong for tally in tallies.values())}"
    yield "good ones rejected: " + (
        ", ".join(f"{reason} {count}" for reason, count in refused.most_common()) or "none"
    )


def wrong_count(tallies: Mapping[str, Tally]) -> int:
    """Number of wrong measurements marked valid, except undetectable ones."""
    return sum(
        tally.verdicts[Verdict.WRONG] + tally.clean_wrong for tally in tallies.values() if not tally.invisible
    )


def invisible_count(tallies: Mapping[str, Tally]) -> int:
    """Number of wrong measurements marked valid that cannot be detected."""
    return sum(tally.verdicts[Verdict.WRONG] for tally in tallies.values() if tally.invisible)


def worst(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Worst cases of each way, with the episode and parameters that reproduce them."""
    for name, tally in tallies.items():
        for sigmas, error_mm, error_deg, note in tally.worst:
            yield f"{name}: {sigmas:.1f} sigma, {error_mm:.3f} mm, {error_deg:.4f}°: {note}"


def text(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Table with aligned columns."""
    yield from aligned([HEAD, *(cells(name, tally) for name, tally in tallies.items())], text_columns=2)
    yield "notice: frames from the onset to the first invalid measurement, median / largest"
    yield "back: seconds from the end of a disturbance to the next valid measurement, median / largest"
    yield from (f"* {name}: {tally.invisible}" for name, tally in tallies.items() if tally.invisible)
    yield ""
    yield from totals(tallies)


_HEAD = """\
# Campaign: disturbed measurements, judged by truth

This page states how often a wrong measurement is marked valid, for each kind of disturbance.

{headline}

Command: {command}.
Four of five episodes begin with undisturbed exposures. All exposures run through the measuring chain
(window {window}), which measures at every exposure. Disturbances of times run through pipeline and board on a
simulated clock. A reader of the board is judged every 25 ms: its numbers must be of a moment within the
last second and a window.

All units but unit-a are simulated, and the disturbances are those that the authors thought of.
*Undetectable* depends on the limits in `benchmarks/campaign/detectability.py`, some of which this campaign
found.

| column | meaning |
|---|---|
| wrong | valid, with an error above 5 sigma and above 0.05 mm or 0.01°; without a laser, every number |
| invalid | rejected; the rest is valid and right |
| notice | frames from the onset to the first invalid measurement, median/largest |
| back | seconds from the end of a disturbance to the next valid measurement, median/largest |

"""


def page(tallies: Mapping[str, Tally], command: str, window: int) -> str:
    """Page as Markdown; ``command`` describes the run."""
    total = sum(tally.measurements + tally.clean for tally in tallies.values())
    ways = {name.removesuffix(HIDDEN_SUFFIX) for name in tallies} & WAYS.keys()
    headline = (
        f"Of {total:,} measurements with {len(ways)} disturbances, and with pairs of them, "
        f"{wrong_count(tallies):,} wrong ones were marked valid, beside {invisible_count(tallies):,} that "
        "cannot be detected."
    )
    told = [f"- {line}." for line in totals(tallies) if not line.startswith("wrong ones")]  # in the headline
    head = _HEAD.format(headline=headline, command=command, window=window) + "\n".join(told)
    return wrapped("\n\n".join([head, *_wrong(tallies), *_undetectable(tallies), *_kinds(tallies)]) + "\n")


def _wrong(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Table of detectable disturbances with a wrong measurement that was marked valid."""
    head = ("way", "measured", "wrong", *_WORST)
    rows = [
        _columns(name, tally, *head)
        for name, tally in tallies.items()
        if tally.verdicts[Verdict.WRONG] and not tally.invisible
    ]
    if rows:
        yield "## Wrong, marked valid\n\n" + markdown_table(head, rows)


def _undetectable(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Undetectable episodes: the reasons with the size of the error."""
    head = ("way", "episodes", "measured", "wrong", "invalid", *_WORST, "notice")
    hidden = {name: tally for name, tally in tallies.items() if tally.invisible}
    if not hidden:
        return
    rows = [_columns(name, tally, *head) for name, tally in hidden.items()]
    yield "## Undetectable\n\nEpisodes that the drawn unit cannot detect:\n\n" + markdown_table(head, rows)
    names: dict[str, list[str]] = {}
    for name, tally in hidden.items():
        names.setdefault(tally.invisible, []).append(name.removesuffix(HIDDEN_SUFFIX))
    yield "\n".join(f"- {', '.join(of)}: {reason}" for reason, of in names.items())


def _kinds(tallies: Mapping[str, Tally]) -> Iterator[str]:
    """One table for each kind of detectable disturbance."""
    kinds: dict[str, list[str]] = {}
    for name, tally in tallies.items():
        if not tally.invisible:
            kinds.setdefault(_kind(name), []).append(name)
    for kind, of in kinds.items():
        has_end = any(tallies[name].recovered_s for name in of)
        columns = ("measured", "wrong", "invalid", "notice", *(("back",) if has_end else ()))
        rows = [(name, _description(name), *_columns(name, tallies[name], *columns)) for name in of]
        yield f"## {kind.capitalize()}\n\n" + markdown_table(("way", "disturbance", *columns), rows, 2)


def _columns(name: str, tally: Tally, *columns: str) -> tuple[str, ...]:
    """Cells of some columns of a way's row."""
    row = dict(zip((*HEAD[:-1], "back"), cells(name, tally), strict=True))
    row["way"] = name.removesuffix(HIDDEN_SUFFIX)
    return tuple(row[column].removesuffix(" *").replace(" / ", "/") for column in columns)


def _kind(name: str) -> str:
    return WAYS[name].kind if name in WAYS else "two at once"


def _description(name: str) -> str:
    return WAYS[name].summary.removesuffix(".") if name in WAYS else "two of them"
