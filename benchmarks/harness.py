"""The harness of all benchmarks: arguments, progress, tables, files, child processes, and the end."""

import argparse
import contextlib
import dataclasses
import json
import math
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import cv2
import numpy as np

from altd.cli.arguments import Parser as OneLineParser
from altd.files.writing import check_replaceable, write_file
from altd.process.endings import run_to_end

HOST = "127.0.0.1"
KEYS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")
"""Keys of a measurement's values."""
ROOT = Path(__file__).resolve().parents[1]
"""Folder in which child processes start."""
_START_TIMEOUT_S = 120.0
_END_TIMEOUT_S = 30.0
_RESULT_TIMEOUT_S = 300.0
_POLL_INTERVAL_S = 0.01
_MAX_QUOTED = 2000
"""Characters of a child's output in an error: the last ones, which contain the cause."""


class Parser(OneLineParser):
    """Parser of a benchmark's arguments: the help states each default, and an error is one line."""

    def __init__(self, module: str, description: str | None, epilog: str | None = None) -> None:
        super().__init__(prog=f"python -m {module}", description=description, epilog=epilog)

    def count(self, name: str, default: int | None, what: str, least: int = 1) -> None:
        """Add an option for a whole number."""
        self._add_number(name, default, what, "N", _number_in(int, least, math.inf))

    def number(
        self,
        name: str,
        default: float | None,
        what: str,
        unit: str = "SECONDS",
        limits: tuple[float, float] | None = None,
    ) -> None:
        """Add an option for a number above 0, or within the limits; ``unit`` is shown in the help."""
        low, high = limits or (math.nan, math.inf)
        self._add_number(name, default, what, unit, _number_in(float, low, high))

    def seed(self, default: int = 1) -> None:
        """Add ``--seed``."""
        self.count("--seed", default, "of the random numbers", least=0)

    def names(self, name: str, known: Sequence[str], what: str, default: Sequence[str] | None = None) -> None:
        """Add an option for known names, separated by commas."""

        def read(text: str) -> tuple[str, ...]:
            given = tuple(part for part in text.split(",") if part)
            if unknown := [part for part in given if part not in known]:
                raise argparse.ArgumentTypeError(f"unknown {unknown[0]!r}; known are {', '.join(known)}")
            return given

        self.add_argument(name, type=read, default=default, metavar="NAME,...", help=what)

    def file(self, name: str, what: str) -> None:
        """Add an option for a file of results; raises BadInputError when parsed if it cannot be written."""

        def read(text: str) -> Path:
            check_replaceable(Path(text))
            return Path(text)

        self.add_argument(name, type=read, metavar="FILE", help=what)

    def json(self) -> None:
        """Add ``--json``, see ``write_json``."""
        self.file("--json", "write the figures there too")

    def page(self) -> None:
        """Add ``--page``, see ``write_page``."""
        self.file("--page", "write the page there")

    def _add_number(
        self, name: str, default: float | None, what: str, unit: str, read: Callable[[str], float]
    ) -> None:
        stated = "" if default is None else f" (default {default:g})"
        self.add_argument(name, type=read, default=default, metavar=unit, help=what + stated)


def _number_in(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Parser of a number from ``low`` to ``high``; NaN as ``low``: above 0."""
    limits = "above 0" if math.isnan(low) else f"from {low:g}" + (f" to {high:g}" if high < math.inf else "")

    def read(text: str) -> float:
        with contextlib.suppress(ValueError):
            value = kind(text)
            if (value > 0 if math.isnan(low) else value >= low) and value <= high and math.isfinite(value):
                return value
        whole = "whole " if kind is int else ""
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a {whole}number {limits}")

    return read


def end(main: Callable[[], int], module: str) -> NoReturn:
    """End the process of a benchmark with the status of its ``main``, see ``run_to_end``."""
    sys.exit(run_to_end(main, lambda: module))


def show(what: str) -> None:
    """Show one line of progress on standard error if that is a terminal; an empty one erases it."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{what}")
        sys.stderr.flush()


def quiet(done: int, planned: int) -> None:
    """Show no progress: for functions that report it."""


_PLACE = re.compile(r"^[<>^]|(?<![.\d])\d+")
"""Alignment and width in the format of a value."""


class Columns:
    """Table of columns with fixed widths, whose rows are printed as they come.

    A column is its heading and the format of its values, such as ``"peak MB:>9.0f"``; one without a width
    belongs at the end.
    """

    def __init__(self, *columns: str) -> None:
        parts = [column.rpartition(":") for column in columns]
        self._formats = [spec for _, _, spec in parts]
        self._places = ["".join(_PLACE.findall(spec)) for spec in self._formats]
        self.head = self.row(*(name for name, _, _ in parts))

    def row(self, *values: object) -> str:
        """Line of the first columns' values; a text may replace any value, None leaves it blank."""
        columns = zip(values, self._formats, self._places, strict=False)
        return "".join(_cell(value, spec, place) for value, spec, place in columns).rstrip()


def _cell(value: object, spec: str, place: str) -> str:
    if value is None or isinstance(value, str):
        return format(value or "", place)
    return format(value, spec)


def aligned(rows: Sequence[Sequence[str]], text_columns: int = 1) -> Iterator[str]:
    """Lines of a table with its head: the first columns to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (
            cell.ljust(width) if place < text_columns else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        yield "  ".join(cells).rstrip()


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """Table of a page: the first columns are text, the others numbers."""
    rule = ["---"] * text_columns + ["---:"] * (len(head) - text_columns)
    return "\n".join("|" + "|".join(row) + "|" for row in (head, rule, *rows))


def write_page(path: Path, page: str) -> None:
    """Write a page completely or not at all; raises BadInputError."""
    write_file(path, page.encode())


def write_json(path: Path | None, figures: object) -> None:
    """Write figures, whose parts may be dataclasses, if there is a path; raises BadInputError."""
    if path is not None:
        write_file(path, (json.dumps(figures, indent=1, default=dataclasses.asdict) + "\n").encode())


def machine() -> dict[str, str]:
    """Processor, load and versions that figures depend on."""
    model = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {
        "cpu": model[0].split(":", 1)[1].strip() if model else platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load before": f"{os.getloadavg()[0]:.2f}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


def until(holds: Callable[[], bool], timeout_s: float, what: str | Callable[[], str]) -> None:
    """Wait until a condition holds; raises TimeoutError with ``what``, as text or a function of it."""
    deadline_s = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"not within {timeout_s:g} s: {what if isinstance(what, str) else what()}")
        time.sleep(_POLL_INTERVAL_S)


def cpu_s(pid: int) -> float:
    """Processor seconds of all threads of a process so far (proc(5), /proc/PID/stat)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Child:
    """A process that ``child`` runs, with its output in a file."""

    process: subprocess.Popen[bytes]
    log: BinaryIO
    ending: signal.Signals

    @property
    def output(self) -> str:
        """Complete output so far, with that of earlier processes in the same file."""
        return os.pread(self.log.fileno(), os.fstat(self.log.fileno()).st_size, 0).decode()

    def await_text(self, text: str, timeout_s: float = _START_TIMEOUT_S) -> None:
        """Wait until the output contains a text; raises RuntimeError with the actual output."""
        deadline_s = time.monotonic() + timeout_s
        while text not in self.output:
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError(f"{self.described()} did not say {text!r}")
            time.sleep(_POLL_INTERVAL_S)

    def result(self, timeout_s: float = _RESULT_TIMEOUT_S) -> str:
        """Close its standard input, wait for its end, and return its output.

        Raises RuntimeError with the output if it fails, and subprocess.TimeoutExpired.
        """
        if self.process.stdin is not None:
            self.process.stdin.close()
        if self.process.wait(timeout_s):
            raise RuntimeError(self.described())
        return self.output

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process."""
        self.process.send_signal(number)

    def kill(self) -> None:
        """Kill the process without notice."""
        self.process.kill()
        self.process.wait()

    def cpu_s(self) -> float:
        """Processor seconds of all its threads so far."""
        return cpu_s(self.process.pid)

    def end(self) -> None:
        """Request the process to end; kill it if it does not."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(self.ending)
            try:
                self.process.wait(_END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.kill()
        if self.process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.process.stdin.close()

    def explain(self, error: BaseException) -> None:
        """Add its output to an error if it has failed before."""
        if self.process.poll():
            error.add_note(self.described())

    def described(self) -> str:
        """Command, state and output, for an error."""
        status = self.process.poll()
        ended = "is running" if status is None else f"ended with status {status}"
        return f"{self.process.args!r} {ended}; its output: {self.output[-_MAX_QUOTED:]!r}"


@contextlib.contextmanager
def child(
    command: Sequence[str | Path],
    log: Path | None = None,
    ending: signal.Signals = signal.SIGTERM,
    **settings: Any,
) -> Iterator[Child]:
    """Run a process within the block; it ends with the block, also if the block raises.

    Its output is appended to ``log``, or to a temporary file. If it has failed before, an error
    of the block quotes it. ``settings`` are those of ``subprocess.Popen``.
    """
    with tempfile.TemporaryFile() if log is None else log.open("a+b") as output:
        usual: dict[str, Any] = {
            "stdin": subprocess.DEVNULL,
            "stdout": output,
            "stderr": subprocess.STDOUT,
            "cwd": ROOT,
        }
        words = [str(word) for word in command]
        process = subprocess.Popen(words, **usual | settings)  # noqa: S603  our own programs
        running = Child(process, output, ending)
        try:
            yield running
        except Exception as error:
            running.explain(error)
            raise
        finally:
            running.end()


@contextlib.contextmanager
def meanwhile(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run ``work`` in a thread within the block; at the end of the block its event is set, and it returns."""
    ended = threading.Event()
    thread = threading.Thread(target=work, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def module_command(module: str, *arguments: object) -> list[str]:
    """Command that runs a module of this project."""
    return [sys.executable, "-m", module, *map(str, arguments)]


def reporter(module: str, *arguments: object, **settings: Any) -> contextlib.AbstractContextManager[Child]:
    """Run a module that works until its standard input ends and prints its ``result``, within the block."""
    return child(module_command(module, *arguments), stdin=subprocess.PIPE, stderr=None, **settings)
