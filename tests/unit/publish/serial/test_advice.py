"""The remedy is for the cause that was seen: what a fault's detail says, from the code that says it."""

import numpy as np
import pytest
from support.clock import FakeClock
from support.frames import Blob, frame, light

from altd.instruments.beam.instrument import range_fault
from altd.instruments.beam.solver import Beam
from altd.measuring.spot_shape import unlike_a_laser
from altd.publish.serial.advice import advice, component_steps
from altd.reasons import Reason
from altd.records import Fault, FaultCause, NoSpot
from altd.status.cause import Cause
from altd.status.health import MEASURING, CameraTrouble, Health, State
from altd.vision.frame_leds import count_lit_leds, with_leds_as_cause
from altd.vision.localise import locate
from altd.vision.search import search

LEDS = np.array([(100.0, 60.0), (376.0, 60.0), (650.0, 60.0), (100.0, 420.0), (376.0, 420.0), (650.0, 420.0)])


def remedy_of(spot: object, *others: Fault) -> str:
    assert isinstance(spot, NoSpot), spot
    fault = spot.fault("front")
    return advice(fault, [fault, *others]).remedy


def seen(*blobs: Blob, background: float = 8.0) -> object:
    return locate(frame(light(*blobs), np.random.default_rng(1), background=background))


def test_no_spot_is_looked_for_where_it_was_lost() -> None:
    dark = seen()
    assert "switch the laser on" in remedy_of(dark, Fault(Reason.SPOT_MISSING, "rear"))
    assert "switch the laser on" in remedy_of(dark, Fault(Reason.CAMERA_SILENT, "rear"))
    assert "the laser reaches the other target" in remedy_of(dark)
    assert "the laser reaches the other target" in remedy_of(dark, Fault(Reason.SIMULATED))


def test_a_second_spot_is_a_reflection_or_another_laser() -> None:
    assert "other lasers" in remedy_of(seen(Blob(200, 200), Blob(500, 300)))


def test_a_flooded_picture_is_not_the_laser() -> None:
    assert "daylight" in remedy_of(seen(background=255.0))
    assert "take power off the laser" in remedy_of(seen(Blob(300, 200, peak=3000.0)))


def test_leds_that_shine_at_their_places_are_told_from_other_lasers() -> None:
    discs = [Blob(u_px, v_px, 40.0, peak=140.0) for u_px, v_px in LEDS]
    for blobs in (discs, [*discs, Blob(300, 200)], discs[:3]):
        picture = frame(light(*blobs), np.random.default_rng(1))
        spot = locate(picture)
        assert isinstance(spot, NoSpot)
        lit = count_lit_leds(search(picture.pixels), LEDS)
        assert lit == sum(blob.diameter_px == 40.0 for blob in blobs)
        told = with_leds_as_cause(spot, lit, len(LEDS))
        assert (told.reason, told.cause) == (spot.reason, FaultCause.LEDS_LIT)
        assert told.detail == f"the frame LEDs are lit, {lit} of 6 shine at their places"
        assert "end `altd lamps on`" in remedy_of(told)


def test_light_that_is_no_led_is_not_taken_for_them() -> None:
    """Two spots elsewhere; one of two on an LED's place; one flood over all of their places."""
    for blobs in (
        [Blob(200, 200), Blob(500, 300)],
        [Blob(100, 60), Blob(500, 300)],
        [Blob(376, 240, 2500.0, 1500.0, peak=200.0)],
    ):
        picture = frame(light(*blobs), np.random.default_rng(1))
        refused = NoSpot(Reason.AMBIGUOUS, "as found")
        assert with_leds_as_cause(refused, count_lit_leds(search(picture.pixels), LEDS), len(LEDS)) is refused


def test_a_beam_that_is_too_oblique_is_not_brought_to_the_middle() -> None:
    fault = range_fault(Beam(0.0, 0.0, 9.0, 0.0, 0.01, 0.01, 0.001, 0.001))
    assert fault is not None
    assert advice(fault, [fault]) == ("the beam is too oblique", "turn the unit towards the beam")


def test_another_camera_is_told_from_one_that_has_moved() -> None:
    remedies = {
        FaultCause.SWAPPED: ("the cameras are swapped", "swap the cameras' cables"),
        FaultCause.OTHER_CAMERA: (
            "another camera than was calibrated",
            "swap the cameras' cables or put the old camera back",
        ),
        FaultCause.VIEW_MOVED: ("the camera's view has moved", "fasten the camera and calibrate again"),
    }
    for cause, told in remedies.items():
        fault = Fault(Reason.WRONG_CAMERA, "front", cause=cause)
        assert advice(fault, [fault]) == told
        assert Cause(Reason.WRONG_CAMERA, "front", known=cause).remedy == told[1]
    assert Cause(Reason.WRONG_CAMERA, "front").remedy == Reason.WRONG_CAMERA.remedy


def test_a_spot_that_is_too_wide_is_one_of_focus() -> None:
    wide = unlike_a_laser(np.array([np.log(20.0), 0.0, 0.0, 1.0]), None)
    assert wide is not None
    fault = wide.fault("front")
    assert "focus" in advice(fault, [fault]).remedy


@pytest.mark.parametrize(
    ("state", "trouble"),
    [(State.FAILED, CameraTrouble.BUSY), (State.DEGRADED, CameraTrouble.NO_FRAMES), (State.ENDED, None)],
)
def test_a_silent_camera_is_mended_by_what_its_health_says(
    state: State, trouble: CameraTrouble | None
) -> None:
    health = Health(FakeClock())
    health.component("camera rear").set_state(state, "as it says", trouble)
    health.component(MEASURING).set_state(State.DEGRADED, "front: spot at u 1 v 2 px; rear: camera_silent")
    status = [Fault(Reason.CAMERA_SILENT, "rear", "no frame comes")]
    reports = [component.report() for component in health]
    assert advice(status[0], status, reports).remedy == "see the camera below"
    (step,) = component_steps(reports, status)
    assert step == f"camera rear {state}: as it says" + (f": {trouble.value}" if trouble else "")
    assert advice(status[0], status).remedy == "check the camera's cable and supply"
