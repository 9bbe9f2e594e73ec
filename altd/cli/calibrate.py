"""``altd calibrate``: makes the calibration file from scans or plates."""

from __future__ import annotations

import argparse
import itertools
import json
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from altd.cli.arguments import add_output, progress_on
from altd.errors import BadInputError
from altd.process.standard_streams import print_errors, print_lines

if TYPE_CHECKING:
    from altd.calibration.report.certificate_facts import Facts
    from altd.calibration.result import CalibrationResult
    from altd.recording.reader import Recording

_BESIDE = Path()
"""Value of ``--report`` without a folder."""

SUMMARY = "make a calibration file from scans, LED plates or known poses; print the residuals"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="folder of a scan, plate or planar recording",
    )
    add_output(parser, "FILE", "calibration file to write")
    parser.add_argument(
        "--flat",
        type=Path,
        metavar="DIR",
        help="recording of kind flat: the targets in even light, or under the laser",
    )
    parser.add_argument(
        "--service",
        type=Path,
        metavar="DIR",
        help="recording of service with the beam all over the targets: a flat is learnt from its spots",
    )
    parser.add_argument(
        "--report",
        type=_report_folder,
        nargs="?",
        const=_BESIDE,
        metavar="DIR",
        help="write a report, HTML and PDF, under FILE's name; without DIR beside FILE",
    )
    parser.add_argument(
        "--certificate",
        type=Path,
        metavar="FACTS.toml",
        help="make the report a calibration certificate with these facts; with XML",
    )


def _report_folder(text: str) -> Path:
    """Return the folder of ``--report``; refuse a recording, which was meant to be calibrated."""
    from altd.recording.header import HEADER_FILE

    path = Path(text)
    if (path / HEADER_FILE).exists():
        raise argparse.ArgumentTypeError(f"{text} is a recording: write --report after the recordings")
    return path


def run(options: argparse.Namespace) -> int:
    """Calibrate, write file and report together, and print the results."""
    from altd.app.calibration_summary import why_unusable
    from altd.calibration.calibrating import calibrate
    from altd.calibration.file import save_calibration
    from altd.calibration.report.write import check_report, report_names, write_together
    from altd.files.writing import check_replaceable
    from altd.recording.reader import gap_lines, open_recording

    check_replaceable(options.output)
    facts = None
    if options.certificate is not None:
        from altd.calibration.report.certificate_facts import load_facts

        facts = load_facts(options.certificate)
        options.report = options.report or _BESIDE
    folder = options.output.parent if options.report is _BESIDE else options.report
    if folder is not None:
        check_report(folder, report_names(options.output, facts is not None))
    recordings = [open_recording(path) for path in options.recordings]
    if any(recording.header.kind == "planar" for recording in recordings):
        return _run_planar(options, recordings)
    for path, recording in zip(options.recordings, recordings, strict=True):
        for target in recording.header.shown_targets:
            if why := why_unusable(target.name):
                raise BadInputError(path, f"target {target.name!r} {why}: record it with another name")
        for line in gap_lines(recording):
            print_errors(f"altd calibrate: {line}")
    flat = None if options.flat is None else open_recording(options.flat)
    service = None if options.service is None else open_recording(options.service)
    result = calibrate(recordings, flat, progress_on("frames"), service)
    report = {} if options.report is None else _report(options, recordings, result, facts)
    save_calibration(result.calibration, options.output)
    if folder is not None:
        write_together(folder, report)
    _print_result(result)
    if report:
        print_lines(f"report: {', '.join(str(folder / name) for name in report)}")
    return 0


def _run_planar(options: argparse.Namespace, recordings: Sequence[Recording]) -> int:
    """Calibrate the instrument ``planar``."""
    from altd.calibration.planar import calibrate_planar
    from altd.calibration.planar_file import save_planar_calibration
    from altd.recording.reader import gap_lines

    for option in ("flat", "service", "report", "certificate"):
        if getattr(options, option) is not None:
            raise BadInputError(f"--{option}", "is not made of a recording of kind 'planar'")
    for line in itertools.chain.from_iterable(map(gap_lines, recordings)):
        print_errors(f"altd calibrate: {line}")
    result = calibrate_planar(recordings, progress_on("frames"))
    save_planar_calibration(result.calibration, options.output)
    for line in result.refused:
        print_errors(f"altd calibrate: left out: {line}")
    for line in result.doubts:
        print_errors(f"altd calibrate: doubtful: {line}")
    for line in result.lines():
        print_lines(line)
    return 0


def _print_result(result: CalibrationResult) -> None:
    from altd.calibration.report.budget import budget_of
    from altd.calibration.report.verdict import judge

    judged = None
    with suppress(ValueError):  # no uncertainty of a beam: the targets have no area in common
        budget = budget_of(result.calibration, result.evidence)
        judged = judge(result.calibration, result.evidence, budget)
    for line in result.refused:
        print_errors(f"altd calibrate: left out: {line}")
    for line in result.doubts:
        print_errors(f"altd calibrate: doubtful: {line}")
    print_lines(f"unit {result.calibration.unit_serial}, {result.calibration.recording_note}")
    if judged is not None:
        for line in (judged.headline, *judged.uncertainty):
            print_lines(line)
    if result.calibration.simulated:
        print_lines("made from SIMULATED frames: every measurement with it is marked `simulated`")
    print_lines(
        "target  map            left out px   residual mean / std / max mm   repeatability u / v px   LEDs"
        "   cross-check    apart / bound px"
    )
    for target in result.calibration.targets:
        print_lines(
            f"{target.name:<7} {target.map.name:<14} {target.leave_one_out_px:.3f}         "
            f"{target.residual_mean_mm:.4f} / {target.residual_std_mm:.4f} / {target.residual_max_mm:.4f}"
            f"       {target.repeatability_px[0]:.3f} / {target.repeatability_px[1]:.3f}"
            f"            {len(target.leds_px)}"
            f"      {target.cross_check.map.name:<14} {target.cross_check.max_difference_px:.2f} / "
            f"{target.cross_check.limit_px:.2f}"
        )
    for line in result.remarks:
        print_lines(line)


def _report(
    options: argparse.Namespace,
    recordings: Sequence[Recording],
    result: CalibrationResult,
    facts: Facts | None,
) -> dict[str, bytes]:
    """Return the report's files by name; the presence of matplotlib was checked before."""
    from altd.calibration.report.budget import budget_of
    from altd.calibration.report.content import report_on
    from altd.calibration.report.dcc import dcc_xml
    from altd.calibration.report.html import html_page
    from altd.calibration.report.picture_sections import scan_negatives
    from altd.calibration.report.sheets import pdf_sheets
    from altd.calibration.report.write import Source, report_names
    from altd.calibration.target_frames import target_frames

    given = [*options.recordings, *(["--flat", options.flat] if options.flat else [])]
    given += ["--service", options.service] if options.service else []
    given += ["-o", options.output, "--report", *([] if options.report is _BESIDE else [options.report])]
    given += ["--certificate", options.certificate] if options.certificate else []
    command = shlex.join(["altd", "calibrate", *map(str, given)])
    show = progress_on("files of the report")
    show(0, 2)
    try:
        negatives = scan_negatives(target_frames(recordings))
        headers = tuple(recording.header for recording in recordings)
        budget = budget_of(result.calibration, result.evidence)
        source = Source(result.calibration, result.evidence, negatives, command, headers)
        document = report_on(source, budget, facts)
    except ValueError as error:
        raise BadInputError(", ".join(map(str, options.recordings)), str(error)) from error
    contents = [html_page(document), pdf_sheets(document, result.calibration.created)]
    contents.append((json.dumps(budget.as_object(), indent=1) + "\n").encode())
    if facts is not None:
        contents.append(dcc_xml(facts, source, budget))
    files = dict(zip(report_names(options.output, facts is not None), contents, strict=True))
    show(2, 2)
    return files
