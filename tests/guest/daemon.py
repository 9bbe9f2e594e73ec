"""The whole daemon in the guest, with frames fed to its cameras, as its clients see it."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
import urllib.request
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from pymodbus.client import ModbusTcpClient

HERE = Path(__file__).parent
URL = "http://127.0.0.1:8080/api/"
_UP_WITHIN_S = 60.0  # a guest with a late processor repeats frames and is not valid yet


@contextlib.contextmanager
def feeding(frames: str, fps: float, devices: list[Path], feeder: str = "feeding.py") -> Iterator[None]:
    """Frames flow into the devices, by one of the programs beside this."""
    words = [sys.executable, HERE / feeder, frames, str(fps), *devices]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"feeding\n"
        try:
            yield
        finally:
            process.kill()


@contextlib.contextmanager
def running(config: str) -> Iterator[subprocess.Popen[bytes]]:
    """``altd run`` until it measures; ended as systemd does it. What it says goes to ``daemon.log``.

    It is less urgent than what makes the pictures: cameras do not wait for the processor of the unit, and the
    guest has one.
    """
    words = ["nice", "-n", "10", sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", config]
    with Path("daemon.log").open("wb") as log, subprocess.Popen(words, stderr=log) as daemon:
        try:
            await_valid(_UP_WITHIN_S)
            yield daemon
        finally:
            daemon.terminate()
            daemon.wait(30)


def status() -> Any:
    """``/api/status``."""
    with urllib.request.urlopen(URL + "status", timeout=20) as answer:
        return json.load(answer)


def self_check() -> Any:
    """The report of a self-check that the daemon makes now."""
    request = urllib.request.Request(URL + "self-check", method="POST", headers={"X-Altd-Request": "test"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer)


def await_valid(within_s: float) -> None:
    """Wait for the first valid measurement."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        with contextlib.suppress(OSError), urllib.request.urlopen(URL + "measurement", timeout=20) as answer:
            if json.load(answer)["valid"]:
                return
        time.sleep(0.1)
    raise TimeoutError(f"nothing valid within {within_s:g} s: {Path('daemon.log').read_text()}")


class Stream:
    """The measurements as they come, each with the instant of its arrival, ``time.monotonic()``."""

    def __init__(self) -> None:
        self.events: list[tuple[float, Any]] = []
        self._answer = urllib.request.urlopen(URL + "stream", timeout=20)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            for line in self._answer:
                if line.startswith(b"data: "):
                    self.events.append((time.monotonic(), json.loads(line[6:])))


class Asking(ABC):
    """Asks the daemon something again and again, in a thread; ``with`` begins and ends it."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._ask_until_stopped)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _ask_until_stopped(self) -> None:
        while not self._stop.wait(self._every_s):
            self.ask()

    @abstractmethod
    def ask(self) -> None:
        """One question."""


class Controller(Asking):
    """A Modbus client that reads the input registers; what each answer took, in s."""

    def __init__(self) -> None:
        super().__init__(every_s=0.1)
        self.took_s: list[float] = []
        self.failures = 0
        self._client = ModbusTcpClient("127.0.0.1", port=502)
        assert self._client.connect()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._client.close()

    def ask(self) -> None:
        began_s = time.monotonic()
        self.failures += self._client.read_input_registers(0, count=20).isError()
        self.took_s.append(time.monotonic() - began_s)


def processor_s(process: subprocess.Popen[bytes]) -> float:
    """The processor time that a process has used."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
