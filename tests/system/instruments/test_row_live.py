"""A row in real time: the daemon switches the glasses, measures and keeps its baseline."""

from __future__ import annotations

import asyncio
import json
import re
import struct
import urllib.request
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient
from support.cli import altd_here, refusal
from support.opcua import read_by_node
from support.ports import free_port
from support.row import calibrated

from altd.app.daemon import Daemon
from altd.app.record import record_of
from altd.calibration.file import load_calibration, save_calibration
from altd.config import Config, KeptFrames, LocalSettings, OpcUaSettings, RowSettings
from altd.ports import LampsError
from altd.publish.modbus.registers import NEAR, PER_PLACE
from altd.recording.reader import open_recording
from altd.records import Measurement
from hw_sim.row.demo import config_of
from hw_sim.row.live import LiveRow
from hw_sim.row.record import record_rounds
from hw_sim.row.row import Row, RowConfig

NAMES = ("t1", "t2", "t3")
ROW_CONFIG = RowConfig(seed=7, z_mm=(0.0, 15_000.0, 30_000.0))
STEP_MM = (0.32, -0.24)
SETTINGS = RowSettings(stable=("t1", "t3"), baseline_rounds=2, exposures=2, settle_s=0.35, alarm_mm=0.3)
OF_T2 = ("t2_dx_mm", "t2_dx_mm.sigma", "targets.t2.x_mm", "targets.t2.valid", "targets.t2.status")


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("row") / "chain.json"
    save_calibration(calibrated(ROW_CONFIG.seed, ROW_CONFIG.z_mm), path)
    return path


class Unit:
    """A daemon with its row."""

    def __init__(self, config: Config, calibration: Path, moved_mm: tuple[float, float] = (0.0, 0.0)) -> None:
        self.live = LiveRow(Row(replace(ROW_CONFIG, places={"t2": lambda t_s: moved_mm})))
        cameras = self.live.cameras()
        known = load_calibration(calibration, ROW_CONFIG.serial)
        self.daemon = Daemon(config, known, cameras, rehearsal=True, switches=self.live)

    async def run(self, during: Callable[[Unit], Awaitable[None]]) -> None:
        running = asyncio.create_task(self.daemon.run())
        try:
            async with asyncio.timeout(200.0):  # no claim of how soon
                await during(self)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    async def by_node(self, *keys: str) -> dict[str, Any]:
        """Nodes as a foreign client of OPC UA reads them."""
        opcua = self.daemon.config.opcua
        assert opcua is not None
        return await read_by_node(opcua.port, *keys)

    async def until(self, condition: Callable[[Measurement], bool]) -> Measurement:
        cursor = self.daemon.board.cursor()
        while not condition(measurement := await cursor.next()):
            pass
        return measurement


def config(folder: Path, calibration: Path) -> Config:
    settings = SETTINGS.model_copy(update={"baseline": folder / "baseline.json"})
    kept = KeptFrames(folder=folder / "kept", before_s=20.0, after_s=0.0, on_fault=False)
    local = LocalSettings(socket=folder / "altd.sock")
    of_row = config_of(ROW_CONFIG, calibration, free_port(), settings)
    opcua = OpcUaSettings(host="127.0.0.1", port=free_port())
    return of_row.model_copy(update={"kept_frames": kept, "local": local, "opcua": opcua})


def codes(measurement: Measurement) -> set[str]:
    return {str(fault) for fault in measurement.status}


@pytest.mark.real_time
async def test_a_row_is_measured_kept_and_read_and_a_restart_keeps_its_baseline(
    calibration: Path, tmp_path: Path
) -> None:
    of_unit = config(tmp_path, calibration)
    await Unit(of_unit, calibration).run(_first_run)
    assert json.loads((tmp_path / "baseline.json").read_text())["origin"] == "simulated"
    (kept,) = filter(Path.is_dir, (tmp_path / "kept").iterdir())
    replayed = altd_here("replay", kept, "--calibration", calibration)
    assert replayed.status == 0
    assert any(set(line["targets"]) == set(NAMES) and line["valid"] for line in replayed.objects)
    # while the daemon was away t2 has moved: against a new baseline it would be where it was
    await Unit(of_unit, calibration, STEP_MM).run(_second_run)


async def _first_run(unit: Unit) -> None:
    first = await unit.until(lambda measurement: measurement.valid)
    assert "baseline_incomplete" in codes(first)
    assert first.known("t2_dx_mm") is None
    measured = await unit.until(lambda measurement: measurement.known("t2_dx_mm") is not None)
    assert codes(measured) == {"simulated", "rehearsal"}
    assert abs(measured.number("t2_dx_mm") or 9.0) < 0.05
    http = unit.daemon.config.http
    assert http is not None
    document = await asyncio.to_thread(_json, f"http://127.0.0.1:{http.port}/api/v1/measurement")
    of_t2 = document["targets"]["t2"]
    assert of_t2["valid"]
    assert (of_t2["status"], of_t2["dx_mm"]) == ([], document["t2_dx_mm"])
    assert of_t2["sigma"]["dx_mm"] == document["sigma"]["t2_dx_mm"]
    local = unit.daemon.config.local
    assert local is not None
    status = await asyncio.to_thread(altd_here, "status", "--socket", local.socket)
    assert re.search(r"^  t2 dx +-?0\.0\d\d mm +\+/- 0\.0\d\d$", status.out, re.MULTILINE), status.out
    await unit.daemon.unit.recordings.provider.keep("test")
    unit.live.stick("t1", "opaque")
    dark = {"t1_stuck_opaque", "t2_spot_missing", "t3_spot_missing"}
    measured = await unit.until(lambda measurement: dark <= codes(measurement))  # after a round of both kinds
    assert measured.valid
    assert [measured.targets[name] is None for name in NAMES] == [False, True, True]
    read = await unit.by_node("measured", "valid", *OF_T2, "targets.t1.status")
    assert [read[key]["value"] for key in ("measured", "valid")] == [1.0, True]
    assert [read[key]["value"] for key in OF_T2] == [None, None, None, False, ["spot_missing"]]
    assert {read[key]["status"] for key in OF_T2[:3]} == {"Bad"}
    assert read["targets.t1.status"]["value"] == ["stuck_opaque"]


async def _second_run(unit: Unit) -> None:
    measured = await unit.until(lambda measurement: measurement.valid)
    assert "baseline_incomplete" not in codes(measured)
    assert "t2_alarm_displacement" in codes(measured)
    for axis, moved_mm in zip("xy", STEP_MM, strict=True):
        assert abs((measured.number(f"t2_d{axis}_mm") or 9.0) - moved_mm) < 0.05
    modbus = unit.daemon.config.modbus_tcp
    assert modbus is not None
    client = AsyncModbusTcpClient("127.0.0.1", port=modbus.port)
    assert await client.connect()
    read = await client.read_input_registers(NEAR.first, count=NEAR.size)
    client.close()
    assert read.registers[1] == len(NAMES)
    of_t2 = read.registers[10 + PER_PLACE :][:PER_PLACE]
    dx_mm, dy_mm, *_ = struct.unpack(">5f", struct.pack(">10H", *of_t2[2:]))
    assert of_t2[:2] == [0, 1]
    assert max(abs(dx_mm - STEP_MM[0]), abs(dy_mm - STEP_MM[1])) < 0.05
    while (read := await unit.by_node("t2_dy_mm", *OF_T2))["t2_dy_mm"]["value"] is None:
        pass  # on a busy machine a round may be lost
    for key, truth in zip(("t2_dx_mm", "t2_dy_mm"), STEP_MM, strict=True):
        assert abs(read[key]["value"] - truth) < 0.05
        assert read[key]["status"] == "UncertainSimulatedValue"
    assert 0.0 < read["t2_dx_mm.sigma"]["value"] < 0.05
    assert [read[key]["value"] for key in OF_T2[3:]] == [True, ["alarm_displacement"]]
    unit.live.silent = frozenset(NAMES)
    silent = await unit.until(lambda measurement: not measurement.valid)
    assert {"t1_camera_silent", "t2_camera_silent", "t3_camera_silent"} <= codes(silent)
    assert silent.values == {}
    read = await unit.by_node(*OF_T2)
    assert [read[key]["value"] for key in OF_T2] == [None, None, None, False, ["camera_silent"]]
    assert {read[key]["status"] for key in OF_T2[:3]} == {"BadSensorFailure"}


def _json(address: str) -> Any:
    with urllib.request.urlopen(address, timeout=30) as answer:
        return json.load(answer)


@pytest.mark.real_time
async def test_a_recording_of_a_row_has_the_opaque_target_of_each_frame(
    tmp_path: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``altd record`` but for the drivers. Glasses that cannot be switched are reported."""
    live = LiveRow(Row(ROW_CONFIG))
    monkeypatch.setattr("altd.app.record.cameras_of", lambda config, place: live.cameras())
    monkeypatch.setattr("altd.app.record.switches_of", lambda config, cameras, place: live)
    of_row, place = config(tmp_path, calibration), tmp_path / "altd.toml"
    await record_of(of_row, place, tmp_path / "rounds", 6.0, "measurement")
    rows = list(open_recording(tmp_path / "rounds").rows)
    assert {row.opaque for row in rows} == {"", *NAMES}
    named = {(row.sequence, row.opaque) for row in rows if row.opaque}
    assert len(named) == len({sequence for sequence, _ in named})  # no exposure shows two targets
    replayed = altd_here("replay", tmp_path / "rounds", "--calibration", calibration)
    assert {name for line in replayed.objects for name, of in line["targets"].items() if of["valid"]} == {
        *NAMES
    }

    show, refused = live.show, list[str]()

    def refuse_once(opaque: str) -> None:
        if opaque and not refused:
            refused.append(opaque)
            raise LampsError("the chip is gone")
        show(opaque)

    monkeypatch.setattr(live, "show", refuse_once)  # it is back long before the end
    with pytest.raises(LampsError, match="a glass could not be switched: the chip is gone"):
        await record_of(of_row, place, tmp_path / "dark", 3.0, "measurement")


def test_a_baseline_is_stored_from_a_recording_and_used(calibration: Path, tmp_path: Path) -> None:
    """``altd baseline`` from rounds at rest; a later recording is measured against it."""
    settings = tmp_path / "altd.toml"
    text = f'[unit]\nserial = "{ROW_CONFIG.serial}"\ncalibration = "{calibration}"\ninstrument = "chain"\n'
    text += '[chain]\nstable = ["t1", "t3"]\nbaseline_rounds = 3\nbaseline = "baseline.json"\n'
    for name, z_mm in zip(NAMES, ROW_CONFIG.z_mm, strict=True):
        text += f'[[targets]]\nname = "{name}"\nz_mm = {z_mm}\ncamera = "{name}"\n'
        text += f'[cameras.{name}]\ndriver = "recording"\npath = "rest"\n'
    settings.write_text(text)
    record_rounds(tmp_path / "rest", Row(ROW_CONFIG), 4)
    moved = Row(replace(ROW_CONFIG, places={"t2": lambda t_s: STEP_MM}))
    record_rounds(tmp_path / "moved", moved, 3)
    record_rounds(tmp_path / "short", Row(ROW_CONFIG), 2)
    measured = ("replay", tmp_path / "moved", "--calibration", calibration, "--config", settings)
    assert altd_here(*measured).objects[-1]["targets"]["t2"]["dx_mm"] is None
    short = altd_here("baseline", tmp_path / "short", "--config", settings)
    assert "has fewer than 3 rounds in which all stable targets" in refusal(short)
    stored = altd_here("baseline", "--config", settings)
    assert (stored.status, "baseline of 3 targets from" in stored.out) == (0, True)
    lines = altd_here(*measured).objects
    assert all(abs(line["targets"]["t2"]["dx_mm"] - STEP_MM[0]) < 0.05 for line in lines)
    again = altd_here("baseline", "--config", settings)
    assert "exists already; --replace renames it" in refusal(again)
    replaced = altd_here("baseline", tmp_path / "moved", "--config", settings, "--replace")
    assert (replaced.status, "renamed: " in replaced.out) == (0, True)
    assert len(list(tmp_path.glob("baseline.json*"))) == 2
    assert abs(altd_here(*measured).objects[-1]["targets"]["t2"]["dx_mm"]) < 0.05
    settings.write_text(text.replace('stable = ["t1", "t3"]', 'stable = ["t1", "t2"]'))
    assert "'t2' was not a stable target then" in refusal(altd_here(*measured))
    assert "'t2' was not a stable target then" in refusal(altd_here("check-config", settings))
