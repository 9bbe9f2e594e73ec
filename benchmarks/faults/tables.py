"""The table of the fault suite by fault, as text and as ``docs/studies/faults.md``."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

from benchmarks.campaign.judge import SIGMAS
from benchmarks.campaign.way import summary_of
from benchmarks.faults import real
from benchmarks.faults.catalogue import FAULTS
from benchmarks.faults.judging import LIMITS, MAX_BACK_S, MAX_REASON_S, Result
from benchmarks.harness import aligned, markdown_table
from tools.markdown import wrapped

PAIRS = "two at once"
HEAD = ("fault", "runs", "shown", "> 5 sigma", "wrong", "mm", "°", "sigmas", "reason s", "back s")
_GROUPS = {
    **{name: (fault.kind, fault.summary) for name, fault in FAULTS.items()},
    **{name: ("system", summary_of(fault)) for name, fault in real.FAULTS.items()},
    PAIRS: ("pairs", "Two faults, drawn together."),
}


@dataclass(frozen=True, slots=True)
class Run:
    """One run: its faults, their parameters, the reason if it is undetectable (else empty), the result."""

    number: int
    unit: str
    names: tuple[str, ...]
    note: str
    undetectable: str
    is_blind: bool
    result: Result

    @property
    def row(self) -> str:
        """Name of the table row that contains the run."""
        return self.names[0] if len(self.names) == 1 else PAIRS

    def as_json(self) -> str:
        """JSON text for the file of results."""
        result = {part.name: getattr(self.result, part.name) for part in fields(self.result)}
        return json.dumps({part.name: getattr(self, part.name) for part in fields(self)} | {"result": result})

    @classmethod
    def of_json(cls, line: str) -> Run:
        """Parse the output of ``as_json``."""
        told = json.loads(line)
        result = Result(**told["result"])
        result.judged, result.reasons = Counter(result.judged), Counter(result.reasons)
        return cls(**{**told, "names": tuple(told["names"]), "result": result})


def failures(run: Run) -> list[str]:
    """Failures of the unit in a run with detectable faults, as text."""
    result, found = run.result, []
    if run.undetectable:
        return []
    if result.beyond_sigmas or result.wrong:
        found.append(
            f"{result.beyond_sigmas} above {SIGMAS:g} sigma, {result.wrong} wrong of {result.valid}: "
            f"{result.worst_sigmas:.1f} sigma, {result.worst_mm:.3f} mm, {result.worst_deg:.4f}°"
        )
    if result.no_reason:
        found.append(f"{result.no_reason} invalid without a reason")
    if run.is_blind and (result.reason_s is None or result.reason_s > MAX_REASON_S):
        found.append(f"reason after {result.reason_s or math.inf:.2f} s")
    if not result.is_back:
        found.append(f"back after {result.back_s:.2f} s")
    return found


def _cells(name: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Cells of one row: sums, and the worst value of each kind."""
    results = [run.result for run in runs]
    reasons = [each.reason_s for each in results if each.reason_s is not None]
    return (
        name,
        str(len(runs)),
        str(sum(each.valid for each in results)),
        str(sum(each.beyond_sigmas for each in results)),
        str(sum(each.wrong for each in results)),
        f"{max(each.worst_mm for each in results):.3f}",
        f"{max(each.worst_deg for each in results):.4f}",
        f"{max(each.worst_sigmas for each in results):.1f}",
        f"{max(reasons):.2f}" if reasons else "–",
        f"{max((each.back_s for each in results if not each.was_invalid), default=math.inf):.2f}",
    )


def _rows(runs: Sequence[Run]) -> dict[str, tuple[str, ...]]:
    """Rows of these runs, by name in the order of the catalogue."""
    names = {run.row for run in runs}
    return {name: _cells(name, [run for run in runs if run.row == name]) for name in _GROUPS if name in names}


def totals(runs: Sequence[Run]) -> Iterator[str]:
    """Totals of the suite's criteria."""
    told = [run for run in runs if not run.undetectable]
    judged: Counter[str] = sum((run.result.judged for run in runs), Counter())
    wires = ", ".join(f"{wire} {count:,}" for wire, count in judged.most_common())

    def count_of(words: str, counts: Sequence[int]) -> str:
        return f"{words}: {sum(counts)}, in {sum(count > 0 for count in counts)} runs"

    shown = sum(run.result.valid for run in told)
    late = [run.is_blind and (run.result.reason_s or math.inf) > MAX_REASON_S for run in told]
    yield f"{len(runs)} runs, {len(runs) - len(told)} of them undetectable"
    yield f"{judged.total():,} answers and messages judged: {wires}"
    limits = f"{LIMITS[0]:g} mm or {LIMITS[2]:g}°, too old, or at odds with its own flag"
    yield count_of(f"of {shown:,} values shown, above {limits}", [run.result.wrong for run in told])
    yield count_of(f"above {SIGMAS:g} sigma", [run.result.beyond_sigmas for run in told])
    yield count_of("invalid without a reason", [run.result.no_reason for run in runs])
    yield count_of(f"nothing measurable, and no reason within {MAX_REASON_S:g} s", late)
    yield count_of(f"not back {MAX_BACK_S:g} s after the end", [not run.result.is_back for run in told])
    compared = [run.result.back_by_comparison for run in told]
    yield count_of("back at a place where a unit without the fault refuses too", compared)
    yield count_of("requests without an answer", [run.result.unanswered for run in runs])


def text(runs: Sequence[Run]) -> Iterator[str]:
    """Table with aligned columns, the totals, and each failed run."""
    table = [HEAD, *_rows([run for run in runs if not run.undetectable]).values()]
    yield from aligned(table)
    yield from totals(runs)
    yield from _failed(runs)


def _failed(runs: Sequence[Run]) -> Iterator[str]:
    for run in runs:
        for failure in failures(run):
            yield f"#{run.number} {run.unit}: {' + '.join(run.names)} ({run.note}): {failure}"


_PAGE = """\
# Fault suite: the whole daemon, disturbed and judged on its interfaces

This page gives the values and reasons that a disturbed unit shows, and its time to the next valid value.

{totals}

Command: `{command}`.

Each run starts the daemon with default settings and simulated cameras, disturbs it after 22 exposures, and
ends the fault after 1 to 2 s, or at an end of its own. HTTP, the local socket and Modbus TCP are asked at
each exposure. The telegram (every 0.1 s, through a pseudo terminal) and MQTT (every measurement, through
Mosquitto) are read as they come. Every answer is compared with the truth at its own time. The daemon's clock
is set, so that a run takes less than real time; threads, sockets and terminals are real. Faults of the
process run in real time: there the simulated cameras run in the daemon's process, and fail with it.
One run in five has two faults. Units: {units}. Exposure is fixed, and there are no frame LEDs.
OPC UA, Modbus RTU and the console are not judged.

| column | meaning |
|---|---|
| runs | those whose fault the drawn unit can detect |
| shown | values that were shown as valid, on all interfaces |
| > 5 sigma | of these, with an error above 5 published sigma |
| wrong | of these, above 0.15 mm or 0.03°, older than 1.55 s, or at odds with their own flag |
| mm, °, sigmas | largest errors of the values shown |
| reason s | longest time from the onset until all interfaces showed a reason; –: values stayed valid |
| back s | longest time from the end until all interfaces showed a value, or refused as without the fault |

A late reason is no defect while the values shown are right.
"""

_ELSEWHERE = """\
## Shown by other tests

In `tests/system/`, most of them against real parts:

| fault | test |
|---|---|
| power cut | `history/test_power_cut.py` |
| disk read-only, slow, gone | `history/test_daemon.py` |
| daemon killed, hung | `history/test_crash.py`, `test_live.py`, `test_systemd.py` |
| dead, dark and stray frame LEDs, camera moved | `test_self_check.py`, `test_self_check_lights.py` |
| camera process killed, link pulled, forged packets | `test_live.py` (GigE Vision) |
| USB camera and USB serial port pulled | `test_guest_unit.py`, `serial_port/test_usb.py` |
| broker absent, slow, killed | `publish/test_mqtt.py` |
| greedy and hostile clients | `publish/test_greedy_clients.py`, `make bench-hostile` |
| another unit's cameras | `test_wrong_camera.py`, [campaign](campaign.md) |
"""


def page(runs: Sequence[Run], command: str) -> str:
    """Page as Markdown."""
    told = [run for run in runs if not run.undetectable]
    units = ", ".join(sorted({run.unit for run in runs if run.number >= 0}))
    listed = "\n".join(f"- {line}" for line in totals(runs))
    sections = [_PAGE.format(totals=listed, command=command, units=units)]
    if failed := list(_failed(runs)):
        sections.append("## Failures\n\n" + "\n".join(f"- {line}" for line in failed) + "\n")
    rows = _rows(told)
    for group in dict.fromkeys(group for group, _ in _GROUPS.values()):
        of_group = {name: row for name, row in rows.items() if _GROUPS[name][0] == group}
        if of_group:
            sections.append(f"## {group.capitalize()}\n\n" + _table(of_group) + "\n")
    if hidden := _rows([run for run in runs if run.undetectable]):
        sections.append(
            "## Undetectable\n\nRuns that the drawn unit cannot detect, for the reasons in the "
            "[campaign](campaign.md#undetectable):\n\n" + _table(hidden) + "\n"
        )
    return wrapped("\n".join([*sections, _ELSEWHERE]))


def _table(rows: dict[str, tuple[str, ...]]) -> str:
    cells = [(name, _GROUPS[name][1].rstrip("."), *row[1:]) for name, row in rows.items()]
    return markdown_table((HEAD[0], "what happens", *HEAD[1:]), cells, text_columns=2)
