"""The chain from frames to a measurement: what is measured, mapped, corrected, refused and told."""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from support.located import paired
from support.measurements import beam_of, points_of
from support.played_unit import PlayedUnit
from support.recordings import PX_PER_MM, picture, place_px

from altd.calibration.file import load_calibration
from altd.config import Measuring
from altd.instruments.beam.instrument import BeamInstrument
from altd.mapping.tensor_map import TensorMap
from altd.measuring.calibration import Calibration, TargetCalibration
from altd.measuring.chain import MeasuringChain
from altd.measuring.frame_chain import Provenance
from altd.reasons import Reason
from altd.records import CameraIdentity, Frame, NoSpot, Spot
from altd.status.measurement_json import as_object_now

from .chains import VIEWS, chain, last, shots


def test_signs_and_offsets_are_applied_to_the_published_beam_only(calibration: Calibration) -> None:
    frames = shots([(10.0, 5.0)] * 4)
    plain = last(chain(calibration), frames)
    signs = {"sign_x": -1, "offset_x_mm": 100.0, "sign_pitch": -1, "offset_pitch_deg": 1.0}
    turned = last(chain(calibration, **signs), frames)
    assert beam_of(turned).x_mm == pytest.approx(100.0 - beam_of(plain).x_mm)
    assert beam_of(turned).pitch_deg == pytest.approx(1.0 - beam_of(plain).pitch_deg)
    assert (beam_of(turned).y_mm, beam_of(turned).yaw_deg) == (beam_of(plain).y_mm, beam_of(plain).yaw_deg)
    assert (beam_of(turned).sigma_x_mm, points_of(turned)) == (beam_of(plain).sigma_x_mm, points_of(plain))


def test_a_far_reference_plane_moves_the_displacement_and_widens_its_sigma(calibration: Calibration) -> None:
    frames = shots([(10.0, 5.0)] * 4)
    near = last(chain(calibration), frames)
    far = last(chain(calibration, reference_plane_mm=-1000.0), frames)
    assert beam_of(far).x_mm == pytest.approx(beam_of(near).x_mm - beam_of(near).yaw_mm_per_m, abs=1e-6)
    assert beam_of(far).sigma_x_mm > 3 * beam_of(near).sigma_x_mm


def test_frames_that_are_not_live_are_said_to_be_so_valid_or_not(calibration: Calibration) -> None:
    measured = chain(calibration, Reason.PLAYBACK)
    frames = shots([(10.0, 5.0)] * 4)
    statuses = [[str(f) for f in m.status] for frame in frames for m in measured.push(frame)]
    assert statuses == [["warming_up", "playback"], ["playback"], ["playback"], ["playback"]]
    assert [str(fault) for fault in measured.silence(0).status][-1] == "playback"


def test_a_moving_spot_is_dated_by_its_row(calibration: Calibration) -> None:
    """A pitched beam moves by 10 mm/s along x; its spots are 228 rows apart, 14 ms: 0.14 mm."""
    rng, speed_mm_per_s, row_us = np.random.default_rng(1), 10.0, 60.0

    def exposed(number: int, target: str, camera: str, y_mm: float) -> Frame:
        rows = place_px(target, 0.0, y_mm)[1] - 239.5
        x_mm = speed_mm_per_s * (0.05 * number + rows * row_us * 1e-6)
        pixels = picture(target, x_mm, y_mm, rng)
        return Frame(camera, number, number * 50_000_000, pixels, row_time_us=row_us)

    places = (("front", "left", 30.0), ("rear", "right", -30.0))
    found = last(chain(calibration), [exposed(n, *place) for n in range(4) for place in places])
    assert found.targets["front"] is not None
    assert found.targets["rear"] is not None
    for x_mm in (found.targets["front"]["x_mm"].value, found.targets["rear"]["x_mm"].value):
        assert x_mm == pytest.approx(speed_mm_per_s * found.t_ns * 1e-9, abs=0.01)


def test_what_the_cameras_see_is_told_in_words(calibration: Calibration) -> None:
    measured = chain(calibration)
    frames = shots([(10.0, 5.0)])
    dark = Frame("right", 0, 0, np.full((480, 752), 8, np.uint8))
    measured.push(frames[0])
    measured.push(dark)
    front, rear = (f"{target}: {found}" for target, found in measured.seen().items())
    assert front.startswith("front: spot at u 33")
    assert rear == "rear: spot_missing, nothing is brighter than the background"
    figures = measured.spots()
    diameter_px = float(front.split("diameter ")[1].split()[0])
    assert figures.pop("diameter_front_px") == pytest.approx(diameter_px, abs=0.6)
    assert figures.pop("peak_front") == pytest.approx(float(front.split("peak ")[1].split()[0]), abs=0.6)
    assert figures == {}
    measured.silence(0)
    assert measured.spots() == {}


def test_what_is_found_is_told_of_each_new_frame_also_of_another_camera(calibration: Calibration) -> None:
    """The exposure control needs to know of a spot whether it may be measured or not."""
    measured = MeasuringChain(
        (VIEWS[0], replace(VIEWS[1], expected=CameraIdentity(serial="another"))),
        calibration,
        Measuring(window=4),
        BeamInstrument(calibration, Measuring()),
        Provenance(identity=lambda camera: CameraIdentity(serial=camera)),
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
    pairs = zip(*(of.result() for of in of_camera.values()), strict=True)
    added = [apart.add(paired(*pair)) for pair in pairs]
    assert added == pushed
    assert len(added) == 12
    assert (apart.seen(), apart.views(), apart.step()) == (alone.seen(), alone.views(), alone.step())


def test_mean_spots_are_corrected_before_they_are_mapped(calibration: Calibration) -> None:
    measuring = Measuring(window=4)
    plain, corrected = (
        MeasuringChain(VIEWS, calibration, measuring, BeamInstrument(calibration, measuring), correct=correct)
        for correct in (None, lambda mean: replace(mean, px=mean.px + np.array([[0.5, 0.0], [0.5, 0.0]])))
    )
    frames = shots([(10.0, 5.0)] * 4)
    targets = [last(measured, frames).targets["rear"] for measured in (plain, corrected)]
    moved_mm = targets[1]["x_mm"].value - targets[0]["x_mm"].value  # type: ignore[index]
    assert abs(moved_mm) == pytest.approx(0.5 / PX_PER_MM, rel=0.05)


def test_a_beam_that_wanders_more_than_is_asked_for_is_unsteady(calibration: Calibration) -> None:
    wandering = last(chain(calibration), shots([(0.0, 0.0), (3.0, 0.0), (-1.5, 0.0), (1.5, 0.0)]))
    assert [str(fault) for fault in wandering.status] == ["unsteady"]
    assert wandering.status[0].detail.startswith("displacement is uncertain by ")
    assert (
        wandering.light_ns > wandering.t_ns
    )  # an invalid measurement has the age of its last light, and is not stale sooner
    drifting = last(chain(calibration), shots([(0.0, 0.0), (0.05, 0.0), (0.1, 0.0), (0.15, 0.0)]))
    assert beam_of(drifting).x_mm == pytest.approx(0.075, abs=0.03)


def test_pictures_torn_alike_in_a_moving_machine_are_late_within_sigma(calibration: Calibration) -> None:
    """Each picture has the beam of the exposure before in its upper half: 7.3 sigma without a common lag."""
    places = [(0.115 * number, 5.0) for number in range(21)]
    frames = shots(places)
    torn = []
    for before, frame in zip(frames, frames[2:], strict=False):
        spot = MeasuringChain.located(chain(calibration), frame).spot
        pixels = frame.pixels.copy()
        pixels[: round(spot.v_px)] = before.pixels[: round(spot.v_px)]
        torn.append(replace(frame, pixels=pixels))
    measuring = Measuring(window=20)
    measured = MeasuringChain(VIEWS, calibration, measuring, BeamInstrument(calibration, measuring))
    beam = beam_of(last(measured, torn))
    late_mm = np.mean(places[1:], axis=0)[0] - beam.x_mm
    assert late_mm == pytest.approx(0.115 / 2, abs=0.02)
    assert late_mm < 5 * beam.sigma_x_mm
    assert beam.sigma_yaw_deg < math.degrees(0.115 / math.sqrt(12) / 280), "both spots are late alike"


@pytest.mark.parametrize(
    ("front_mm", "rear_mm", "status"), [(0.10, 0.09, []), (0.10, 0.11, ["rear_wrong_camera"])]
)
def test_pictures_aside_on_both_targets_are_limited_by_their_sum(
    calibration: Calibration, front_mm: float, rear_mm: float, status: list[str]
) -> None:
    """Pictures that crept by 0.3 px a second, each within its own limit, made 0.0303°."""
    measured = chain(calibration)
    aside_mm = {"left": front_mm, "right": rear_mm}
    found = [measured.located(frame) for frame in shots([(10.0, 5.0)] * 4)]
    aside = [replace(one, view=replace(one.view, certain_shift_mm=aside_mm[one.camera])) for one in found]
    *_, measurement = [measured.add(paired(*aside[place : place + 2])) for place in range(0, 8, 2)]
    assert [str(fault) for fault in measurement.status] == status
    if status:
        assert measurement.status[0].detail == (
            "the pictures of front and rear lie 0.21 mm aside in sum, the limit is 0.2 mm"
        )


@pytest.mark.parametrize("which", ["map", "cross_check"])
@pytest.mark.parametrize("target", ["front", "rear"])
def test_maps_that_contradict_are_implausible(calibration: Calibration, target: str, which: str) -> None:
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


def in_picture(
    axes_mm: list[np.ndarray], spectrum: list[list[float]], place_mm: tuple[float, float]
) -> float:
    """Σ s_ij p_i(y) p_j(x); the p are orthonormal on the nodes: Gram and Schmidt's of the powers."""
    along = []
    for nodes_mm, mm, count in zip(axes_mm, place_mm, (len(spectrum[0]), len(spectrum)), strict=True):
        scale = np.abs(nodes_mm).max()
        powers, own = (np.vander(of / scale, count, increasing=True) for of in (nodes_mm, np.array([mm])))
        triangle = np.linalg.qr(powers, mode="r")
        along.append((own @ np.linalg.inv(triangle * np.sign(np.diag(triangle))[:, None]))[0])
    return float(along[1] @ np.array(spectrum) @ along[0])


def test_the_cross_check_has_the_spots_and_the_beam_by_the_second_maps(played_unit: PlayedUnit) -> None:
    """The second map of the rear target puts each place 0.04 px to the right: 0.01 mm."""
    calibration = load_calibration(played_unit.calibration)
    of_file = {
        of["name"]: of["cross_check"]["map"]
        for of in json.loads(played_unit.calibration.read_text())["targets"]
    }
    axes = {
        name: [
            of[axis]["first_mm"] + of[axis]["step_mm"] * np.arange(of[axis]["nodes"])
            for axis in ("x_axis", "y_axis")
        ]
        for name, of in of_file.items()
    }
    aside_px = 0.04 * math.sqrt(math.prod(map(len, axes["rear"])))
    of_file["rear"]["spectrum_u_px"][0][0] += aside_px
    front, rear = calibration.targets
    spectra = rear.cross_check.map.spectra.copy()
    spectra[0, 0, 0] += aside_px
    check = replace(rear.cross_check, map=replace(rear.cross_check.map, spectra=spectra))
    measured = chain(
        replace(calibration, targets=(front, replace(rear, cross_check=check))),
        sign_yaw=-1,
        offset_pitch_deg=2.0,
    )
    measurement = last(measured, shots([(10.0, 5.0)] * 4))
    assert measurement.valid
    beam, places = measurement.cross_check, points_of(measurement)
    assert beam is not None
    for name, spot in beam.spots.items():
        assert (spot.u_px, spot.v_px) == pytest.approx(place_px(name, 10.0, 5.0), abs=0.03)
        for own_px, spectrum in ((spot.u_px, "spectrum_u_px"), (spot.v_px, "spectrum_v_px")):
            found_px = in_picture(axes[name], of_file[name][spectrum], (spot.x_mm, spot.y_mm))
            assert found_px == pytest.approx(own_px, abs=0.001)
    at_front, at_rear = beam.spots["front"], beam.spots["rear"]
    assert at_rear.x_mm - places["rear"][0] == pytest.approx(-0.01, abs=0.003)
    sx, sy = (at_rear.x_mm - at_front.x_mm) / 280.0, (at_rear.y_mm - at_front.y_mm) / 280.0
    assert beam.yaw_deg == pytest.approx(-math.degrees(math.atan(sx)), abs=1e-7)
    assert beam.pitch_deg == pytest.approx(2.0 + math.degrees(math.atan(sy)), abs=1e-7)
    shown = as_object_now(measurement, 0.5)["cross_check"]
    assert shown["targets"]["rear"]["x_mm"] == round(at_rear.x_mm, 4)
    nothing = as_object_now(measurement.without_numbers(()), 0.5)["cross_check"]
    assert (nothing.keys(), nothing["targets"].keys()) == (shown.keys(), shown["targets"].keys())
    assert nothing["yaw_deg"] is nothing["pitch_deg"] is None
    assert {value for of in nothing["targets"].values() for value in of.values()} == {None}


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
    front, rear = (f"{target}: {found}" for target, found in measured.seen().items())
    assert front.startswith("front: spot at u 33")
    assert rear == "rear: camera_silent, no frame comes"
    measured.silence(frames[-1].t_ns + 400_000_000)
    assert measured.step() == {"skew_ms": None, "lag_right_ms": None}


def test_one_frame_of_two_has_no_skew(calibration: Calibration) -> None:
    measured = chain(calibration)
    for frame in [f for f in shots([(10.0, 5.0)] * 8) if f.camera == "left" or f.sequence < 2]:
        measured.push(frame)
    assert measured.step() == {"skew_ms": None}
