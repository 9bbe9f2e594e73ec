"""Causes that end a window or do not: changes of exposure, frame LEDs, gaps and silent cameras."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.measurements import beam_of

from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.measuring.calibration import Calibration
from altd.measuring.chain import MeasuringChain
from altd.measuring.spot_locator import Appearance
from altd.records import Frame
from altd.vision.flat import Flat

from .chains import VIEWS, chain, last, shots


@pytest.mark.parametrize("camera", ["left", "right"])
@pytest.mark.parametrize("marked", [1, 2, 4])
def test_no_mean_holds_exposures_from_before_and_after_a_change(
    calibration: Calibration, camera: str, marked: int
) -> None:
    """The place of the spot tells the exposure of a frame: x 10 mm before the change, 10.3 mm after it."""
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


def test_breaks_told_of_by_frames_that_got_lost_keep_the_window_apart(calibration: Calibration) -> None:
    """Dropped frames never reach the chain: the change itself, and the frames about it."""
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 6 + [(10.3, 5.0)] * 10)
    frames = [replace(f, changing=f.camera == "left" and f.sequence == 6) for f in frames]
    pairs = [pair for f in frames for pair in measured.pairer.add(f.camera, f.sequence, f.t_ns, f)]
    located = [pair.converted(measured.located) for pair in pairs]
    after = [measured.add(pair) for pair in located if not 5 <= pair.sequence <= 7]
    means = {m.sequence: beam_of(m).x_mm for m in after if m is not None and beam_of(m) is not None}
    assert all(min(abs(x_mm - 10.0), abs(x_mm - 10.3)) < 0.05 for x_mm in means.values()), means
    assert set(means) == {1, 2, 3, 4, *range(9, 16)}


def lit(frames: Sequence[Frame], *of: tuple[str, int]) -> list[Frame]:
    """The frames, some of them under LEDs, by camera and number."""
    return [replace(f, leds_on=(f.camera, f.sequence) in of) for f in frames]


def test_exposures_under_leds_end_no_window_and_make_no_camera_silent(calibration: Calibration) -> None:
    """One camera alone sees the edges; two of six exposures are lost, and half a window of 4 is left."""
    under_leds = [("right", 4), ("left", 5), ("right", 5), ("left", 6)]
    measured = chain(calibration)
    by_number = {
        frame.sequence: measurement
        for frame in lit(shots([(10.0, 5.0)] * 12), *under_leds)
        for measurement in measured.push(frame)
    }
    assert [number for number, m in by_number.items() if m.valid] == [1, 2, 3, 8, 9, 10, 11]
    assert [str(f) for f in by_number[7].status] == ["warming_up"]
    assert all(measurement.status == () for measurement in by_number.values() if measurement.valid)
    assert [by_number[number].frames for number in (8, 9, 10, 11)] == [2, 3, 4, 4]
    assert measured.frame_sets == 12


def test_a_second_under_leds_is_no_silence(calibration: Calibration) -> None:
    """Nothing is forgotten that one frame more would need; the next window still holds none of before."""
    places = [(10.0, 5.0)] * 4 + [(12.0, 5.0)] * 24
    under_leds = [(camera, number) for camera in ("left", "right") for number in range(4, 24)]
    measured = chain(calibration)
    after = [m for f in lit(shots(places), *under_leds) for m in measured.push(f) if f.sequence > 3]
    assert [m.valid for m in after] == [False, True, True, True]
    assert beam_of(after[1]).x_mm == pytest.approx(12.0, abs=0.05)
    assert [found.startswith("spot at") for found in measured.seen().values()] == [True, True]


def test_no_mean_spans_a_pause_that_ends_under_leds(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = lit(shots([(10.0, 5.0)] * 4 + [(10.3, 5.0)] * 6), ("left", 4), ("right", 4))
    frames = [replace(f, t_ns=f.t_ns + (f.sequence >= 4) * 1_000_000_000) for f in frames]
    after = [(frame.sequence, m) for frame in frames for m in measured.push(frame)]
    means = {sequence: beam_of(m).x_mm for sequence, m in after if beam_of(m) is not None}
    assert all(min(abs(x_mm - 10.0), abs(x_mm - 10.3)) < 0.05 for x_mm in means.values()), means
    assert set(means) == {1, 2, 3, 6, 7, 8, 9}


def test_a_change_of_exposure_under_leds_ends_the_window_all_the_same(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = lit(shots([(10.0, 5.0)] * 6), ("left", 4), ("right", 4))
    frames = [replace(f, changing=f.sequence == 4 and f.camera == "left") for f in frames]
    assert not last(measured, frames).valid
    assert last(chain(calibration), lit(frames[:8] + frames[10:])).valid


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
    assert beam_of(measurements[1]).x_mm == pytest.approx(20.0, abs=0.05)


@pytest.mark.parametrize("silent", ["left", "right"])
@pytest.mark.parametrize("pair_by", ["sequence", "time"])
def test_a_silent_camera_is_told_within_0_4_s(calibration: Calibration, silent: str, pair_by: str) -> None:
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


def test_no_window_holds_spots_that_were_located_through_two_flats(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)] * 8)
    assert last(measured, frames[:8]).valid
    even = Flat.from_response(np.ones((480, 752)), "print")
    measured.locators["left"].appearance = Appearance(even, None)
    after = [m for frame in frames[8:] for m in measured.push(frame)]
    assert [m.frames for m in after] == [0, 2, 3, 4]
    assert [str(fault) for fault in after[0].status] == ["warming_up"]
