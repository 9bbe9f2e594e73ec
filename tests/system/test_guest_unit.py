"""The whole daemon with two cameras of the kernel's test drivers, in a guest.

``make bench-guest`` runs the first of it for a minute and prints the figures.
"""

import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.fed_unit import POSE, render, write_config
from support.foreign import need_program
from support.guest import run_in_guest
from support.measurements import beam_chain, beam_of

from altd.calibration.file import load_calibration
from altd.config import Measuring
from altd.measuring.frame_chain import Provenance
from altd.reasons import Reason
from altd.records import Fault, Frame, Measurement
from hw_sim.unit import CAMERAS

pytestmark = pytest.mark.alone

SEED = 3
EXPOSURES = 307
"""Twice what altd remembers, and a prime: they are fed again and again, a camera shows all or every second of
them, and none is to be taken for a frozen camera's."""
BENCH_S = os.environ.get("ALTD_BENCH_GUEST_S")
"""Measure for so long on a quiet machine, where nothing at all may be lost."""
QUANTITIES = ("x_mm", "y_mm", "yaw_deg", "pitch_deg")


@dataclass(frozen=True)
class FedUnit:
    folder: Path
    calibration: Path
    frames: Path

    def config(self, fps: float) -> Path:
        path = self.folder / f"{fps:g}.toml"
        return write_config(path, SEED, self.calibration, fps)


@pytest.fixture(scope="module")
def unit(unit_3: Path, tmp_path_factory: pytest.TempPathFactory) -> FedUnit:
    folder = tmp_path_factory.mktemp("unit")
    return FedUnit(folder, unit_3 / "cal.json", render(SEED, folder, EXPOSURES))


@pytest.fixture(scope="module")
def measured(unit: FedUnit, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two v4l2loopback cameras of 752 × 480 at 20 frames a second."""
    seconds = float(BENCH_S or 8)
    run = run_in_guest(
        tmp_path_factory.mktemp("measuring"),
        "measuring.py",
        unit.config(20),
        unit.frames,
        20,
        seconds,
        kernel_arguments=("v4l2loopback.devices=2", "v4l2loopback.max_buffers=8"),
        timeout_s=seconds + 90,
    )
    return run.results


@pytest.fixture(scope="module")
def in_process(unit: FedUnit) -> list[Measurement]:
    """The measuring chain's results on the same frames without cameras, drivers and daemon."""
    calibration = load_calibration(unit.calibration)
    provenance = Provenance(origins=lambda: [Fault(Reason.SIMULATED)])
    chain = beam_chain(calibration, Measuring(pair_by="time"), provenance=provenance)
    exposures = np.load(unit.frames)
    measurements: list[Measurement] = []
    for number in range(EXPOSURES):
        for index, camera in enumerate(CAMERAS):
            pixels = exposures[number, index]
            measurements += chain.push(Frame(camera, number, number * 50_000_000, pixels))
    return [measurement for measurement in measurements if measurement.valid]


def counted(measured: Any, component: str, counter: str) -> int:
    """The increase of a counter while it was measured."""
    before, after = (measured[when][component].get(counter, 0) for when in ("before", "after"))
    return int(after - before)


def lost_frames(measured: Any) -> tuple[int, int]:
    """Of both cameras: lost by the driver, and overtaken by the next before they were measured."""
    return (
        sum(counted(measured, f"camera {camera}", "lost") for camera in CAMERAS),
        sum(counted(measured, "measuring", f"dropped_{camera}") for camera in CAMERAS),
    )


def test_no_pair_of_frames_is_lost(measured: Any) -> None:
    exposed = 20 * measured["seconds"]
    assert sum(lost_frames(measured)) <= (0 if BENCH_S else 0.05 * exposed), "a busy machine may lose some"
    measurements = counted(measured, "measuring", "measurements")
    assert measurements == pytest.approx(exposed, abs=2 if BENCH_S else 0.05 * exposed)
    assert counted(measured, "measuring", "valid") == measurements


def test_every_measurement_is_valid_and_says_that_its_cameras_are_not_real(measured: Any) -> None:
    events = [event for _, event in measured["events"]]
    assert len(events) > 100
    for event in events:
        assert event["valid"]
        assert "simulated" in event["status"]
        assert set(event["status"]) <= {"simulated", "rehearsal", "exposures_lost"}


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_measurements_lie_about_the_truth_as_those_of_the_chain_alone(
    measured: Any, in_process: list[Measurement], quantity: str
) -> None:
    events = [event for _, event in measured["events"]]
    here = np.array([event[quantity] for event in events]) - getattr(POSE, quantity)
    alone = np.array([getattr(beam_of(one), quantity) for one in in_process]) - getattr(POSE, quantity)
    rms_here, rms_alone = np.sqrt(np.mean(here**2)), np.sqrt(np.mean(alone**2))
    assert rms_here < 1.2 * rms_alone + 1e-4, "the values have four decimals on the wire"
    assert rms_here < 3 * np.mean([event["sigma"][quantity] for event in events])


def test_modbus_answers_meanwhile(measured: Any) -> None:
    assert measured["modbus_failures"] == 0
    assert len(measured["modbus_s"]) > 20
    assert np.median(measured["modbus_s"]) < 0.05


if BENCH_S:  # figures of a busy machine say nothing

    def test_figures(
        measured: Any, in_process: list[Measurement], capsys: pytest.CaptureFixture[str]
    ) -> None:
        events = measured["events"]
        intervals_ms = np.diff([at_s for at_s, _ in events]) * 1e3
        modbus_ms = np.array(measured["modbus_s"]) * 1e3
        with capsys.disabled():
            measurements = counted(measured, "measuring", "measurements")
            print(f"\n{measured['seconds']:.1f} s, {measurements} measurements,", end=" ")
            by_driver, overtaken = lost_frames(measured)
            print(f"frames lost by the driver {by_driver}, overtaken in the daemon {overtaken};", end=" ")
            print(f"intervals {intervals_ms.min():.1f} to {intervals_ms.max():.1f} ms")
            print(f"interval off 50 ms, p99: {np.percentile(np.abs(intervals_ms - 50), 99):.1f} ms")
            print(f"processor of the daemon: {100 * measured['processor']:.1f} % of one")
            print(f"Modbus answer, p50 and p99: {np.percentile(modbus_ms, 50):.1f}, ", end="")
            print(f"{np.percentile(modbus_ms, 99):.1f} ms")
            for quantity in QUANTITIES:
                truth = getattr(POSE, quantity)
                here = np.array([event[quantity] for _, event in events]) - truth
                alone = np.array([getattr(beam_of(one), quantity) for one in in_process]) - truth
                print(f"{quantity}: error {here.mean():+.4f} ± {here.std():.4f}", end=", ")
                print(f"in process {alone.mean():+.4f} ± {alone.std():.4f}")


@pytest.fixture(scope="module")
def failed(unit: FedUnit, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two vivid cameras that run freely, at any lag to each other."""
    need_program("v4l2-ctl", "v4l-utils")
    run = run_in_guest(
        tmp_path_factory.mktemp("failing"),
        "failing.py",
        unit.config(25),
        unit.frames,
        25,
        kernel_arguments=("vivid.n_devs=2",),
        timeout_s=400,
    )
    return run.results


def first(said: list[list[Any]], fits: Any) -> float:
    """When something was first said, in seconds since the fault; infinity when it never was."""
    return next((at_s for at_s, *what in said if fits(*what)), float("inf"))


def test_dropped_buffers_are_counted_and_told_with_the_count(failed: Any) -> None:
    """The fault begins some tenths of a second after its command, and a second may lose nothing."""
    dropping = failed["dropping"]
    lost_before = dropping["before"].get("lost", 0)
    said = [dropping["before"], *(camera for _, camera in dropping["camera"])]
    counted = [(one, two) for one, two in pairwise(said) if two.get("lost", 0) > one.get("lost", 0)]
    assert counted
    assert all(two["state"] == "degraded" for _, two in counted)
    assert first(dropping["camera"], lambda camera: camera["state"] == "degraded") < 2.0
    last, ended_s = dropping["camera"][-1][1], dropping["ended_s"]
    assert 3 <= last["lost"] - lost_before <= 0.5 * 25 * ended_s, "a fifth of 25 a second"
    assert any(camera["state"] == "ok" for at_s, camera in dropping["camera"] if at_s > ended_s)
    after = [(at_s, valid, codes) for at_s, valid, codes in dropping["measured"] if at_s > ended_s]
    assert any(valid for _, valid, _ in after), after


def test_a_stream_that_breaks_off_is_told_within_a_second_and_runs_again(failed: Any) -> None:
    breaking = failed["breaking"]
    told = [camera for _, camera in breaking["camera"] if camera["state"] == "failed"]
    assert first(breaking["camera"], lambda camera: camera["state"] == "failed") < 1.0
    assert "lost: /dev/v4l/by-path/front: the driver broke off the stream" in told[0]["message"]
    assert breaking["camera"][-1][1]["failures"] == breaking["before"].get("failures", 0) + 1
    ended_s = breaking["ended_s"]
    assert any(camera["state"] == "ok" for at_s, camera in breaking["camera"] if at_s > ended_s)
    assert any(valid for at_s, valid, _ in breaking["measured"] if at_s > ended_s + 1.0)


def test_a_camera_pulled_out_makes_the_measurement_invalid_with_the_reason(failed: Any) -> None:
    pulled = failed["pulled_out"]
    assert first(pulled["camera"], lambda camera: "the camera is gone" in camera["message"]) < 1.0
    assert first(pulled["camera"], lambda camera: "not found" in camera["message"]) < 1.5
    silent_s = first(pulled["measured"], lambda valid, why: not valid and "front_camera_silent" in why)
    assert silent_s < 1.0
    while_away = [valid for at_s, valid, _ in pulled["measured"] if silent_s < at_s < pulled["ended_s"] - 0.1]
    assert while_away
    assert not any(while_away)


def test_a_camera_that_is_back_delivers_again_without_a_restart(failed: Any) -> None:
    pulled = failed["pulled_out"]
    after = [(at_s, valid, why) for at_s, valid, why in pulled["measured"] if at_s > pulled["ended_s"] - 0.1]
    delivers_s = first(after, lambda _, why: "front_camera_silent" not in why)
    assert delivers_s - pulled["ended_s"] < 2.5, "retried each second at the latest, and a window to fill"
    assert any(valid for _, valid, _ in after), after[-5:]
    assert failed["alive"]


def test_modbus_answers_while_cameras_fail(failed: Any) -> None:
    assert failed["modbus_failures"] == 0
    assert np.median(failed["modbus_s"]) < 0.05
