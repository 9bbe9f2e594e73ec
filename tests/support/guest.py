"""Programs in a Linux with real test drivers: vivid, v4l2loopback, gpio-sim, a USB serial port (dummy_hcd).

The guest is a User-Mode Linux that ``.ci/kernel`` builds: a process of this machine, no root needed. Its root
is this machine's tree, read-only; a program of ``tests/guest/`` runs there as root with the tests' Python, in
a folder that it may write to. No udev runs there: a program makes its own names under /dev/v4l/by-path.
"""

import contextlib
import functools
import json
import os
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.foreign import need
from support.places import ROOT

_GUEST = ROOT / "tests" / "guest"
_MEMORY = "768M"
RESULTS = "results.json"
BUSY_TIMEOUT_S = 240.0
"""On a busy machine a guest needs half a minute until its program runs."""


@dataclass(frozen=True)
class GuestRun:
    """The result of a program in the guest: its exit status, all it printed, and the folder it wrote to."""

    status: int
    out: str
    folder: Path

    @property
    def results(self) -> Any:
        """The program's results of ``leave_results``; it must have ended well."""
        assert self.status == 0, f"the program in the guest ended with status {self.status}:\n{self.out}"
        return json.loads((self.folder / RESULTS).read_text())


def run_in_guest(
    folder: Path,
    program: str,
    *arguments: object,
    kernel_arguments: tuple[str, ...] = (),
    timeout_s: float = BUSY_TIMEOUT_S,
) -> GuestRun:
    """Run a program of ``tests/guest/`` in a guest of its own, in ``folder``, an empty one that stays.

    ``kernel_arguments`` set the drivers up, such as ``vivid.n_devs=1`` or ``v4l2loopback.devices=2``; without
    them vivid and v4l2loopback make one device each. Without the kernel the test is skipped, in CI it fails.
    Raises TimeoutError with what was printed when the guest is not done in ``timeout_s``.
    """
    kernel, folder = _prepared(folder, program, arguments)
    try:
        with _booted(kernel, folder, kernel_arguments) as process:
            process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"the guest was not done in {timeout_s:g} s:\n{_said(folder)}") from None
    status = folder / "status"
    assert status.exists(), f"the guest died:\n{_said(folder)}"
    return GuestRun(int(status.read_text()), (folder / "output").read_text(errors="replace"), folder)


def cut_power(
    folder: Path,
    program: str,
    *arguments: object,
    kernel_arguments: tuple[str, ...],
    is_due: Callable[[str], bool],
    timeout_s: float = BUSY_TIMEOUT_S,
) -> str:
    """Run a program as ``run_in_guest`` does, and take the machine's power away at a moment.

    ``is_due`` is called every 10 ms with the text on the console, ``/dev/console`` in the guest:
    what was written there came out, whatever the guest still had in memory. Returns all of it. Of the guest's
    disks there is left what it had given to them. Raises TimeoutError.
    """
    kernel, folder = _prepared(folder, program, arguments)
    deadline = time.monotonic() + timeout_s
    console = folder / "console"
    with _booted(kernel, folder, kernel_arguments) as process:
        while not is_due(console.read_text(errors="replace")):
            if time.monotonic() > deadline or process.poll() is not None:
                raise TimeoutError(f"the power was not cut in {timeout_s:g} s:\n{_said(folder)}")
            time.sleep(0.01)
    return console.read_text(errors="replace")


def leave_results(results: object) -> None:
    """For a program in the guest: leave this, plain JSON types, as ``GuestRun.results``."""
    Path(RESULTS).write_text(json.dumps(results))


def _prepared(folder: Path, program: str, arguments: tuple[object, ...]) -> tuple[str, Path]:
    """The kernel, and the folder with the command that the guest shall run."""
    kernel, why_not = _kernel()
    need(bool(kernel), why_not)
    folder = folder.resolve()
    words = ["env", f"PYTHONPATH={ROOT}:{ROOT / 'tests'}", "PYTHONUNBUFFERED=1"]
    words += [sys.executable, str(_GUEST / program), *map(str, arguments)]
    (folder / "command").write_text(f"exec {shlex.join(words)}\n")
    return kernel, folder


@contextlib.contextmanager
def _booted(
    kernel: str, folder: Path, kernel_arguments: tuple[str, ...]
) -> Iterator[subprocess.Popen[bytes]]:
    """A machine that runs; it is killed at the end unless it has switched itself off."""
    with tempfile.TemporaryDirectory(prefix="uml-") as sockets, (folder / "console").open("wb") as console:
        processor = random.choice(sorted(os.sched_getaffinity(0)))
        machine = ["taskset", "-c", str(processor)]  # four times as fast (docs/decisions/0012)
        machine += [kernel, f"mem={_MEMORY}", f"uml_dir={sockets}/", "con=null", "con0=fd:0,fd:1", "quiet"]
        machine += ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"init={_GUEST / 'init'}"]
        machine += [f"guest_folder={folder}", *kernel_arguments]
        process = subprocess.Popen(
            machine,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # the guest's processes are processes here: as a group they can be ended
        )
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _said(folder: Path) -> str:
    """The output of the kernel and the program so far."""
    texts = [folder / name for name in ("console", "output")]
    return "".join(text.read_text(errors="replace")[-4000:] for text in texts if text.exists())


@functools.cache
def _kernel() -> tuple[str, str]:
    """The path of the kernel, or an empty string and why there is none."""
    environment = {
        name: value for name, value in os.environ.items() if name != "CI"
    }  # asks, and may be refused
    found = subprocess.run(
        [ROOT / ".ci" / "kernel", "find"], capture_output=True, text=True, check=False, env=environment
    )
    return found.stdout.strip(), found.stderr.strip()
