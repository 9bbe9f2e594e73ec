"""Frames that are not new, or not of their time, in the chain that ``run`` and ``replay`` share."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from support.measurements import beam_chain, beam_of

from altd.config import Installation, Measuring
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain
from altd.reasons import Reason
from altd.records import Frame, Measurement
from hw_sim.beam import BeamPose
from hw_sim.motion import Vibration
from hw_sim.unit import CAMERAS, FRONT, REAR, Unit, UnitConfig

WINDOW = 10
PERIOD_NS = 50_000_000
POSE = BeamPose(5.0, -4.0, 0.02, -0.03)


def chain(calibration: Calibration, installation: Installation | None = None) -> MeasuringChain:
    return beam_chain(calibration, Measuring(window=WINDOW), installation)


def shown(unit: Unit, count: int) -> Iterator[Frame]:
    for n in range(count):
        for camera in CAMERAS:
            yield unit.expose(camera, n, n * PERIOD_NS)


def measured(chain: MeasuringChain, frames: Iterator[Frame]) -> list[tuple[int, Measurement]]:
    """Each measurement with the number of the exposure after which it came."""
    return [(frame.sequence, m) for frame in frames for m in chain.push(frame)]


def codes(measurement: Measurement) -> list[str]:
    """Without ``simulated``, which the calibration brings."""
    return [str(fault) for fault in measurement.status if fault.reason is not Reason.SIMULATED]


def at_rest() -> Unit:
    unit = Unit(UnitConfig(seed=3))
    unit.place(POSE)
    return unit


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("loop", [1, 2, 5])
def test_a_frozen_camera_is_invalid_within_two_frames_and_well_half_a_window_after(
    calibration_of_unit_3: Calibration, camera: str, loop: int
) -> None:
    unit, thawed = at_rest(), 45
    pictures = {n: unit.expose(camera, n, 0).pixels for n in range(30 - loop, 30)}

    def frozen() -> Iterator[Frame]:
        for frame in shown(unit, 60):
            stuck = frame.camera == camera and 30 <= frame.sequence < thawed
            yield replace(frame, pixels=pictures[30 - loop + frame.sequence % loop]) if stuck else frame

    results = measured(chain(calibration_of_unit_3), frozen())
    valid = {n for n, m in results if m.valid}
    assert set(range(WINDOW, 30)) <= valid
    assert not valid & set(range(31, thawed))
    assert set(range(thawed + WINDOW // 2, 60)) <= valid
    while_frozen = [m for n, m in results if 31 <= n < thawed]
    assert {code for m in while_frozen for code in codes(m)} == {f"{camera}_frame_repeated"}
    assert "of the picture is that of exposure" in while_frozen[-1].status[0].detail


def test_a_frame_that_comes_twice_is_lost_and_no_more(calibration_of_unit_3: Calibration) -> None:
    unit = at_rest()

    def doubled() -> Iterator[Frame]:
        for frame in shown(unit, 40):
            twice = frame.camera == FRONT and frame.sequence == 20
            yield replace(frame, pixels=unit.expose(FRONT, 19, 0).pixels) if twice else frame

    results = dict(measured(chain(calibration_of_unit_3), doubled()))
    assert all(m.valid for n, m in results.items() if n >= WINDOW)
    assert [n for n, m in results.items() if codes(m) == ["exposures_lost"]] == list(range(20, 20 + WINDOW))
    beam = beam_of(results[20])
    assert beam is not None
    assert results[20].frames == WINDOW - 1


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_picture_that_came_too_late_to_be_measured_is_known_when_it_comes_again(
    calibration_of_unit_3: Calibration, camera: str
) -> None:
    """Exposure 15 comes after its frame set was given up, and again as exposures 21 and 22."""
    unit = at_rest()
    late = unit.expose(camera, 15, 15 * PERIOD_NS)

    def again() -> Iterator[Frame]:
        for frame in shown(unit, 23):
            if frame.camera != camera or not 15 <= frame.sequence <= 20:
                is_again = frame.camera == camera and frame.sequence > 20
                yield replace(frame, pixels=late.pixels) if is_again else frame
            if frame.sequence == 20 and frame.camera == CAMERAS[-1]:
                yield late

    measuring = chain(calibration_of_unit_3)
    results = measured(measuring, again())
    assert measuring.pairer.late == 1
    assert codes(results[-1][1])[0] == f"{camera}_frame_repeated"
    assert any("of the picture is that of exposure 15" in found for found in measuring.seen().values())
    assert not any(m.valid for n, m in results if n > 20)


def test_a_rear_camera_that_is_a_frame_late_is_out_of_step(calibration_of_unit_3: Calibration) -> None:
    """On a shaking machine, its pictures stamped with the times of the next ones."""
    unit = Unit(UnitConfig(seed=3, vibration=Vibration()))
    unit.place(POSE)

    def late() -> Iterator[Frame]:
        for frame in shown(unit, 260):
            if frame.camera == REAR:
                frame = replace(unit.expose(REAR, frame.sequence, frame.t_ns - PERIOD_NS), t_ns=frame.t_ns)
            yield frame

    results = measured(chain(calibration_of_unit_3), late())
    assert {code for n, m in results if n >= 200 for code in codes(m)} == {"out_of_step"}
    assert not any(m.valid for n, m in results if n >= 200)
    assert results[-1][1].status[0].detail.startswith("the rear spot moves 1 exposure after the front spot")


def test_the_same_machine_with_cameras_in_step_is_measured(calibration_of_unit_3: Calibration) -> None:
    unit = Unit(UnitConfig(seed=3, vibration=Vibration()))
    unit.place(POSE)
    results = measured(chain(calibration_of_unit_3), shown(unit, 260))
    assert all(m.valid for n, m in results if n >= WINDOW)


@pytest.mark.parametrize("slopes", [(0.13, 0.0), (-0.13, 0.0)])
def test_a_yaw_beyond_the_stated_range_is_out_of_range_although_both_spots_are_calibrated(
    calibration_of_unit_3: Calibration, slopes: tuple[float, float]
) -> None:
    unit = Unit(UnitConfig(seed=3))
    unit.place(BeamPose(0.0, 0.0, *slopes))
    last = measured(chain(calibration_of_unit_3), shown(unit, WINDOW))[-1][1]
    assert codes(last) == ["out_of_range"]
    assert last.status[0].detail.startswith(f"yaw is {1000 * slopes[0]:.0f}")


def test_an_offset_turns_no_beam_out_of_range_and_none_that_is_no_number_gets_out(
    calibration_of_unit_3: Calibration,
) -> None:
    turned = chain(calibration_of_unit_3, Installation(offset_yaw_deg=30.0))
    assert measured(turned, shown(at_rest(), WINDOW))[-1][1].valid
    forged = Installation.model_construct(**Installation().model_dump() | {"offset_x_mm": float("nan")})
    last = measured(chain(calibration_of_unit_3, forged), shown(at_rest(), WINDOW))[-1][1]
    assert (last.valid, codes(last)) == (False, ["check_failed"])
    assert last.status[0].detail == "x_mm is nan"


@pytest.mark.parametrize("step_ns", [0, -PERIOD_NS])
def test_exposures_whose_time_stands_still_make_no_mean(
    calibration_of_unit_3: Calibration, step_ns: int
) -> None:
    def standing() -> Iterator[Frame]:
        for frame in shown(at_rest(), 30):
            n = frame.sequence
            yield frame if n < 20 else replace(frame, t_ns=20 * PERIOD_NS + (n - 20) * step_ns)

    results = measured(chain(calibration_of_unit_3), standing())
    assert all(m.valid for n, m in results if WINDOW <= n < 20)
    assert not any(m.valid for n, m in results if n > 21)


def test_a_number_that_jumped_costs_less_than_a_second(calibration_of_unit_3: Calibration) -> None:
    def jumping() -> Iterator[Frame]:
        for frame in shown(at_rest(), 60):
            yield replace(frame, sequence=frame.sequence + 900) if frame.sequence == 30 else frame

    results = measured(chain(calibration_of_unit_3), jumping())
    assert all(m.valid for n, m in results if 30 + 20 <= n < 60)
    assert FRONT in results[-1][1].targets
