"""``altd doctor``: what is wrong on this computer, and what mends it."""

from __future__ import annotations

import argparse

from altd.cli.arguments import add_config
from altd.process.standard_streams import say

SUMMARY = "list the faults of this computer, with remedies"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    add_config(parser)


def run(options: argparse.Namespace) -> int:
    """1 when something is wrong."""
    from altd.doctor.checks import examine
    from altd.doctor.finding import Verdict, in_lines

    findings = examine(options.config)
    say(*in_lines(findings))
    return int(any(finding.verdict is Verdict.WRONG for finding in findings))
