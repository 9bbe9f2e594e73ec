"""``altd run`` checks itself by LEDs on output lines of GigE Vision cameras, and names what is wrong.

Cameras and LEDs are hw_sim's, behind Aravis' implementation of GigE Vision, in a process of their own.
"""

import contextlib
import json
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support.gige_unit import Served, served
from support.ports import free_port
from support.unit_toml import unit_toml

pytestmark = pytest.mark.real_time

WITHIN_S = 30.0
EXPOSURES = 6
MORE = """
[lamps]
driver = "camera"
cameras = ["front", "rear"]
line = "Line1"

[measuring]
pair_by = "time"

[self_check]
exposures = {exposures}

[http]
host = "127.0.0.1"
port = {port}
"""
CAMERA = """
driver = "aravis"
device = "{address}"
exposure = {{ control = "fixed", exposure_ms = 1.6 }}
"""


@dataclass
class CheckedUnit:
    """The cameras, and the daemon behind them as its clients see it."""

    cameras: Served
    url: str

    def fail(self, faults: str) -> None:
        """From now on these faults are present."""
        assert self.cameras.process.stdin is not None
        self.cameras.process.stdin.write(f"{faults}\n")
        self.cameras.process.stdin.flush()

    def check(self) -> Any:
        """The report of a check that the daemon makes now."""
        headers = {"X-Altd-Request": "test"}
        request = urllib.request.Request(self.url + "self-check", method="POST", headers=headers)
        with urllib.request.urlopen(request, timeout=WITHIN_S) as answer:
            return json.load(answer)

    def said(self, what: str, wanted: Callable[[Any], bool]) -> Any:
        """An answer of the interface once it is so."""
        end_s, found = time.monotonic() + WITHIN_S, None
        while time.monotonic() < end_s:
            with contextlib.suppress(OSError), urllib.request.urlopen(self.url + what, timeout=5) as answer:
                found = json.load(answer)
                if wanted(found):
                    return found
            time.sleep(0.05)
        raise AssertionError(f"not within {WITHIN_S:g} s: {found}")


def with_code(code: str) -> Callable[[Any], bool]:
    return lambda measured: code in measured["status"]


@contextlib.contextmanager
def checked_unit(calibration: Path, folder: Path, faults: str) -> Iterator[CheckedUnit]:
    port = free_port()
    with served("--seed", "3", "--pose", "12", "-7", "1.5", "-2", "--faults", faults, "--listen") as cameras:
        front, rear = (CAMERA.format(address=address) for address in (cameras.front, cameras.rear))
        more = MORE.format(exposures=EXPOSURES, port=port)
        config = folder / "altd.toml"
        config.write_text(unit_toml("SIM-3", calibration, front, rear, more))
        words = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]
        with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as daemon:
            try:
                yield CheckedUnit(cameras, f"http://127.0.0.1:{port}/api/")
            finally:
                daemon.terminate()
                _, said = daemon.communicate(timeout=10)
        assert daemon.returncode == 0, said


@pytest.fixture(scope="module")
def seen(unit_3: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """All that goes wrong, one after the other: a daemon leaves 5 s between two checks."""
    found: dict[str, Any] = {}
    calibration, folder = unit_3 / "cal.json", tmp_path_factory.mktemp("gige")
    with checked_unit(calibration, folder, "front_blinking_light") as unit:
        found["blinking"] = unit.said("self-check", lambda check: check["verdict"] is not None)
        found["measured, blinking"] = unit.said("measurement", lambda measured: measured["valid"])

        unit.fail("leds_dark")
        found["dark"] = unit.check()
        found["measured, dark"] = unit.said("measurement", with_code("geometry_unknown"))

        unit.fail("rear_camera_moved")
        time.sleep(1.5)  # the cameras pause while the new picture is worked out
        unit.fail("rear_camera_moved,pushed_aside")
        found["blow"] = unit.said("self-check", lambda check: check["number"] > found["dark"]["number"])
        found["measured, blow"] = unit.said("measurement", with_code("geometry_drift"))
        found["status, blow"] = unit.said("status", lambda status: True)

        unit.fail("")
        time.sleep(1.5)
        found["mended"] = unit.check()
        found["measured, mended"] = unit.said("measurement", lambda measured: measured["valid"])
    return found


def test_a_light_that_blinks_by_itself_is_named_and_spoils_nothing(seen: dict[str, Any]) -> None:
    check = seen["blinking"]
    assert (check["cause"], check["verdict"]) == ("start", "good")
    assert check["notes"]
    assert all(
        note.startswith("front: a light at u ") and note.endswith(" px appeared or vanished without the LEDs")
        for note in check["notes"]
    )
    assert set(seen["measured, blinking"]["status"]) <= {"simulated", "rehearsal", "exposures_lost"}


def test_leds_that_all_stay_dark_are_named(seen: dict[str, Any]) -> None:
    check = seen["dark"]
    assert check["verdict"] == "unknown"
    assert sorted(check["reasons"]) == [
        f"{target}: no LED can be used; LED 1, 2, 3, 4, 5, 6: dark" for target in ("front", "rear")
    ]
    assert seen["measured, dark"]["valid"]


def test_a_blow_is_followed_by_a_check_that_finds_what_it_did(seen: dict[str, Any]) -> None:
    check = seen["blow"]
    assert (check["cause"], check["verdict"]) == ("shock", "bad")
    assert any(reason.startswith("rear: the picture moved by up to") for reason in check["reasons"])
    assert check["targets"]["rear"]["turn_deg"] == pytest.approx(0.1, abs=0.02)
    assert check["targets"]["front"]["significance"] < 7.0
    assert seen["status, blow"]["components"]["self-check"]["shocks"] == 1
    assert not seen["measured, blow"]["valid"]
    assert seen["measured, blow"]["x_mm"] is None


def test_once_all_is_mended_it_is_good_again(seen: dict[str, Any]) -> None:
    check = seen["mended"]
    assert (check["verdict"], check["notes"]) == ("good", [])
    assert [check["targets"][target]["leds_found"] for target in ("front", "rear")] == [6, 6]
    assert set(seen["measured, mended"]["status"]) <= {"simulated", "rehearsal", "exposures_lost"}
