"""What a check found: good, could be better, or wrong, and then what mends it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How bad it is."""

    GOOD = "good"
    BETTER = "better"
    """It works, and could work better; or it could not be looked at."""
    WRONG = "WRONG"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor. ``mend`` is a command, or what to change in which file."""

    verdict: Verdict
    subject: str
    says: str
    mend: str = ""


def good(subject: str, says: str) -> Finding:
    """All is well with ``subject``."""
    return Finding(Verdict.GOOD, subject, says)


def better(subject: str, says: str, mend: str = "") -> Finding:
    """It works, and could work better."""
    return Finding(Verdict.BETTER, subject, says, mend)


def wrong(subject: str, says: str, mend: str) -> Finding:
    """It does not work, or not reliably."""
    return Finding(Verdict.WRONG, subject, says, mend)


def in_lines(findings: list[Finding]) -> list[str]:
    """The findings for a person, the remedy below each, and how many there are."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.verdict:<7} {finding.subject}: {finding.says}")
        if finding.mend:
            lines.append(f"        mend: {finding.mend}")
    wrongs, betters, goods = (
        sum(finding.verdict is verdict for finding in findings)
        for verdict in (Verdict.WRONG, Verdict.BETTER, Verdict.GOOD)
    )
    lines.append(f"{wrongs} wrong, {betters} could be better, {goods} good")
    return lines
