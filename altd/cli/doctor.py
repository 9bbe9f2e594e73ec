"""``altd doctor``: lists the faults of this computer, with remedies."""

from __future__ import annotations

import argparse

from altd.cli.arguments import add_config
from altd.process.standard_streams import print_lines

SUMMARY = "list the faults of this computer, with remedies"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_config(parser)


def run(options: argparse.Namespace) -> int:
    """Print the findings; return 1 if there are errors."""
    from altd.doctor.checks import examine, in_lines
    from altd.process.machine import Verdict

    findings = examine(options.config)
    print_lines(*in_lines(findings))
    return int(any(finding.verdict is Verdict.ERROR for finding in findings))
