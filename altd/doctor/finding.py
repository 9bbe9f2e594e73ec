"""The result of a check: good, could be better, wrong, or nothing to check; and its remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    BETTER = "better"
    """The subject works but could be improved, or it could not be checked."""
    WRONG = "WRONG"
    SKIPPED = "skipped"
    """There is nothing to check: no such device, or the settings do without it."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor. ``remedy`` is a command, or a change in a file."""

    verdict: Verdict
    subject: str
    text: str
    remedy: str = ""


def good(subject: str, text: str) -> Finding:
    """Return a finding for a subject without faults."""
    return Finding(Verdict.GOOD, subject, text)


def better(subject: str, text: str, remedy: str = "") -> Finding:
    """Return a finding for a subject that works but could be improved."""
    return Finding(Verdict.BETTER, subject, text, remedy)


def wrong(subject: str, text: str, remedy: str) -> Finding:
    """Return a finding for a subject that fails or is unreliable."""
    return Finding(Verdict.WRONG, subject, text, remedy)


def skipped(subject: str, text: str) -> Finding:
    """Return a finding for a subject with nothing to check."""
    return Finding(Verdict.SKIPPED, subject, text)


def in_lines(findings: list[Finding]) -> list[str]:
    """Return the findings for a person, the remedy below each, and their numbers by verdict."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.verdict:<7} {finding.subject}: {finding.text}")
        if finding.remedy:
            lines.append(f"        fix: {finding.remedy}")
    wrongs, betters, goods, skips = (
        sum(finding.verdict is verdict for finding in findings)
        for verdict in (Verdict.WRONG, Verdict.BETTER, Verdict.GOOD, Verdict.SKIPPED)
    )
    counts = f"{wrongs} wrong, {betters} could be better, {goods} good"
    lines.append(f"{counts}, {skips} skipped" if skips else counts)
    return lines
