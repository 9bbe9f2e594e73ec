"""The table of the fault suite by fault, as text and as ``docs/studies/faults.md``."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from altd.errors import BadInputError
from benchmarks.faults.catalogue import FAULTS
from benchmarks.faults.episode import BACK, LIMITS, MAX_BACK_S, MAX_REASON_S, SIGMAS, Result
from tools.markdown import wrapped

PAIRS = "two at once"


@dataclass(frozen=True, slots=True)
class Run:
    """One run: its faults, the parameters drawn, why it is undetectable (empty: it is not), the result."""

    number: int
    unit: str
    names: tuple[str, ...]
    note: str
    undetectable: str
    is_blind: bool
    result: Result

    @property
    def row(self) -> str:
        """The row of the table that it belongs to."""
        return self.names[0] if len(self.names) == 1 else PAIRS

    def as_json(self) -> str:
        """For the file of results."""
        return json.dumps(asdict(self))

    @classmethod
    def of_json(cls, line: str) -> Run:
        """The output of ``as_json``."""
        told = json.loads(line)
        result = told.pop("result")
        counted = {key: Counter(result.pop(key)) for key in ("judged", "reasons")}
        return cls(**{**told, "names": tuple(told["names"])}, result=Result(**counted, **result))


def failures(run: Run) -> list[str]:
    """What a run that can be detected did wrong, in words."""
    result, found = run.result, []
    if run.undetectable:
        return []
    if result.beyond_sigmas or result.wrong:
        found.append(
            f"{max(result.beyond_sigmas, result.wrong)} wrong of {result.valid}: {result.worst_sigmas:.1f} sigma, "
            f"{result.worst_mm:.3f} mm, {result.worst_deg:.4f}°"
        )
    if result.no_reason:
        found.append(f"{result.no_reason} invalid without a reason")
    if run.is_blind and (result.reason_s is None or result.reason_s > MAX_REASON_S):
        found.append(f"reason after {result.reason_s} s")
    if result.back_s > MAX_BACK_S:
        found.append(f"back after {result.back_s:.2f} s")
    return found


HEAD = ("fault", "runs", "judged", "valid", "> 5 sigma", "> limit", "mm", "°", "sigmas", "reason s", "back s")


def cells(name: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """One row: sums, and the worst of each kind."""
    results = [run.result for run in runs]
    reasons = [each.reason_s for each in results if each.reason_s is not None]
    return (
        name,
        str(len(runs)),
        str(sum(each.judged.total() for each in results)),
        str(sum(each.valid for each in results)),
        str(sum(each.beyond_sigmas for each in results)),
        str(sum(each.wrong for each in results)),
        f"{max(each.worst_mm for each in results):.3f}",
        f"{max(each.worst_deg for each in results):.4f}",
        f"{max(each.worst_sigmas for each in results):.1f}",
        f"{max(reasons):.2f}" if reasons else "–",
        f"{back:.2f}" if math.isfinite(back := max(each.back_s for each in results)) else f"> {BACK / 20:g}",
    )


def rows(runs: Sequence[Run]) -> list[tuple[str, ...]]:
    """The rows of these runs, in the order of the catalogue."""
    order = {name: number for number, name in enumerate((*FAULTS, PAIRS))}
    names = sorted({run.row for run in runs}, key=lambda name: order[name])
    return [cells(name, [run for run in runs if run.row == name]) for name in names]


def totals(runs: Sequence[Run]) -> Iterator[str]:
    """The figures of the contract."""
    told = [run for run in runs if not run.undetectable]
    judged: Counter[str] = sum((run.result.judged for run in runs), Counter())
    late = [run for run in told if run.is_blind and (run.result.reason_s or math.inf) > MAX_REASON_S]
    long = [run for run in told if run.result.back_s > MAX_BACK_S]
    yield f"{len(runs)} runs, {len(runs) - len(told)} of them undetectable; {judged.total()} values judged: " + (
        ", ".join(f"{wire} {count}" for wire, count in judged.most_common())
    )
    yield (
        f"shown as valid with an error above {LIMITS[0]:g} mm or {LIMITS[2]:g}°, too old or at odds with its "
        f"flag: {sum(run.result.wrong for run in told)} of {sum(run.result.valid for run in told)}, in "
        f"{sum(run.result.wrong > 0 for run in told)} runs"
    )
    yield (
        f"shown as valid with an error above {SIGMAS:g} sigma: {sum(run.result.beyond_sigmas for run in told)}, "
        f"in {sum(run.result.beyond_sigmas > 0 for run in told)} runs"
    )
    yield f"invalid without a reason: {sum(run.result.no_reason for run in told)}"
    yield f"without a measurable beam, and no reason within {MAX_REASON_S:g} s: {len(late)} runs"
    yield f"not valid again within {MAX_BACK_S:g} s of the fault's end: {len(long)} runs"


def text(runs: Sequence[Run]) -> Iterator[str]:
    """The table with columns under each other, the totals, and each run that failed."""
    told = [run for run in runs if not run.undetectable]
    table = [HEAD, *rows(told)]
    widths = [max(len(row[column]) for row in table) for column in range(len(HEAD))]
    for row in table:
        first, *others = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        yield "  ".join((row[0].ljust(widths[0]), *others))
    yield from totals(runs)
    for run in runs:
        for failure in failures(run):
            yield f"#{run.number} {run.unit}: {' + '.join(run.names)} ({run.note}): {failure}"
