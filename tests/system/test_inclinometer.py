"""The whole daemon with an inclinometer on a pseudo-terminal that fails in every way."""

import contextlib
import json
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from support.played_unit import PlayedUnit, PlayingDaemon, playing

from hw_sim.inclinometer import Inclinometer

BEAM = ("x_mm", "y_mm", "yaw_deg", "pitch_deg", "yaw_mm_per_m", "pitch_mm_per_m")
POLL_S = 0.01
WINDOW = 4
Beam = tuple[object, ...]

pytestmark = pytest.mark.real_time


def beam_in(document: dict[str, Any]) -> Beam:
    """All that a measurement says of its beam."""
    sigmas = [document["sigma"][key] for key in BEAM[:4]]
    return (*(document[key] for key in BEAM), *sigmas, str(document["front"]), str(document["rear"]))


@dataclass
class Watch:
    """Polls the measurement; keeps what whole windows said of the beam."""

    daemon: PlayingDaemon
    beams: set[Beam] = field(default_factory=set)
    invalid: int = 0

    def look(self) -> dict[str, Any]:
        document = self.daemon.measurement()
        self.invalid += not document["valid"]
        if document["frames"] == WINDOW and "exposures_lost" not in document["status"]:
            self.beams.add(beam_in(document))
        return document

    def until(self, reached: Callable[[dict[str, Any]], bool], timeout_s: float) -> float:
        """Seconds until a measurement is so."""
        begin = time.monotonic()
        while time.monotonic() - begin < timeout_s:
            if reached(document := self.look()):
                return time.monotonic() - begin
            time.sleep(POLL_S)
        raise AssertionError(f"not within {timeout_s} s: {document}, {self.component()}")

    def component(self) -> dict[str, Any]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.daemon.http}/api/status", timeout=2) as page:
            found: dict[str, Any] = json.load(page)["components"]["inclinometer"]
            return found


def is_known(document: dict[str, Any]) -> bool:
    return document["roll_deg"] is not None


def is_missing(document: dict[str, Any]) -> bool:
    return document["roll_deg"] is None


@contextlib.contextmanager
def running(
    unit: PlayedUnit, folder: Path, sensor: Inclinometer, driver: str, more: str = ""
) -> Iterator[Watch]:
    table = f'[inclinometer]\ndriver = "{driver}"\ndevice = "{sensor.device}"\n{more}'
    folder.mkdir(exist_ok=True)
    with playing(unit, folder, subprocess.DEVNULL, more=table) as daemon:
        daemon.wait_until_valid()
        watch = Watch(daemon)
        watch.until(is_known, 10.0)
        yield watch


@pytest.fixture(scope="module")
def beams(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> set[Beam]:
    """The daemon's values of the played beam without an inclinometer, over two turns of the recording."""
    with playing(played_unit, tmp_path_factory.mktemp("without"), subprocess.DEVNULL) as daemon:
        daemon.wait_until_valid()
        watch = Watch(daemon)
        end = time.monotonic() + 8.0
        while time.monotonic() < end:
            document = watch.look()
            time.sleep(POLL_S)
    assert document["roll_deg"] is None
    assert "sensors" not in document
    assert len(watch.beams) > 10
    return watch.beams


def _silent(sensor: Inclinometer, on: bool) -> None:
    sensor.answers = not on


def _corrupts(sensor: Inclinometer, on: bool) -> None:
    sensor.corrupts = on


def _echoes(sensor: Inclinometer, on: bool) -> None:
    sensor.echoes, sensor.answers = on, not on


def _frozen(sensor: Inclinometer, on: bool) -> None:
    sensor.frozen = on


def _noisy(sensor: Inclinometer, on: bool) -> None:
    sensor.noise_deg = 3.0 if on else 0.02


def _far_out(sensor: Inclinometer, on: bool) -> None:
    sensor.roll_deg = 60.0 if on else -1.5


def _other_address(sensor: Inclinometer, on: bool) -> None:
    sensor.address = 2 if on else 1


def _invalid_setting(sensor: Inclinometer, on: bool) -> None:
    sensor.settings[133] = 0 if on else 1


def _too_hot(sensor: Inclinometer, on: bool) -> None:
    sensor.temperature_c = 200.0 if on else 21.5


FAULTS: tuple[tuple[Callable[[Inclinometer, bool], None], set[str], str], ...] = (
    (_silent, {"no_answer"}, "no answer"),
    (_corrupts, {"bad_answer"}, "damaged answer"),
    (_echoes, {"no_answer"}, "echoes the requests"),
    (_frozen, {"frozen"}, "has frozen"),
    (_noisy, {"noisy", "out_of_range"}, "scatter"),
    (_far_out, {"out_of_range", "noisy"}, "roll is 60.0 deg"),
    (_other_address, {"no_answer"}, "no answer"),
    (_invalid_setting, {"invalid_setting"}, "55555"),
    (_too_hot, {"out_of_range"}, "temperature cannot be"),
)


def test_whatever_the_sensor_does_roll_is_gone_within_a_second_and_the_beam_is_not_touched(
    played_unit: PlayedUnit, tmp_path: Path, beams: set[Beam]
) -> None:
    took_s: dict[str, float] = {}
    with Inclinometer.balluff() as sensor:
        sensor.roll_deg = -1.5
        with running(played_unit, tmp_path, sensor, "balluff_bsi_r11a0") as watch:
            document = watch.look()
            assert document["roll_deg"] == pytest.approx(-1.5, abs=0.1)
            assert 0.08 < document["sigma"]["roll_deg"] < 0.15
            assert document["sensors"]["roll_deg"]["quality"] == "good"
            assert 0.0 < document["sensors"]["roll_deg"]["age_s"] < 0.8
            for fault, qualities, words in FAULTS:
                fault(sensor, True)
                took_s[fault.__name__] = watch.until(is_missing, 3.0)
                watch.until(lambda now, them=qualities: now["sensors"]["roll_deg"]["quality"] in them, 1.0)  # type: ignore[misc]
                assert "roll_missing" in watch.look()["status"]
                watch.until(lambda _, words=words: words in watch.component()["message"], 2.0)  # type: ignore[misc]
                assert watch.component()["state"] == "failed"
                fault(sensor, False)
                watch.until(is_known, 6.0)
                assert "roll_missing" not in watch.look()["status"]
            sensor.unplug()
            took_s["unplugged"] = watch.until(is_missing, 3.0)
            watch.until(lambda now: now["sensors"]["roll_deg"]["quality"] == "no_port", 1.0)
            assert watch.look()["valid"]
    print({name: round(seconds, 2) for name, seconds in took_s.items()})
    assert max(took_s.values()) < 1.0, took_s
    assert watch.invalid == 0
    assert len(watch.beams) > 10
    assert watch.beams <= beams


def test_a_sensor_of_another_make_never_gives_a_roll(played_unit: PlayedUnit, tmp_path: Path) -> None:
    with Inclinometer.witmotion() as sensor:
        table = f'[inclinometer]\ndriver = "balluff_bsi_r11a0"\ndevice = "{sensor.device}"\naddress = 80\n'
        with playing(played_unit, tmp_path, subprocess.DEVNULL, more=table) as daemon:
            daemon.wait_until_valid()
            watch = Watch(daemon)
            watch.until(lambda now: now["sensors"]["roll_deg"]["quality"] == "wrong_sensor", 5.0)
            for _ in range(100):
                assert is_missing(watch.look())
                time.sleep(POLL_S)
            assert "another sensor" in watch.component()["message"]


def test_the_two_axis_sensor_measures_roll_too(played_unit: PlayedUnit, tmp_path: Path) -> None:
    with Inclinometer.witmotion() as sensor:
        sensor.roll_deg, sensor.pitch_deg = 2.5, -0.75
        more = "sign_roll = -1\noffset_roll_deg = 1.0\n"
        with running(played_unit, tmp_path, sensor, "witmotion_wt901c485", more) as watch:
            assert watch.look()["roll_deg"] == pytest.approx(-1.5, abs=0.1)
            assert watch.component()["gravity_pitch_deg"] == pytest.approx(-0.75, abs=0.1)
            sensor.frozen = True
            assert watch.until(is_missing, 3.0) < 1.0
