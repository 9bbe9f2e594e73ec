"""One target for a given time: fresh seeds, each finding shrunk and reported once."""

import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from fuzz.limits import bounded
from fuzz.target import Target
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings

EXAMPLES_A_SEED = 500
LONGEST_SHOWN = 3000


@dataclass(frozen=True)
class Finding:
    """A defect with the smallest input that hypothesis found for it."""

    example: object
    error: Exception

    def __str__(self) -> str:
        trace = traceback.format_exception(self.error)
        shown = repr(self.example)
        if len(shown) > LONGEST_SHOWN:
            shown = f"{shown[:LONGEST_SHOWN]}… ({len(shown)} characters)"
        return "".join((f"input: {shown}\n", *trace[-4:]))


@dataclass
class Tally:
    """The result of a run."""

    inputs: int
    seconds: float
    findings: list[Finding]


class _TimeIsUp(BaseException):
    """Ends hypothesis' loop in the middle; it takes an Exception for a failing example."""


def fuzz(target: Target, for_s: float, report: Callable[[Finding], None], first_seed: int) -> Tally:
    """Try inputs until the time is up; ``report`` is called with each new finding at once.

    Two failures are the same finding when type and place of their exceptions are the same.
    """
    began, known, number = time.monotonic(), set[tuple[object, ...]](), first_seed
    tally = Tally(0, 0.0, [])
    with suppress(_TimeIsUp):
        while True:
            finding = _one_seed(target, number, tally, began + for_s, known)
            if finding is not None:
                known.add(_place(finding.error))
                tally.findings.append(finding)
                report(finding)
            number += 1
    tally.seconds = time.monotonic() - began
    return tally


def _one_seed(
    target: Target, number: int, tally: Tally, ends: float, known: set[tuple[object, ...]]
) -> Finding | None:
    failed: list[Finding] = []

    @seed(number)
    @settings(
        max_examples=EXAMPLES_A_SEED,
        database=None,
        deadline=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
    )
    @given(target.EXAMPLES)
    def run(example: Any) -> None:
        if not failed and time.monotonic() >= ends:
            raise _TimeIsUp
        tally.inputs += 1
        try:
            with bounded():
                target.check(example)
        except Exception as error:
            if _place(error) in known:
                return
            failed.append(Finding(example, error))  # the last one is the smallest
            raise

    try:
        run()
    except Exception:
        if not failed:  # not the target's: the strategy's own
            raise
        return failed[-1]
    return None


def _place(error: Exception) -> tuple[object, ...]:
    frames = traceback.extract_tb(error.__traceback__)
    return type(error), *((frame.filename, frame.lineno) for frame in frames[-1:])
