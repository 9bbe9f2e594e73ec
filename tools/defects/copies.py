"""Copies of the project in which tests run with one defect at a time; the project itself is never changed."""

import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tools.defects.defect import Defect

_PYTEST = [
    sys.executable,
    "-m",
    "pytest",
    "-q",
    "-x",
    "--tb=no",
    "-p",
    "no:cacheprovider",
    "-p",
    "timeout",
    "--timeout=120",
]
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
_TESTS_TIMEOUT_S = 3600.0
_LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "build", "dist", "node_modules", "altd-defects-*")


class Copies:
    """Copies of a project, one for each of ``number`` threads that call ``caught_by``."""

    def __init__(self, root: Path, folder: Path, number: int) -> None:
        self.number = number
        self._idle: queue.SimpleQueue[Path] = queue.SimpleQueue()
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._has_ended = False
        for index in range(number):
            shutil.copytree(root, folder / str(index), ignore=_LEFT_OUT)
            self._idle.put(folder / str(index))

    def caught_by(self, defect: Defect, suite: str) -> str:
        """Return the first test that fails with a defect and passes without it; empty if there is none.

        ``suite`` names the last tests that run: ``room``, ``unit``, or ``all`` (``tests/system/ROOM``).
        """
        copy = self._idle.get()
        try:
            left_out: list[str] = []
            for tests in filter(None, _tests_of(copy, defect, suite)):
                while True:
                    with _defective(copy / defect.file, defect):
                        failed = self._failed(copy, [*tests, *left_out])
                    if not failed:
                        break
                    if "::" not in failed or not self._failed(copy, [failed]):
                        return failed
                    left_out.append(f"--deselect={failed}")
                left_out += [f"--ignore={path}" for path in tests]
            return ""
        finally:
            self._idle.put(copy)

    def end(self) -> None:
        """End all tests that run, and start no more."""
        with self._lock:
            self._has_ended = True
            for process in self._running:
                _kill(process)

    def _failed(self, copy: Path, arguments: list[str]) -> str:
        """Run tests; return the first that failed, or what the run ended with; empty if all passed."""
        command = [
            *_PYTEST,
            *arguments,
            *([] if arguments[0].startswith("tests/system") else ["-m", "not long"]),
        ]
        environment = {
            **os.environ,
            "PYTHONPATH": str(copy),
        }  # children import the copy, not what is installed
        with self._lock:
            if self._has_ended:
                return "ended"
            process = subprocess.Popen(  # noqa: S603
                command,
                cwd=copy,
                env=environment,
                text=True,
                start_new_session=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            self._running.add(process)
        try:
            output = process.communicate(timeout=_TESTS_TIMEOUT_S)[0]
        except subprocess.TimeoutExpired:
            return f"{arguments[0]}: no end after {_TESTS_TIMEOUT_S:.0f} s"
        finally:
            _kill(process)  # and what its tests left running
            process.wait()
            with self._lock:
                self._running.remove(process)
        if process.returncode in (0, 5):  # 5: no test here
            return ""
        failed = _FAILED.search(output)
        return failed[1] if failed else f"{arguments[0]}: {output.strip().splitlines()[-1:]}"


def _kill(process: subprocess.Popen[str]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _tests_of(copy: Path, defect: Defect, suite: str) -> Iterator[list[str]]:
    """Yield tests from near to far: the files that name the module, its room, all that ``suite`` says."""
    tests = copy / "tests/unit"
    module = defect.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    named = re.compile(rf"{re.escape(module)}\b(?!\.)")
    files = sorted(tests.glob("**/test_*.py"))
    yield [str(path.relative_to(copy)) for path in files if named.search(path.read_text(encoding="utf-8"))]
    places = [tests / defect.room, tests / f"test_{defect.room}.py"]
    if suite != "room":
        places.append(tests)
    if suite == "all":
        places.append(copy / "tests/system" / defect.room)
    yield from ([str(place.relative_to(copy))] for place in places if place.exists())


@contextmanager
def _defective(file: Path, defect: Defect) -> Iterator[None]:
    """Put a defect into a file, and take it out again."""
    text = file.read_text(encoding="utf-8")
    try:
        _write(file, defect.put_into(text))
        yield
    finally:
        _write(file, text)


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")
    # Python checks compiled code by the text's size and time in seconds: both can be those of the other text
    for compiled in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
        compiled.unlink()
