from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from support.measurements import beam_of, points_of
from support.played_unit import PlayedUnit
from support.recordings import picture

from altd.calibration.file import load_calibration
from altd.config import Installation, Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.chain import MeasuringChain, View
from altd.reasons import Reason
from altd.records import CameraIdentity, Fault, Frame, Measurement, NoSpot, Spot

VIEWS = (View("front", "left"), View("rear", "right"))  # a camera need not be named after its target


@pytest.fixture(scope="module")
def calibration(played_unit: PlayedUnit) -> Calibration:
    return load_calibration(played_unit.calibration)


def chain(calibration: Calibration, *origins: Reason, **installation: float) -> MeasuringChain:
    measuring = Measuring(window=4)
    return MeasuringChain(
        VIEWS,
        calibration,
        measuring,
        BeamInstrument(calibration, measuring, Installation.model_validate(installation)),
        lambda: map(Fault, origins),
    )


def shots(places_mm: Sequence[tuple[float, float]], leds_on: bool = False, seed: int = 1) -> list[Frame]:
    rng = np.random.default_rng(seed)
    return [
        Frame(camera, number, number * 50_000_000, picture(target, x, y, rng), 8, leds_on)
        for number, (x, y) in enumerate(places_mm)
        for target, camera in (("front", "left"), ("rear", "right"))
    ]


def last(measured: MeasuringChain, frames: Sequence[Frame]) -> Measurement:
    return [measurement for frame in frames for measurement in measured.push(frame)][-1]


def test_signs_and_offsets_are_applied_to_the_published_beam_only(calibration: Calibration) -> None:
    frames = shots([(10.0, 5.0)] * 4)
    plain = last(chain(calibration), frames)
    turned = last(
        chain(calibration, sign_x=-1, offset_x_mm=100.0, sign_pitch=-1, offset_pitch_deg=1.0), frames
    )
    assert beam_of(plain) is not None
    assert beam_of(turned) is not None
    assert beam_of(turned).x_mm == pytest.approx(100.0 - beam_of(plain).x_mm)
    assert beam_of(turned).pitch_deg == pytest.approx(1.0 - beam_of(plain).pitch_deg)
    assert (beam_of(turned).y_mm, beam_of(turned).yaw_deg) == (beam_of(plain).y_mm, beam_of(plain).yaw_deg)
    assert (beam_of(turned).sigma_x_mm, points_of(turned)) == (beam_of(plain).sigma_x_mm, points_of(plain))


def test_a_far_reference_plane_moves_the_displacement_and_widens_its_sigma(calibration: Calibration) -> None:
    frames = shots([(10.0, 5.0)] * 4)
    near = last(chain(calibration), frames)
    far = last(chain(calibration, reference_plane_mm=-1000.0), frames)
    assert beam_of(near) is not None
    assert beam_of(far) is not None
    assert beam_of(far).x_mm == pytest.approx(beam_of(near).x_mm - beam_of(near).yaw_mm_per_m, abs=1e-6)
    assert beam_of(far).sigma_x_mm > 3 * beam_of(near).sigma_x_mm


def test_frames_that_are_not_live_are_said_to_be_so_valid_or_not(calibration: Calibration) -> None:
    measured = chain(calibration, Reason.PLAYBACK)
    frames = shots([(10.0, 5.0)] * 4)
    statuses = [[str(f) for f in m.status] for frame in frames for m in measured.push(frame)]
    assert statuses == [["warming_up", "playback"], ["playback"], ["playback"], ["playback"]]
    assert [str(fault) for fault in measured.silence(0).status][-1] == "playback"


def test_what_the_cameras_see_is_told_in_words(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)])
    dark = Frame("right", 0, 0, np.full((480, 752), 8, np.uint8))
    measured.push(frames[0])
    measured.push(dark)
    front, rear = measured.seen().split("; ")
    assert front.startswith("front: spot at u 33")
    assert rear == "rear: spot_missing, nothing stands out of the background"


@pytest.mark.parametrize("camera", ["left", "right"])
@pytest.mark.parametrize("marked", [1, 2, 4])
def test_no_mean_holds_exposures_from_before_and_after_a_change(
    calibration: Calibration, camera: str, marked: int
) -> None:
    """Where the spot lies tells which exposure a frame had: x 10 mm before the change, 10.3 mm after it."""
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 6 + [(10.3, 5.0)] * 10)
    frames = [replace(f, changing=f.camera == camera and 6 <= f.sequence < 6 + marked) for f in frames]
    after = [(frame.sequence, m) for frame in frames for m in measured.push(frame)]
    means = {sequence: beam_of(m).x_mm for sequence, m in after if beam_of(m) is not None}
    assert all(min(abs(x_mm - 10.0), abs(x_mm - 10.3)) < 0.05 for x_mm in means.values()), means
    assert set(means) == {1, 2, 3, 4, 5, *range(6 + marked + 1, 16)}  # two of four exposures make a mean
    invalid = {str(fault) for _, m in after[1:] if beam_of(m) is None for fault in m.status}
    assert invalid == {"front_exposure_changing" if camera == "left" else "rear_exposure_changing"}


def test_a_change_counts_although_its_marked_exposure_was_never_paired(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 4 + [(10.3, 5.0)] * 6)
    frames = [
        replace(f, changing=f.sequence == 4, t_ns=f.t_ns + (f.sequence == 4) * 20_000_000)
        if f.camera == "left"
        else f
        for f in frames
    ]
    after = [(frame.sequence, m) for frame in frames for m in measured.push(frame)]
    means = [beam_of(m).x_mm for sequence, m in after if beam_of(m) is not None and sequence > 4]
    assert means
    assert all(abs(x_mm - 10.3) < 0.05 for x_mm in means), means


def test_what_is_found_is_told_of_each_new_frame_also_of_another_camera(calibration: Calibration) -> None:
    """Who sets the exposure wants to know of a spot whether it may be measured or not."""
    measured = MeasuringChain(
        VIEWS,
        calibration,
        Measuring(window=4),
        BeamInstrument(calibration, Measuring()),
        identity=lambda camera: CameraIdentity(serial=camera),
        expected={"right": CameraIdentity(serial="another")},
    )
    *frames, third, _ = shots([(10.0, 5.0)] * 3)
    again = replace(frames[0], sequence=4)
    located = [measured.locators[f.camera].locate(f) for f in (*frames, replace(third, changing=True), again)]
    assert [(one.camera, one.sequence, type(one.found), type(one.spot)) for one in located] == [
        ("left", 0, Spot, Spot),
        ("right", 0, Spot, NoSpot),
        ("left", 1, Spot, Spot),
        ("right", 1, Spot, NoSpot),
        ("left", 2, NoSpot, NoSpot),
        ("left", 4, type(None), NoSpot),
    ]
    assert [str(one.spot.reason) for one in located if isinstance(one.spot, NoSpot)] == [
        "wrong_camera",
        "wrong_camera",
        "exposure_changing",
        "frame_repeated",
    ]


def test_what_threads_of_their_own_have_located_is_measured_alike(calibration: Calibration) -> None:
    frames = shots([(10.0, 5.0)] * 6 + [(10.3, 5.0)] * 6)
    alone = chain(calibration)
    pushed = [m for frame in frames for m in alone.push(frame)]
    apart = chain(calibration)
    with ThreadPoolExecutor(2) as threads:
        of_camera = {
            camera: threads.submit(
                lambda camera=camera: [apart.locators[camera].locate(f) for f in frames if f.camera == camera]  # type: ignore[misc]
            )
            for camera in ("left", "right")
        }
    located = [one for pair in zip(*(of.result() for of in of_camera.values()), strict=True) for one in pair]
    added = [m for one in located for m in apart.add(one)]
    assert added == pushed
    assert len(added) == 12
    assert (apart.seen(), apart.views(), apart.step()) == (alone.seen(), alone.views(), alone.step())


def test_breaks_that_were_told_of_by_frames_which_got_lost_keep_the_window_apart(
    calibration: Calibration,
) -> None:
    """What the slot drops, the chain never sees: the change itself, and the frames about it."""
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 6 + [(10.3, 5.0)] * 10)
    frames = [replace(f, changing=f.camera == "left" and f.sequence == 6) for f in frames]
    located = [measured.locators[f.camera].locate(f) for f in frames]
    after = [(one.sequence, m) for one in located if not 5 <= one.sequence <= 7 for m in measured.add(one)]
    means = {sequence: beam_of(m).x_mm for sequence, m in after if beam_of(m) is not None}
    assert all(min(abs(x_mm - 10.0), abs(x_mm - 10.3)) < 0.05 for x_mm in means.values()), means
    assert set(means) == {1, 2, 3, 4, *range(9, 16)}


def test_exposures_with_the_leds_on_are_not_measured(calibration: Calibration) -> None:
    measured = chain(calibration)
    assert [m for frame in shots([(10.0, 5.0)] * 4, leds_on=True) for m in measured.push(frame)] == []


def test_a_beam_that_wanders_more_than_is_asked_for_is_unsteady(calibration: Calibration) -> None:
    wandering = last(chain(calibration), shots([(0.0, 0.0), (3.0, 0.0), (-1.5, 0.0), (1.5, 0.0)]))
    assert [str(fault) for fault in wandering.status] == ["unsteady"]
    assert wandering.status[0].detail.startswith("displacement is uncertain by ")
    assert (
        wandering.light_ns > wandering.t_ns
    )  # what is invalid is as old as its last light, and not stale sooner
    drifting = last(chain(calibration), shots([(0.0, 0.0), (0.05, 0.0), (0.1, 0.0), (0.15, 0.0)]))
    assert beam_of(drifting) is not None
    assert beam_of(drifting).x_mm == pytest.approx(0.075, abs=0.03)


@pytest.mark.parametrize("which", ["map", "cross_check"])
@pytest.mark.parametrize("target", ["front", "rear"])
def test_maps_that_contradict_each_other_are_implausible(
    calibration: Calibration, target: str, which: str
) -> None:
    """0.3 mm are 1.2 px here; one map is off by that, as after a mistake in its coefficients."""

    def shifted(forward: TensorMap) -> TensorMap:
        spectra = forward.spectra.copy()
        spectra[0, 0, 0] += 1.2 * math.sqrt(forward.x_axis.nodes * forward.y_axis.nodes)
        return replace(forward, spectra=spectra)

    def spoilt(known: TargetCalibration) -> TargetCalibration:
        if which == "map":
            return replace(known, map=shifted(known.map))
        return replace(known, cross_check=replace(known.cross_check, map=shifted(known.cross_check.map)))

    wrong = replace(
        calibration,
        targets=tuple(spoilt(known) if known.name == target else known for known in calibration.targets),
    )
    frames = shots([(10.0, 5.0)] * 4)
    assert last(chain(calibration), frames).valid
    measurement = last(chain(wrong), frames)
    assert [str(fault) for fault in measurement.status] == [f"{target}_implausible"]
    assert (beam_of(measurement), set(points_of(measurement).values())) == (None, {None})
    assert " px apart at x " in measurement.status[0].detail


def test_what_was_seen_before_a_gap_does_not_count(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 4)
    last(measured, frames)
    later = [
        Frame(f.camera, f.sequence + 100, f.t_ns + 5_000_000_000, f.pixels)
        for f in shots([(20.0, 5.0)] * 4, seed=2)
    ]
    measurements = [m for frame in later for m in measured.push(frame)]
    assert [str(f) for f in measurements[0].status] == ["warming_up"]
    assert beam_of(measurements[1]) is not None
    assert beam_of(measurements[1]).x_mm == pytest.approx(20.0, abs=0.05)


@pytest.mark.parametrize("silent", ["left", "right"])
@pytest.mark.parametrize("pair_by", ["sequence", "time"])
def test_one_silent_camera_makes_it_invalid_within_0_4_s(
    calibration: Calibration, silent: str, pair_by: str
) -> None:
    measuring = Measuring.model_validate({"window": 20, "pair_by": pair_by})
    measured = MeasuringChain(VIEWS, calibration, measuring, BeamInstrument(calibration, measuring))
    frames = shots([(10.0, 5.0)] * 40)
    heard_ns = 0
    validity: list[tuple[float, bool]] = []
    for taken in frames:
        if taken.camera == silent and taken.sequence >= 20:
            continue
        if taken.camera == silent:
            heard_ns = taken.t_ns
        validity += [((taken.t_ns - heard_ns) * 1e-9, m.valid) for m in measured.push(taken)]
    last_valid_s = max(since_s for since_s, valid in validity if valid)
    first_invalid_s = min(since_s for since_s, valid in validity if not valid and since_s > last_valid_s)
    assert first_invalid_s <= 0.4
    assert last_valid_s < first_invalid_s


def test_silence_is_invalid_names_every_target_and_forgets_the_window(calibration: Calibration) -> None:
    measured = chain(calibration)
    last(measured, shots([(10.0, 5.0)] * 4))
    silent = measured.silence(9_000_000_000)
    assert [str(f) for f in silent.status] == ["front_camera_silent", "rear_camera_silent"]
    assert (silent.sequence, silent.t_ns, beam_of(silent)) == (3, 9_000_000_000, None)


def test_what_is_known_of_the_step_and_of_a_silent_camera_is_of_now(calibration: Calibration) -> None:
    """The right camera goes silent, then both."""
    measured = MeasuringChain(
        VIEWS, calibration, Measuring(window=4, pair_by="time"), BeamInstrument(calibration, Measuring())
    )
    frames = [replace(f, t_ns=f.t_ns + (f.camera == "right") * 3_000_000) for f in shots([(10.0, 5.0)] * 30)]
    for frame in frames[:12]:
        measured.push(frame)
    assert measured.step() == {"skew_ms": 0.0, "lag_right_ms": 3.0}
    for frame in frames[12:]:
        if frame.camera == "left":
            measured.push(frame)
    assert measured.step() == {"skew_ms": None, "lag_right_ms": None}
    front, rear = measured.seen().split("; ")
    assert front.startswith("front: spot at u 33")
    assert rear == "rear: camera_silent, no frame comes"
    measured.silence(frames[-1].t_ns + 400_000_000)
    assert measured.step() == {"skew_ms": None, "lag_right_ms": None}


def test_one_frame_of_two_has_no_skew(calibration: Calibration) -> None:
    measured = chain(calibration)
    for frame in [f for f in shots([(10.0, 5.0)] * 8) if f.camera == "left" or f.sequence < 2]:
        measured.push(frame)
    assert measured.step() == {"skew_ms": None}
