"""What the commands do; each takes the parsed arguments and returns the exit status."""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import cv2

from altd.endings import EndedBySignal, until_signal
from altd.errors import BadInputError
from altd.logs import logging_to_stderr
from altd.standard_streams import complain

if TYPE_CHECKING:  # a command imports what it needs and no more
    from altd.calibration.result import CalibrationResult
    from altd.recording import Recording
    from altd.scan_screen import ScanScreen
    from altd.service.scan import Scanner

log = logging.getLogger("altd")


def run(options: argparse.Namespace) -> int:
    """Run the command that ``options`` names."""
    commands: dict[str, Callable[[argparse.Namespace], int]] = {
        "run": _run,
        "calibrate": _calibrate,
        "replay": _replay,
        "record": _record,
        "scan": _scan,
        "lamps": _lamps,
        "locate": _locate,
        "map": _map,
        "check-config": _check_config,
        "devices": _devices,
        "doctor": _doctor,
    }
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # an unreadable image is our own error line, not OpenCV's
    cv2.setNumThreads(1)  # a frame is small: more threads cost more than they bring
    return commands[options.command](options)


def _run(options: argparse.Namespace) -> int:
    from altd.app import daemon_of
    from altd.settings import load_settings

    prefix = "" if "JOURNAL_STREAM" in os.environ else "altd: "  # the journal puts our name there itself
    with logging_to_stderr(logging.INFO, prefix):
        daemon = daemon_of(load_settings(options.config), options.config)
        try:
            asyncio.run(until_signal(daemon.run()))
        except BadInputError:
            raise
        except EndedBySignal:
            return 0  # how a service ends
        except Exception:
            log.critical("a defect ended the daemon", exc_info=True)
            return 1
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    from altd.calibration.file import save_calibration
    from altd.calibration.report.write import check_report, write_together
    from altd.files.writing import check_replaceable
    from altd.recording import open_recording
    from altd.recording_gaps import gap_lines

    check_replaceable(options.output)
    if options.report is not None:
        check_report(options.report)
    recording = open_recording(options.recording)
    for line in gap_lines(recording):
        complain(f"altd calibrate: {line}")
    result = _calibrated(recording, options.flat)
    report = {} if options.report is None else _report(options, recording, result)
    save_calibration(result.calibration, options.output)
    if options.report is not None:
        write_together(options.report, report)
    _print_result(result)
    if report:
        print(f"report: {', '.join(str(options.report / name) for name in report)}")
    return 0


def _calibrated(recording: Recording, flat: Path | None) -> CalibrationResult:
    from altd.calibration.flat import flats_of
    from altd.calibration.plate import calibrate_plate
    from altd.calibration.scan import calibrate_scan
    from altd.recording import open_recording

    progress = _progress("frames")
    if recording.header.kind == "plate":
        if flat is not None:
            raise BadInputError(flat, "is for a scan; a plate shows no laser spot")
        return calibrate_plate(recording, progress=progress)
    flats = flats_of(open_recording(flat), recording.header, progress) if flat else {}
    return calibrate_scan(recording, flats, progress=progress)


def _print_result(result: CalibrationResult) -> None:
    for line in result.refused:
        complain(f"altd calibrate: left out: {line}")
    for line in result.doubts:
        complain(f"altd calibrate: doubtful: {line}")
    print(f"unit {result.calibration.unit_serial}, {result.calibration.recording_note}")
    if result.calibration.simulated:
        print("made from SIMULATED frames: every measurement with it says `simulated`")
    print(
        "target  map            left out px   residual mean / std / max mm   repeatability u / v px   LEDs"
        "   cross-check    apart / bound px"
    )
    for target in result.calibration.targets:
        print(
            f"{target.name:<7} {target.map.name:<14} {target.left_out_px:.3f}         "
            f"{target.residual_mean_mm:.4f} / {target.residual_std_mm:.4f} / {target.residual_max_mm:.4f}"
            f"       {target.repeatability_px[0]:.3f} / {target.repeatability_px[1]:.3f}"
            f"            {len(target.leds_px)}"
            f"      {target.cross_check.map.name:<14} {target.cross_check.largest_px:.2f} / "
            f"{target.cross_check.bound_px:.2f}"
        )
    for line in result.remarks:
        print(line)


def _report(options: argparse.Namespace, recording: Recording, result: CalibrationResult) -> dict[str, bytes]:
    """The report's files by name; matplotlib is there, somebody looked."""
    from altd.calibration.report.content import report_on
    from altd.calibration.report.page import html_page
    from altd.calibration.report.pictures import scan_negatives
    from altd.calibration.report.sheets import pdf_sheets
    from altd.calibration.report.source import Source
    from altd.calibration.report.write import PAGE, SHEETS

    given = [options.recording, *(["--flat", options.flat] if options.flat else [])]
    given += ["-o", options.output, "--report", options.report]
    command = shlex.join(["altd", "calibrate", *map(str, given)])
    show = _progress("files of the report")
    show(0, 2)
    try:
        negatives = scan_negatives(recording)
        document = report_on(
            Source(result.calibration, result.evidence, negatives, command, recording.header)
        )
    except ValueError as error:
        raise BadInputError(options.recording, str(error)) from error
    files = {PAGE: html_page(document), SHEETS: pdf_sheets(document, result.calibration.created)}
    show(2, 2)
    return files


def _replay(options: argparse.Namespace) -> int:
    from altd.answers.replay import Question, answer

    question = Question(
        options.recording,
        options.calibration,
        options.window,
        options.every,
        options.format,
        options.output,
        options.plot,
    )
    into_file = options.output is not None
    progress = _progress("frames") if into_file else lambda done, total: None
    answer(question, lambda line: complain(f"altd replay: {line}"), progress)
    return 0


def _record(options: argparse.Namespace) -> int:
    from altd.app import record_of
    from altd.settings import load_settings

    config = load_settings(options.config)
    show, kept = _progress("exposures"), 0

    def progress(done: int, planned: int) -> None:
        nonlocal kept
        kept = done
        show(done, planned)

    with logging_to_stderr(logging.WARNING):
        work = record_of(config, options.config, options.output, options.seconds, options.kind, progress)
        try:
            exposures = asyncio.run(until_signal(work))
        except EndedBySignal:
            complain(
                f"altd record: interrupted: {kept} exposures in {options.output}"
                if kept
                else "altd record: interrupted before the first exposure"
            )
            raise
    complain(f"{exposures} exposures in {options.output}")
    return 0


def _scan(options: argparse.Namespace) -> int:
    from altd.app import scanner_of
    from altd.scan_screen import ScanScreen
    from altd.settings import load_settings

    screen = ScanScreen()
    with logging_to_stderr(logging.ERROR):
        scanner = scanner_of(load_settings(options.config), options.config, options.output, screen)
        return run_scan(scanner, options.output, screen)


def run_scan(scanner: Scanner, output: Path, screen: ScanScreen) -> int:
    """Scan until done, stopped or interrupted, and say how it ended; the exit status."""
    from altd.service.scan import ScanStoppedError

    again = "the same command goes on from there"
    try:
        result = asyncio.run(until_signal(scanner.run()))
    except ScanStoppedError as error:
        screen.say(f"stopped: {error}; {again}")
        return 1
    except EndedBySignal:
        screen.say(f"interrupted; {again}")
        raise
    finally:
        screen.clear()
    for line in result.refused:
        screen.say(f"without {line}")
    screen.say(f"{result.exposures} exposures in {output}")
    return 0


def _lamps(options: argparse.Namespace) -> int:
    from altd.config import CameraLamps
    from altd.lamps_by_hand import LampsByHand
    from altd.parts import cameras_of, indicators_of, lamps_of
    from altd.ports import Indicator, LampsError
    from altd.settings import load_settings

    config, place = load_settings(options.config), options.config
    stopped = options.look == "stopped"
    if stopped and isinstance(config.lamps, CameraLamps):
        config = config.model_copy(
            update={"lamps": None}
        )  # of a dead daemon's camera nobody gets hold at once
    if config.lamps is None and config.indicators is None and not stopped:
        raise BadInputError(place, "no [lamps] and no [indicators] table")
    cameras = cameras_of(config, place) if isinstance(config.lamps, CameraLamps) else {}
    fitted = [Indicator(key) for key in config.indicators.lines] if config.indicators is not None else []
    lamps, indicators = lamps_of(config, cameras, place, alone=True), indicators_of(config)
    by_hand = LampsByHand(lamps, indicators, fitted, lambda line: print(line, flush=True))
    failed = os.environ.get("SERVICE_RESULT", "success") != "success"
    looks: dict[str, Callable[[], None]] = {
        "off": lambda: by_hand.leave(frozenset()),
        "on": lambda: by_hand.light_until(interrupted.wait),
        "test": by_hand.light_in_turn,
        "stopped": lambda: by_hand.leave(frozenset({Indicator.ERROR} if failed else ())),
    }
    interrupted, interrupts = threading.Event(), list[EndedBySignal]()

    def interrupt(number: int, frame: FrameType | None) -> None:
        """What is lit gets dark on the way out; a library's callback swallows what is raised in it."""
        interrupts.append(EndedBySignal(number))
        interrupted.set()
        raise interrupts[0]

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)
    try:
        looks[options.look]()
        if interrupts:
            raise interrupts[0]
    except LampsError as error:
        complain(f"altd lamps: {error}")
        return 1
    return 0


def _locate(options: argparse.Namespace) -> int:
    from altd.answers.locate import answer

    return answer(options.images, options.format, lambda line: complain(f"altd locate: {line}"))


def _map(options: argparse.Namespace) -> int:
    from altd.answers.map import answer

    return answer(
        options.calibration, options.target, options.format, lambda line: complain(f"altd map: {line}")
    )


def _check_config(options: argparse.Namespace) -> int:
    from altd.parts import check_files, missing_files
    from altd.settings import load_settings

    config = load_settings(options.config)
    calibration, errors = check_files(config)
    for error in errors:
        complain(f"altd check-config: {error}")
    if errors:
        return 2
    simulated = ", calibrated from SIMULATED frames" if calibration and calibration.simulated else ""
    print(f"{options.config}: good: unit {config.unit.serial}, {len(config.targets)} targets{simulated}")
    for missing in missing_files(config):
        print(f"{options.config}: {missing.keys}: {missing.path} is not there yet; {missing.maker} makes it")
    return 0


def _devices(_options: argparse.Namespace) -> int:
    from altd.inventory import lines

    for line in lines():
        print(line, flush=True)
    return 0


def _doctor(options: argparse.Namespace) -> int:
    from altd.doctor.checks import examine
    from altd.doctor.finding import Verdict, in_lines

    findings = examine(options.config)
    print("\n".join(in_lines(findings)))
    return int(any(finding.verdict is Verdict.WRONG for finding in findings))


def _progress(what: str) -> Callable[[int, int], None]:
    """A counter on a terminal's stderr; nothing in a pipe."""
    if not sys.stderr.isatty():
        return lambda done, total: None

    def show(done: int, total: int) -> None:
        if done == total:
            sys.stderr.write("\r\033[K")
        elif done % 8 == 0:
            sys.stderr.write(f"\r{done}/{total} {what}")
        sys.stderr.flush()

    return show
