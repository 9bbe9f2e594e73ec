"""The whole daemon with its lamps on a simulated chip, and ``altd lamps``."""

import itertools
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here, refusal
from support.guest import run_in_guest
from support.played_unit import PlayedUnit
from support.recordings import write_beams
from support.unit_toml import write_config

SWALLOWED = """
import os, signal, sys, time
from altd.cli import main as cli
from altd.app import parts

class Lamps:
    def open(self):
        pass
    def switch(self, on):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)
        except BaseException:
            print("swallowed", flush=True)
    def close(self):
        print("closed", flush=True)

parts.lamps_of = lambda *_, **__: Lamps()
sys.exit(cli.main(["lamps", "on", "--config", sys.argv[1]]))
"""
"""Ctrl-C while a library of the driver calls back, as PyGObject does: what is raised there goes nowhere."""

DARK = {"LED_A": 0, "LED_B": 0, "DATA": 0, "ERROR": 0, "POWER": 0, "OK": 0}


@pytest.fixture(scope="module")
def unit(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration and a recording of a beam, four seconds long: the lamps are the subject, not the rate."""
    folder = tmp_path_factory.mktemp("unit")
    shutil.copy(played_unit.calibration, folder / "cal.json")
    write_beams(folder / "beam", [(2.0, -3.0, 0.01, 0.02)], exposures=20, fps=5)
    return folder


@pytest.fixture(scope="module")
def seen(unit: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("guest")
    found: dict[str, Any] = run_in_guest(folder, "lamps_daemon.py", unit, timeout_s=600).results
    return found


@pytest.mark.waits
class TestDaemon:
    def test_shows_that_it_runs_and_that_what_it_measures_is_no_live_value(
        self, seen: dict[str, Any]
    ) -> None:
        assert seen["measuring"]["POWER"] == 1
        assert seen["measuring"]["ERROR"] == 0
        assert 0.3 < seen["measuring"]["OK"] < 0.7  # it plays a recording: a warning

    def test_keeps_the_frame_leds_dark(self, seen: dict[str, Any]) -> None:
        assert seen["measuring"]["LED_A"] == seen["measuring"]["LED_B"] == 0

    def test_flashes_data_when_it_gave_some_and_not_otherwise(self, seen: dict[str, Any]) -> None:
        assert seen["measuring"]["DATA"] == 0
        assert seen["after one request"] == [0, 1, 0]

    def test_says_who_has_taken_its_lines_and_measures_on(self, seen: dict[str, Any]) -> None:
        said = {name: seen["taken"][name]["message"] for name in ("indicators", "lamps")}
        assert said["indicators"].endswith("): 'OK' taken by 'blinker'; trying again")
        assert said["lamps"].endswith("): 'LED_A' taken by 'torch'; trying again")
        assert all(message.startswith("GPIO chip 'unit' (/dev/gpiochip") for message in said.values())
        assert seen["valid while taken"] > 0

    def test_has_the_lines_once_they_are_let_go(self, seen: dict[str, Any]) -> None:
        assert seen["let go"]["indicators"]["message"] == seen["let go"]["lamps"]["message"] == ""

    def test_notices_a_chip_that_went_away_and_gets_it_back(self, seen: dict[str, Any]) -> None:
        said = (
            "no GPIO chip 'unit'",
            "gone",
            "the driver does not answer within 1 s",
        )  # the last: on a busy machine
        for name in ("indicators", "lamps"):
            assert any(words in seen["unplugged"][name]["message"] for words in said)
            assert seen["plugged"][name]["state"] == "ok"
        assert seen["unplugged"]["after_s"] < 5
        assert seen["valid while unplugged"] > 0

    def test_ends_dark(self, seen: dict[str, Any]) -> None:
        status, complaints = seen["ended"]
        assert status == 0
        assert "Traceback" not in complaints
        let_go = [levels for what, levels in seen["notes of the ended"] if what == "let go"][-2:]
        lines = {"LED_A", "LED_B"}, {"DATA", "ERROR", "POWER", "OK"}
        assert any(all(levels[line] == 0 for line in lines[0]) for levels in let_go)
        assert any(all(levels[line] == 0 for line in lines[1]) for levels in let_go)

    def test_begins_dark(self, seen: dict[str, Any]) -> None:
        first_two = [levels for what, levels in seen["notes of the ended"] if what == "opened"][:2]
        assert first_two[-1]["LED_B"] == first_two[-1]["LED_A"] == 0


@pytest.mark.waits  # in one part of the tests with TestDaemon: one guest for both
class TestCommand:
    def test_after_a_failure_leaves_error_lit_and_all_else_dark(self, seen: dict[str, Any]) -> None:
        assert seen["pins of the killed"]["OK"] == 1  # as it is wired here, killed it is lit
        assert seen["stopped, failed"] == ["", "", 0]
        assert DARK | {"ERROR": 1} in [levels for _, levels in seen["notes, failed"]]

    def test_after_a_good_end_leaves_all_dark(self, seen: dict[str, Any]) -> None:
        assert seen["stopped, well"] == ["", "", 0]
        assert DARK in [levels for _, levels in seen["notes, well"]]
        assert not any(levels["ERROR"] for _, levels in seen["notes, well"])

    def test_darkens_what_it_can_have_and_says_what_it_cannot(self, seen: dict[str, Any]) -> None:
        out, complaint, status = seen["off, partly taken"]
        assert (out, status) == ("", 1)
        assert complaint.count("\n") == 1
        assert complaint.endswith(": 'OK' taken by 'blinker'\n")
        assert [levels["LED_B"] for what, levels in seen["notes, partly taken"] if what == "let go"] == [0]

    def test_lights_each_lamp_in_turn_by_name(self, seen: dict[str, Any]) -> None:
        out, complaint, status = seen["test"]
        assert (complaint, status) == ("", 0)
        names = ["indicator data", "indicator error", "indicator power", "indicator ok", "frame LEDs"]
        assert out.splitlines() == names
        held = itertools.takewhile(lambda note: note[0] != "let go", seen["notes, test"])
        looks = [tuple(line for line in DARK if levels[line]) for what, levels in held if what == "set"]
        lit = [look for look, _ in itertools.groupby(looks) if look]
        assert lit == [("DATA",), ("ERROR",), ("POWER",), ("OK",), ("LED_A", "LED_B")]

    def test_lights_all_until_it_is_ended(self, seen: dict[str, Any]) -> None:
        assert seen["on"] == ["all are lit; Ctrl-C darkens them\n", [1] * 6]
        assert seen["on, ended"] == 143  # SIGTERM
        indicators, frame = [levels for what, levels in seen["notes, on"] if what == "let go"]
        assert not any(indicators[line] for line in ("DATA", "ERROR", "POWER", "OK"))
        assert not any(frame[line] for line in ("LED_A", "LED_B"))

    def test_is_refused_while_the_daemon_runs(self, seen: dict[str, Any]) -> None:
        out, complaint, status = seen["test while it runs"]
        assert (out, status) == ("", 1)
        assert complaint.count("\n") == 1
        everything = "'DATA', 'ERROR', 'POWER', 'OK' taken by 'altd', the daemon or one of its commands"
        assert complaint.endswith(f": {everything}\n")


class TestCommandLine:
    def test_without_lamps_in_the_config_says_so(self, unit: Path, tmp_path: Path) -> None:
        config = write_config(tmp_path / "altd.toml", unit / "cal.json", unit / "beam")
        assert refusal(altd_here("lamps", "test", "--config", config)).endswith(
            "altd.toml: no [lamps] and no [indicators] table"
        )

    def test_after_a_service_without_lamps_has_nothing_to_do(self, unit: Path, tmp_path: Path) -> None:
        config = write_config(tmp_path / "altd.toml", unit / "cal.json", unit / "beam")
        outcome = altd_here("lamps", "stopped", "--config", config)
        assert (outcome.status, outcome.out, outcome.err) == (0, "", "")

    def test_an_interruption_that_a_library_swallows_ends_it_all_the_same(
        self, unit: Path, tmp_path: Path
    ) -> None:
        more = '\n[lamps]\ndriver = "gpiod"\nchip = "none"\nlines = ["A"]\n'
        config = write_config(tmp_path / "altd.toml", unit / "cal.json", unit / "beam", more)
        done = subprocess.run(
            [sys.executable, "-c", SWALLOWED, config], capture_output=True, text=True, timeout=20, check=False
        )
        assert (done.returncode, done.stderr) == (130, "")
        assert done.stdout.splitlines() == ["swallowed", "all are lit; Ctrl-C darkens them", "closed"]

    def test_without_a_chip_ends_in_one_line(self, unit: Path, tmp_path: Path) -> None:
        more = '\n[indicators]\ndriver = "gpiod"\nchip = "no such chip"\nok = "OK"\n'
        config = write_config(tmp_path / "altd.toml", unit / "cal.json", unit / "beam", more)
        outcome = altd_here("lamps", "off", "--config", config)
        assert (outcome.status, outcome.out) == (1, "")
        assert outcome.err.startswith("altd lamps: no GPIO chip 'no such chip', those that can be opened: ")
        assert outcome.err.count("\n") == 1
