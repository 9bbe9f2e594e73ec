"""``python -m hw_sim chain-demo``: the daemon monitors a row of glass targets while a place moves."""

import argparse
import asyncio
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from altd.app.daemon import Daemon
from altd.app.parts import calibration_of_instrument
from altd.config import Config, HttpSettings, ModbusTcpSettings, RowSettings, Target, Unit
from altd.reasons import Reason
from altd.records import Measurement
from hw_sim.arguments import add_demo_arguments
from hw_sim.beam import BeamPose
from hw_sim.demo import command, run_until_stopped, together
from hw_sim.ports import free_port
from hw_sim.row.live import LiveRow
from hw_sim.row.record import record_scans
from hw_sim.row.row import Row, RowConfig, at_rest

SETTINGS = RowSettings(stable=("t1", "t5"), baseline_rounds=3, exposures=3, settle_s=0.35, alarm_mm=0.3)
STEP_MM = (0.32, -0.24)
STEP_S = 25.0
"""Time at which t3 moves, s."""
DRIFT_S = 600.0
STUCK = "t4"
STUCK_ROUNDS = range(13, 16)
"""Rounds in which a glass does not turn clear."""
LOCALHOST = "127.0.0.1"
_OF_DEMO = {Reason.SIMULATED, Reason.REHEARSAL}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments of the demo."""
    add_demo_arguments(parser, "selects the row (default: 1)")


def run(arguments: argparse.Namespace) -> int:
    """Run the demo until its duration is over or a signal arrives; raises BadInputError."""
    return run_until_stopped(partial(_demo, arguments))


async def _demo(arguments: argparse.Namespace, stop: Callable[[], None]) -> None:
    """Scan each target, calibrate, and monitor with the daemon."""
    with tempfile.TemporaryDirectory(prefix="altd-chain-") as name:
        path = Path(name) / "chain.json"
        of = RowConfig(seed=arguments.seed)
        print(f"Scanning the targets of simulated row {of.seed}, and calibrating ...", flush=True)
        scans = await asyncio.to_thread(record_scans, Path(name), Row(of))
        await command("altd.cli", "calibrate", *map(str, scans), "-o", str(path))
        moving = RowConfig(
            seed=arguments.seed,
            beam=_drifting,
            places={"t3": lambda t_s: STEP_MM if t_s >= STEP_S else (0.0, 0.0)},
        )
        live = LiveRow(Row(moving))
        config = config_of(moving, path, arguments.http_port or free_port())
        cameras = live.cameras()
        known_by = calibration_of_instrument(config, cameras)
        daemon = Daemon(config, known_by, cameras, rehearsal=True, switches=live)
        assert config.http is not None  # noqa: S101  created above
        print(f"Page: http://{LOCALHOST}:{config.http.port}   Ctrl-C ends the demo.")
        print(
            f"At {STEP_S:.0f} s t3 moves by {math.hypot(*STEP_MM):.1f} mm; later the glass of {STUCK} sticks."
        )
        heads = "".join(f"{f'{target} dx, dy mm':>22}" for target in moving.names)
        print(f"\n{'s':>4}{heads}  {'sigma':>6} {'largest error':>13}  status", flush=True)
        if arguments.seconds is not None:
            asyncio.get_running_loop().call_later(arguments.seconds, stop)
        await together(daemon.run(), _show(daemon, live))


def config_of(row: RowConfig, calibration: Path, http_port: int, settings: RowSettings = SETTINGS) -> Config:
    """Config of a row, with its interfaces on this machine only."""
    return Config(
        unit=Unit(serial=row.serial, calibration=calibration, instrument="chain"),
        targets=tuple(
            Target(name=name, z_mm=z_mm, camera=name) for name, z_mm in zip(row.names, row.z_mm, strict=True)
        ),
        chain=settings,
        http=HttpSettings(host=LOCALHOST, port=http_port),
        modbus_tcp=ModbusTcpSettings(host=LOCALHOST, port=free_port()),
    )


def _drifting(t_s: float) -> BeamPose:
    """Pose of a beam that drifts by 2 mm and 0.1 mrad within ten minutes."""
    way = 0.5 - 0.5 * math.cos(math.pi * t_s / DRIFT_S)
    return BeamPose(2.0 * way, way, 1e-4 * way, 0.5e-4 * way)


async def _show(daemon: Daemon, live: LiveRow) -> None:
    """Print a line for each round: displacements, their largest error and sigma, reasons."""
    cursor, rounds = daemon.board.cursor(), 0
    while True:
        measurement = await cursor.next()
        rounds += measurement.frames > 0
        if rounds in (STUCK_ROUNDS.start, STUCK_ROUNDS.stop):
            live.stick(STUCK, "opaque" if rounds == STUCK_ROUNDS.start else "")
        line = _line(measurement, live.t_s(measurement.t_ns), live.row.config)
        # in a thread: a pipe without a reader must not block the unit
        await asyncio.to_thread(print, line, flush=True)


def _line(measurement: Measurement, t_s: float, row: RowConfig) -> str:
    status = ", ".join(str(fault) for fault in measurement.status if fault.reason not in _OF_DEMO)
    cells, errors, sigmas = [], [0.0], [0.0]
    for name in row.names:
        values = [measurement.known(f"{name}_d{axis}_mm") for axis in "xy"]
        known = [value for value in values if value is not None]
        cells.append(", ".join(f"{value.value:+.3f}" for value in known) or "—")
        moved_mm = row.places.get(name, at_rest)(t_s)
        errors += [abs(value.value - mm) for value, mm in zip(known, moved_mm, strict=False)]
        sigmas += [value.sigma or 0.0 for value in known]
    ends = f"{max(sigmas):6.3f} {max(errors):13.3f}" if len(errors) > 1 else f"{'—':>6} {'—':>13}"
    return f"{t_s:4.0f}{''.join(f'{cell:>22}' for cell in cells)}  {ends}  {status}"
