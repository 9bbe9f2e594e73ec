"""A calibrated unit that plays its own recording, and its daemon as a process under odd conditions."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from altd.calibration.calibrating import calibrate
from altd.calibration.file import save_calibration
from altd.calibration.result import CalibrationResult
from altd.recording.reader import open_recording
from support.ports import free_port
from support.recordings import write_beams, write_scan
from support.unit_toml import write_config

BEAMS = [(10.0, 5.0, 0.02, -0.03)] * 3


@dataclass(frozen=True)
class PlayedUnit:
    """Its files."""

    folder: Path

    @property
    def calibration(self) -> Path:
        return self.folder / "cal.json"

    @property
    def beams(self) -> Path:
        return self.folder / "beams"

    @property
    def config(self) -> Path:
        return self.folder / "altd.toml"

    @property
    def result(self) -> CalibrationResult:
        """The source of its calibration file."""
        made: CalibrationResult = pickle.loads((self.folder / "result.pickle").read_bytes())
        return made

    @classmethod
    def made(cls, folder: Path) -> PlayedUnit:
        unit = cls(folder)
        write_scan(folder / "scan")
        write_beams(unit.beams, BEAMS)
        result = calibrate([open_recording(folder / "scan")])
        save_calibration(result.calibration, unit.calibration)
        (folder / "result.pickle").write_bytes(pickle.dumps(result))
        write_config(unit.config, unit.calibration, unit.beams)
        return unit


@dataclass
class PlayingDaemon:
    """``altd run`` as a process, with HTTP and Modbus TCP on ports of their own."""

    process: subprocess.Popen[bytes]
    http: int
    modbus: int

    def measurement(self) -> dict[str, Any]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}/api/measurement", timeout=20) as page:
            answer: dict[str, Any] = json.load(page)
            return answer

    def wait_until_valid(self) -> dict[str, Any]:
        """The first measurement that is."""
        return self.wait_until(lambda measurement: bool(measurement["valid"]))

    def wait_for_measurements(self, count: int) -> None:
        """Until so many further ones were made."""
        first: int = self.measurement()["sequence"]
        self.wait_until(lambda measurement: measurement["sequence"] >= first + count)

    def wait_until(self, holds: Callable[[dict[str, Any]], bool], timeout_s: float = 150.0) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            with contextlib.suppress(OSError):
                if holds(measurement := self.measurement()):
                    return measurement
            assert self.process.poll() is None, "it ended"
            time.sleep(0.05)
        raise AssertionError(f"not so after {timeout_s} s")


@contextlib.contextmanager
def playing(
    unit: PlayedUnit, folder: Path, stderr: int, prepare: Callable[[], None] | None = None, more: str = ""
) -> Iterator[PlayingDaemon]:
    """The daemon; ``prepare`` runs in its process before it starts."""
    http, modbus = free_port(), free_port()
    faces = f'[http]\nhost = "127.0.0.1"\nport = {http}\n[modbus_tcp]\nhost = "127.0.0.1"\nport = {modbus}\n'
    config = write_config(folder / "altd.toml", unit.calibration, unit.beams, faces + more)
    process = subprocess.Popen(
        [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)],
        stdin=subprocess.DEVNULL,
        stderr=stderr,
        preexec_fn=prepare,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    try:
        yield PlayingDaemon(process, http, modbus)
    finally:
        process.kill()
        process.wait()
        if process.stderr is not None:
            process.stderr.close()
