"""``altd scan`` as a person calls it: a process that is interrupted, killed, and finishes."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.cli import altd_here, refusal
from support.recordings import write_beams
from support.scanning import nodes
from support.unit_toml import write_config

from altd.recording.reader import open_recording
from hw_sim.grbl_table import GrblTable


class TestCommand:
    """`altd scan` as a person calls it; its cameras play a recording, so the spots stay where they are."""

    @pytest.fixture
    def config(self, table: GrblTable, tmp_path: Path) -> Path:
        write_beams(tmp_path / "rec", [(10.0, 5.0, 0.0, 0.0)])
        more = f"""
[stage]
driver = "grbl"
device = "{table.device}"
feed_mm_per_min = 100000

[scan]
pitch_mm = 25
columns = 4
rows = 4
settle_s = 0.1
exposures = 1
"""
        return write_config(tmp_path / "altd.toml", tmp_path / "none.json", tmp_path / "rec", more)

    def started(self, config: Path, output: Path) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "altd.cli", "scan", "--config", config, "-o", output]
        return subprocess.Popen([str(word) for word in command], stderr=subprocess.PIPE, text=True)

    def on_a_terminal(self, config: Path, output: Path) -> str:
        terminal, device = os.openpty()
        command = [sys.executable, "-m", "altd.cli", "scan", "--config", str(config), "-o", str(output)]
        shown = b""
        with subprocess.Popen(command, stderr=device) as scan:
            os.close(device)
            with contextlib.suppress(OSError):  # the last one has closed it
                while data := os.read(terminal, 4096):
                    shown += data
        os.close(terminal)
        assert scan.returncode == 0
        return shown.decode().replace("\r\n", "\n")

    def done(self, output: Path) -> int:
        state = Path(f"{output}.unfinished") / "scan.json"
        return len(json.loads(state.read_text())["nodes"]) if state.exists() else 0

    def until_done(self, output: Path, count: int) -> None:
        deadline = time.monotonic() + 60
        while self.done(output) < count:
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def test_interrupted_killed_and_finished(self, config: Path, tmp_path: Path) -> None:
        output = tmp_path / "scan"
        no_lamps = "altd scan: no lamps are configured: the scan has no LED reference pairs"
        with self.started(config, output) as scan:
            self.until_done(output, 1)
            scan.send_signal(signal.SIGINT)
            errors = scan.communicate(timeout=30)[1].splitlines()
        assert scan.returncode == 130
        assert errors == [no_lamps, "altd scan: interrupted; the same command continues there"]

        with self.started(config, output) as scan:
            self.until_done(output, 3)
            scan.kill()
        assert not output.exists()
        number = max(8, self.done(output) + 2)  # the pace of this run is known from its second node on

        shown = self.on_a_terminal(config, output)
        said = [line.split("\r")[-1].removeprefix("\033[K") for line in shown.removesuffix("\n").split("\n")]
        assert said[0] == no_lamps
        assert said[1].startswith(f"altd scan: going on with {output}.unfinished: ")
        assert said[2] == f"altd scan: 16 exposures in {output}"
        assert said[3].endswith(
            f"turn the unit by 180° in its seat, and record it by altd scan --turned -o {output}-turned"
        )
        assert len(said) == 4
        bars = [part for part in shown.split("\r") if part.startswith("[")]
        half_or_more = "#" * (24 * number // 16)
        wanted = re.compile(rf"\[{half_or_more}\.*\] {number}/16 nodes, \d:\d\d left")
        assert any(wanted.match(bar) for bar in bars), bars
        assert bars[-1].endswith("node x -37.5 y 37.5 mm\033[K")
        recording = open_recording(output)
        assert len(nodes(recording)) == len(recording.rows) / 2 == 16
        assert recording.header.note == "altd scan, playback"
        assert "not an empty folder" in refusal(altd_here("scan", "--config", config, "-o", output))

    def test_a_stage_that_is_not_there_is_one_line(
        self, config: Path, table: GrblTable, tmp_path: Path
    ) -> None:
        table.unplug()
        line = refusal(altd_here("scan", "--config", config, "-o", tmp_path / "scan"))
        assert line.startswith(f"altd scan: [stage] device: {table.device}: there is no such port now")
        assert not Path(f"{tmp_path / 'scan'}.unfinished").exists()

    def test_the_simulators_own_scan_refuses_a_used_folder(self, tmp_path: Path) -> None:
        (tmp_path / "something").touch()
        line = refusal(altd_here("scan", "--stage", "-o", tmp_path, module="hw_sim"))
        assert line == f"hw_sim: {tmp_path}: exists and is not an empty folder"

    def test_a_flat_is_recorded_of_the_unit_as_it_is(self, config: Path, tmp_path: Path) -> None:
        config.write_text(config.read_text() + "turned_deg = 180\n")
        line = refusal(altd_here("scan", "--flat", "--config", config, "-o", tmp_path / "flat"))
        assert line == "altd scan: [scan] turned_deg: a flat is recorded with the unit as it is: set 0"

    def test_a_config_without_a_stage_is_one_line(self, tmp_path: Path) -> None:
        write_beams(tmp_path / "rec", [(10.0, 5.0, 0.0, 0.0)])
        config = write_config(tmp_path / "altd.toml", tmp_path / "none.json", tmp_path / "rec")
        line = refusal(altd_here("scan", "--config", config, "-o", tmp_path / "scan"))
        assert line == f"altd scan: {config}: stage: no [stage] table"
