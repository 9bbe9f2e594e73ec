"""Every fault of the simulated unit gives its reason and no number, on the chain that the daemon uses."""

import json

import pytest
from support.measurements import beam_chain, beam_of

from altd.config import Measuring
from altd.files.documents import line_of
from altd.instruments.beam.instrument import QUANTITIES
from altd.measuring.calibration import Calibration
from altd.ports import CameraTimeoutError
from altd.publish.serial.words import status_text
from altd.records import Measurement
from altd.status.measurement_json import as_object
from hw_sim.beam import BeamPose
from hw_sim.camera import make_cameras
from hw_sim.faults import Fault
from hw_sim.unit import Unit, UnitConfig
from tools.pages.serial_examples import unit_that_shows

SEED = 3
WINDOW = 4
NUMBERS = ("x_mm", "y_mm", "yaw_deg", "pitch_deg", "yaw_mm_per_m", "pitch_mm_per_m", "roll_deg")


@pytest.fixture(scope="module")
def calibration(calibration_of_unit_3: Calibration) -> Calibration:
    return calibration_of_unit_3


def measure(unit: Unit, calibration: Calibration, exposures: int = 12) -> list[Measurement]:
    chain = beam_chain(calibration, Measuring(window=WINDOW, max_skew_ms=10.0))
    cameras = make_cameras(unit, real_time=False)
    out: list[Measurement] = []
    for camera in cameras:
        camera.open()
    for _ in range(exposures):
        for camera in cameras:
            try:
                out += chain.push(camera.next_frame(0.001))
            except CameraTimeoutError:
                continue
    for camera in cameras:
        camera.close()
    return out + chain.flush()


def numbers_in(measurement: Measurement) -> list[object]:
    line = json.loads(line_of(as_object(measurement)))
    points = [value for target in ("front", "rear") for value in line[target].values()]
    return [line[name] for name in NUMBERS] + [*line["sigma"].values()] + points


CASES = {
    Fault.NO_LASER: {"front_spot_missing", "rear_spot_missing"},
    Fault.FRONT_SPOT_MISSING: {"front_spot_missing"},
    Fault.REAR_SPOT_MISSING: {"rear_spot_missing"},
    Fault.FRONT_SECOND_SPOT: {"front_ambiguous"},
    Fault.REAR_SECOND_SPOT: {"rear_ambiguous"},
    Fault.SATURATED: {"front_saturated", "rear_saturated"},
    Fault.BLACK: {"front_spot_missing", "rear_spot_missing"},
    Fault.WHITE: {"front_saturated", "rear_saturated"},
    Fault.NOISE_ONLY: {"front_spot_missing", "rear_spot_missing"},
    Fault.CUT_BY_EDGE: {"front_cut_by_edge"},
    Fault.OUT_OF_AREA: {"out_of_range"},
    Fault.OUT_OF_STEP: {"out_of_step"},
    Fault.FRONT_SILENT: {"front_camera_silent"},
    Fault.REAR_SILENT: {"rear_camera_silent"},
    Fault.LEDS_ON: {"front_ambiguous", "rear_ambiguous"},
}


@pytest.fixture(scope="module", params=CASES, ids=str)
def fault(request: pytest.FixtureRequest) -> Fault:
    return Fault(request.param)


@pytest.fixture(scope="module")
def measurements(fault: Fault, calibration: Calibration) -> list[Measurement]:
    """Of a unit that has the fault."""
    unit = Unit(UnitConfig(seed=SEED, faults=frozenset({fault})))
    unit.place(BeamPose(8.0, -6.0, 0.02, 0.01))
    return measure(unit, calibration)


def test_a_fault_gives_its_reason_and_no_number(fault: Fault, measurements: list[Measurement]) -> None:
    assert measurements
    for measurement in measurements:
        assert not measurement.valid, measurement
        assert numbers_in(measurement) == [None] * len(numbers_in(measurement))
        assert measurement.status
    reasons = {str(reason) for reason in measurements[-1].status}
    assert CASES[fault] <= reasons, reasons


REMEDIES = {
    Fault.NO_LASER: "switch the laser on",
    Fault.FRONT_SPOT_MISSING: "the laser reaches the other target: check what covers this one or its camera",
    Fault.REAR_SPOT_MISSING: "the laser reaches the other target: check what covers this one or its camera",
    Fault.FRONT_SECOND_SPOT: "look for reflections and other lasers",
    Fault.REAR_SECOND_SPOT: "look for reflections and other lasers",
    Fault.SATURATED: "shorten the exposure or take power off the laser",
    Fault.BLACK: "switch the laser on",
    Fault.WHITE: "keep daylight and lamps off the window",
    Fault.NOISE_ONLY: "switch the laser on",
    Fault.CUT_BY_EDGE: "bring the beam nearer to the middle",
    Fault.OUT_OF_AREA: "bring the beam nearer to the middle",
    Fault.OUT_OF_STEP: "check the trigger of the cameras",
    Fault.FRONT_SILENT: "check the camera's cable and supply",
    Fault.REAR_SILENT: "check the camera's cable and supply",
    Fault.LEDS_ON: "end `altd lamps on`",
}
"""The console's advice, by the cause that was seen."""


def test_the_console_names_the_cause_and_no_other(fault: Fault, measurements: list[Measurement]) -> None:
    told = " ".join(status_text(unit_that_shows(measurements[-1]).view()).split())
    assert REMEDIES[fault] in told, told
    others = set(REMEDIES.values()) - {REMEDIES[fault]}
    assert not [other for other in others if other in told], told


def test_every_fault_has_its_case() -> None:
    told_by_a_self_check = {
        Fault.LEDS_DARK,
        Fault.FRONT_BLINKING_LIGHT,
        Fault.PUSHED_ASIDE,
        Fault.REAR_CAMERA_MOVED,
    }  # drawn: hw_sim/frames/test_unit.py; named: test_self_check.py, test_self_check_lights.py
    assert CASES.keys() == REMEDIES.keys()
    assert set(Fault) - set(CASES) == {Fault.DROPPED_FRAMES} | told_by_a_self_check


def test_without_a_fault_the_same_unit_measures(calibration: Calibration) -> None:
    unit = Unit(UnitConfig(seed=SEED))
    unit.place(BeamPose(8.0, -6.0, 0.02, 0.01))
    last = measure(unit, calibration)[-1]
    assert beam_of(last) is not None
    assert (beam_of(last).x_mm, beam_of(last).y_mm) == pytest.approx((8.0, -6.0), abs=0.04)
    assert (beam_of(last).yaw_mm_per_m, beam_of(last).pitch_mm_per_m) == pytest.approx((20.0, 10.0), abs=0.2)
    assert [quantity.key for quantity in QUANTITIES.of_unit if last.number(quantity.key) is None] == [
        "roll_deg"
    ]


def test_dropped_frames_cost_exposures_but_no_truth(calibration: Calibration) -> None:
    unit = Unit(UnitConfig(seed=SEED, faults=frozenset({Fault.DROPPED_FRAMES})))
    unit.place(BeamPose(8.0, -6.0, 0.02, 0.01))
    for measurement in measure(unit, calibration, exposures=40):
        if beam_of(measurement) is None:
            assert measurement.status
        else:
            assert beam_of(measurement).x_mm == pytest.approx(8.0, abs=0.04)


def test_a_beam_that_goes_and_comes_back_is_invalid_at_once_and_valid_again(calibration: Calibration) -> None:
    unit = Unit(UnitConfig(seed=SEED))
    unit.place(BeamPose(8.0, -6.0))
    chain = beam_chain(calibration, Measuring(window=20))
    cameras = make_cameras(unit, real_time=False)
    for camera in cameras:
        camera.open()
    valid = []
    for exposure in range(60):
        if exposure == 25:
            unit.inject(Fault.NO_LASER)
        if exposure == 35:
            unit.clear()
        for camera in cameras:
            valid += [measurement.valid for measurement in chain.push(camera.next_frame(0.1))]
    assert valid[9:25] == [True] * 16  # half a window is enough
    assert valid[27:35] == [False] * 8  # three exposures without a spot, and the beam is gone
    assert valid[45:] == [True] * 15
