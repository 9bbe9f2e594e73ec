"""The result of a check: good, a warning, an error, or nothing to check; and its remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from altd.records import counted


class Verdict(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    WARNING = "warning"
    """The subject works but could be improved, or it could not be checked."""
    ERROR = "ERROR"
    """The subject fails or is unreliable."""
    SKIPPED = "skipped"
    """There is nothing to check: no such device, or the settings do without it."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor. ``remedy`` is a command, or a change in a file."""

    verdict: Verdict
    subject: str
    text: str
    remedy: str = ""

    @classmethod
    def good(cls, subject: str, text: str) -> Self:
        """Return a finding without a fault."""
        return cls(Verdict.GOOD, subject, text)

    @classmethod
    def warning(cls, subject: str, text: str, remedy: str = "") -> Self:
        """Return a warning."""
        return cls(Verdict.WARNING, subject, text, remedy)

    @classmethod
    def error(cls, subject: str, text: str, remedy: str) -> Self:
        """Return an error, which must have a remedy."""
        return cls(Verdict.ERROR, subject, text, remedy)

    @classmethod
    def skipped(cls, subject: str, text: str) -> Self:
        """Return a finding for a subject with nothing to check."""
        return cls(Verdict.SKIPPED, subject, text)


def in_lines(findings: list[Finding]) -> list[str]:
    """Return the findings for a person, the remedy below each, and their numbers by verdict."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.verdict:<7} {finding.subject}: {finding.text}")
        if finding.remedy:
            lines.append(f"        fix: {finding.remedy}")
    errors, warnings, goods, skips = (
        sum(finding.verdict is verdict for finding in findings)
        for verdict in (Verdict.ERROR, Verdict.WARNING, Verdict.GOOD, Verdict.SKIPPED)
    )
    counts = f"{counted(errors, 'error')}, {counted(warnings, 'warning')}, {goods} good"
    lines.append(f"{counts}, {skips} skipped" if skips else counts)
    return lines
