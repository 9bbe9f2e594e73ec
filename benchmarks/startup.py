"""From the start of the process ``altd run`` to the first valid measurement on HTTP."""

from __future__ import annotations

import http.client
import json
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from altd.calibration.file import save_calibration
from altd.measuring.calibration import Calibration
from benchmarks.material import FPS, SEED, WINDOW, Material
from benchmarks.unit_toml import unit_toml
from hw_sim import unit as simulated
from hw_sim.beam import BeamPose
from hw_sim.ports import free_port
from hw_sim.recording import recording

_TIMEOUT_S = 15.0
_IMPORTS = "import altd.cli.main, altd.config, altd.app.daemon, altd.publish.http.publisher"


@dataclass(frozen=True, slots=True)
class StartFigures:
    """Seconds from process start, medians over ``runs``.

    ``least_s`` of the time to the first valid value are spent waiting for exposures: half a window.
    """

    runs: int
    imports_s: float
    first_answer_s: float
    first_valid_s: float
    least_s: float


def measure_start(material: Material, runs: int) -> StartFigures:
    """Start ``altd run`` on a recording that plays in real time, and ask until it has a value."""
    with tempfile.TemporaryDirectory(prefix="altd-bench-") as name:
        port = free_port()
        config = _write_run_folder(Path(name), material.calibration, port, exposures=WINDOW)
        starts = [_start(config, port) for _ in range(runs)]
        imports = [_import_s() for _ in range(runs)]
    return StartFigures(
        runs,
        statistics.median(imports),
        statistics.median(answer for answer, _ in starts),
        statistics.median(valid for _, valid in starts),
        (WINDOW // 2 - 1) / FPS,
    )


def _write_run_folder(folder: Path, calibration: Calibration, http_port: int, exposures: int) -> Path:
    """A config for ``altd run`` that plays a recording in real time, with all that it needs beside it."""
    still = simulated.Unit(simulated.UnitConfig(seed=SEED))
    with recording(folder / "recording", still, "measurement", exposures, lambda done, planned: None) as made:
        for _ in range(exposures):
            made.expose(BeamPose(4.0, -3.0, 0.02, -0.03))
    save_calibration(calibration, folder / "calibration.json")
    config = folder / "altd.toml"
    camera = 'driver = "recording"\npath = "recording"\nrepeat = true'
    settings = unit_toml(f"SIM-{SEED}", "calibration.json", camera, camera)
    config.write_text(f'{settings}\n[http]\nhost = "127.0.0.1"\nport = {http_port}\n')
    return config


def _start(config: Path, port: int) -> tuple[float, float]:
    """Seconds to the first answer of any kind, and to the first valid measurement."""
    begun_s = time.monotonic()
    command = [sys.executable, "-m", "altd.cli", "run", "--config", str(config)]
    with (
        tempfile.TemporaryFile("w+") as said,
        subprocess.Popen(command, stderr=said) as daemon,  # noqa: S603  our own interpreter and module
    ):
        try:
            first_answer_s = None
            while (passed_s := time.monotonic() - begun_s) < _TIMEOUT_S and daemon.poll() is None:
                valid = _ask(port)
                if valid is None:
                    time.sleep(0.005)
                    continue
                if first_answer_s is None:
                    first_answer_s = time.monotonic() - begun_s
                if valid:
                    return first_answer_s, time.monotonic() - begun_s
                time.sleep(0.005)
            said.seek(0)
            raise TimeoutError(f"altd run had no valid measurement after {passed_s:.1f} s:\n{said.read()}")
        finally:
            daemon.terminate()


def _ask(port: int) -> bool | None:
    """Whether the latest measurement is valid; None when nobody answers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=2.0)
    try:
        connection.request("GET", "/api/measurement")
        answer = connection.getresponse()
        return answer.status == 200 and bool(json.loads(answer.read())["valid"])
    except ConnectionError:
        return None
    finally:
        connection.close()


def _import_s() -> float:
    """The imports of ``altd run`` in a fresh interpreter, without the interpreter's own start."""
    code = f"import time; t = time.perf_counter(); {_IMPORTS}; print(time.perf_counter() - t)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)  # noqa: S603
    return float(done.stdout)
