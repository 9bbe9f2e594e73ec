"""``altd verify``: checks whether a unit measures known beams as exactly as it states."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from altd.cli.arguments import progress_on
from altd.errors import BadInputError
from altd.process.standard_streams import print_lines
from altd.records import counted

SUMMARY = "check a unit against known beams, in the manner of ISO 17123: verdict, statistics, limits"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="folder of a set: a scan, a measurement with known positions, or a plate with `--shift`",
    )
    parser.add_argument(
        "--plan",
        action="store_true",
        help="RECORDING is the settings of a planned scan: what each test will be able to detect",
    )
    parser.add_argument(
        "--calibration", type=Path, required=True, metavar="FILE", help="calibration of the recorded unit"
    )
    parser.add_argument(
        "--compare", type=Path, metavar="FILE", help="also compare with an earlier verification (JSON)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="also write verification.html and verification.json into DIR",
    )


def run(options: argparse.Namespace) -> int:
    """Print the verdict with its tests; return 0 if passed, 1 if not."""
    from altd.answers.verify import plan, verify
    from altd.calibration.report.write import check_report, write_together

    if options.plan and (options.output or options.compare):
        raise BadInputError("--plan", "has no -o and no --compare: nothing is measured")
    names = ("verification.html", "verification.json")
    if options.output is not None:
        check_report(options.output, names, "-o DIR")
    if options.plan:
        document = plan(options.recordings, options.calibration)
    else:
        document = verify(options.recordings, options.calibration, options.compare, progress_on("frames"))
    text = json.dumps(document, allow_nan=False)
    files = dict[str, bytes]()
    if options.output is not None:
        files = {"verification.json": text.encode() + b"\n"}
        if document["of"] == "beams":
            from altd.calibration.report.html import html_page
            from altd.calibration.report.verification import verification_page

            files["verification.html"] = html_page(verification_page(document))
        write_together(options.output, files)
    if options.json:
        print_lines(text)
    else:
        print_lines(*_lines(document))
        if options.output is not None:
            print_lines(f"written: {', '.join(str(options.output / name) for name in sorted(files))}")
    return 0 if document["verdict"] in ("passed", "decides") else 1


def _lines(document: dict[str, Any]) -> Iterator[str]:
    """Yield the verdict, its reasons, the tests and the comparison."""
    simulated = ", SIMULATED" if document["origin"] == "simulated" else ""
    of = "" if (is_of_beams := document.get("of", "beams") == "beams") else f", {document['of']}"
    yield f"unit {document['unit']}{of}{simulated}: {document['verdict'].upper()}"
    yield from (f"  {reason}" for reason in document["reasons"])
    columns = "{:<36}{:>11}{:>13}{:>11}{:>12}{:>10}  {}"
    if document["tests"]:
        yield columns.format("test", "found", "uncertainty", "limit", "detectable", "required", "result")
    for test in document["tests"]:
        numbers = (_number(test, key) for key in ("value", "sigma", "limit", "detectable", "required"))
        yield columns.format(f"{test['name']}, {test['unit'].strip()}", *numbers, test["result"])
    if not is_of_beams:
        yield from map(_plate_line, document["sets"])
        yield "not tested: zero and scale of yaw and pitch, distance of the targets, the laser spot"
    if (change := document["comparison"]) is None:
        return
    yield f"compared with {change['created']} ({change['verdict']}):"
    yield "{:<36}{:>11}{:>13}{:>11}  {}".format("", "change", "uncertainty", "limit", "result")
    for one in change["changes"]:
        numbers = (_number(one, key) for key in ("change", "sigma", "limit"))
        result = "changed" if one["changed"] else "no significant change"
        yield "{:<36}{:>11}{:>13}{:>11}  {}".format(f"{one['name']}, {one['unit'].strip()}", *numbers, result)


def _plate_line(one: dict[str, Any]) -> str:
    return (
        f"{one['target']}: {one['valid']} of {counted(one['positions'], 'disc')}, "
        f"rms {one['rms_mm']:.3f} mm, greatest {one['max_mm']:.3f} mm, "
        f"rms(error/sigma) {one['rms_of_sigma']:.2f}; "
        f"{one['recording']} shifted by {', '.join(f'{mm:g}' for mm in one['shift_mm'])} mm"
    )


def _number(test: dict[str, Any], key: str) -> str:
    value, decimals = test[key], test["decimals"]
    return "-" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"
