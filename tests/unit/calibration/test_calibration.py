"""A calibration and its file: maps, flats, glass, identities and views; what is refused."""

import base64
import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np
import pytest
from support.played_unit import PlayedUnit
from support.recordings import place_px, write_beams

from altd.calibration.calibrating import calibrate
from altd.calibration.file import check_image_size, check_place, file_of, load_calibration, save_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.records import CameraIdentity, Glass, Limits
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat, Learnt
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.settings import UNKNOWN_SPOT
from altd.vision.texture import Texture

HOT = HotPixels(places_of([(3, 4), (700, 20)]), places_of([(5, 6)]))


@pytest.fixture(scope="module")
def calibration(played_unit: PlayedUnit) -> Calibration:
    assert played_unit.result.refused == ()
    made = played_unit.result.calibration
    front, rear = made.targets
    return replace(made, targets=(replace(front, camera=CameraIdentity("F-7", "mini", "aravis")), rear))


@pytest.fixture
def file(calibration: Calibration, tmp_path: Path) -> Path:
    save_calibration(calibration, tmp_path / "cal.json")
    return tmp_path / "cal.json"


def tampered(file: Path, resealed: bool = True, **changes: object) -> Path:
    document = json.loads(file.read_text()) | changes
    if resealed:
        document.pop("checksum")
        document["checksum"] = checksum_of(document)
    file.write_text(json.dumps(document))
    return file


def complaint(file: Path, serial: str | None = None) -> str:
    with pytest.raises(BadInputError) as caught:
        load_calibration(file, serial)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_maps_find_places_between_the_nodes(calibration: Calibration) -> None:
    rng = np.random.default_rng(1)
    for name in ("front", "rear"):
        target = calibration.target(name)
        assert target is not None
        for x, y in rng.uniform((-60, -48), (60, 48), (20, 2)):
            point = target.point(*place_px(name, x, y))
            assert (point.x_mm, point.y_mm) == pytest.approx((x, y), abs=0.02)


def test_farther_outside_the_scan_than_half_a_pitch_there_is_no_point(calibration: Calibration) -> None:
    target = calibration.target("rear")
    assert target.point(*place_px("rear", 76.0, 0.0)) is None
    assert target.point(*place_px("rear", 0.0, -63.5)) is None


def test_a_loaded_calibration_knows_its_file_a_made_one_none(calibration: Calibration, file: Path) -> None:
    read = load_calibration(file).file
    assert read == file_of(calibration)
    assert read.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert read.checksum == json.loads(file.read_text())["checksum"]
    assert calibration.file is None


def test_a_file_keeps_the_glass_and_a_recording_with_another_one_is_refused(
    calibration: Calibration, tmp_path: Path
) -> None:
    """A recording or a config that does not state the glass has that of the calibration."""
    front, rear = calibration.targets
    with_window = replace(calibration, targets=(replace(front, glass=Glass(4.0, 1.49)), rear))
    save_calibration(with_window, tmp_path / "glass.json")
    read = load_calibration(tmp_path / "glass.json")
    assert [target.glass for target in read.targets] == [Glass(4.0, 1.49), None]
    for glass in (None, Glass(4.0, 1.49)):
        check_place(read, tmp_path, "front", 0.0, glass)
    with pytest.raises(BadInputError) as caught:
        check_place(read, tmp_path, "front", 0.0, Glass(4.0))
    assert caught.value.message == (
        "target 'front' was calibrated with 4 mm of glass (index 1.49) behind it, "
        "not with 4 mm of glass (index 1.52)"
    )


def test_a_file_gives_back_what_was_saved(calibration: Calibration, file: Path) -> None:
    loaded = load_calibration(file, "TEST-1")
    assert loaded.target_names == ("front", "rear")
    for saved, read in zip(calibration.targets, loaded.targets, strict=True):
        assert read.localiser == saved.localiser
        place = np.array([[3.0, 4.0]])
        assert read.map.to_px(place) == pytest.approx(saved.map.to_px(place))
        assert (read.residual_max_mm, read.z_mm) == (saved.residual_max_mm, saved.z_mm)


def test_a_file_keeps_the_temperature_and_has_no_key_of_it_without(
    calibration: Calibration, file: Path, tmp_path: Path
) -> None:
    document = json.loads(file.read_text())
    assert "temperature_c" not in document
    assert "temperature_k" not in document["limits"]
    limits = Limits(temperature_k=8.0)
    save_calibration(replace(calibration, temperature_c=21.5, limits=limits), tmp_path / "warm.json")
    read = load_calibration(tmp_path / "warm.json")
    assert (read.temperature_c, read.limits) == (21.5, limits)


KEYS = (
    "name z_mm camera_serial camera_model camera_driver origin width height localiser flat map cross_check "
    "left_out_px residuals repeatability_px leds_px spot fingerprint"
)
OF_MAP = (
    "basis model x_axis y_axis degree spectrum_u_px spectrum_v_px spread_u_px spread_v_px noise_px "
    "noise_shape hull_mm margin_mm beyond_px_per_mm"
)


def test_a_file_has_these_keys_in_this_order_and_is_the_same_when_saved_again(
    calibration: Calibration, tmp_path: Path
) -> None:
    front, rear = calibration.targets
    surface = Texture(np.zeros((480, 752), np.float32))
    front = replace(
        front, glass=Glass(4.0), fingerprint=Fingerprint(HOT, surface, "scan", 0.3), spot=UNKNOWN_SPOT
    )
    rear = replace(rear, fingerprint=Fingerprint(HOT, None, None))
    save_calibration(replace(calibration, targets=(front, rear)), tmp_path / "first.json")
    written = json.loads((tmp_path / "first.json").read_text())
    assert " ".join(written) == "format unit created recording limits targets checksum"
    assert [" ".join(target) for target in written["targets"]] == [f"{KEYS} glass_mm glass_index", KEYS]
    of_front, of_rear = written["targets"]
    assert (of_front["spot"], of_front["glass_index"], of_rear["fingerprint"]["png"]) == (None, 1.52, None)
    assert " ".join(of_front["map"]) == " ".join(of_rear["cross_check"]["map"]) == OF_MAP
    assert " ".join(of_front["cross_check"]) == "map left_out_px bound_px largest_px"
    assert of_front["residuals"] == {
        "mean_mm": front.residual_mean_mm,
        "std_mm": front.residual_std_mm,
        "max_mm": front.residual_max_mm,
    }
    save_calibration(load_calibration(tmp_path / "first.json"), tmp_path / "second.json")
    assert (tmp_path / "second.json").read_bytes() == (tmp_path / "first.json").read_bytes()


def test_a_file_keeps_the_map_that_checks_and_its_bound(calibration: Calibration, file: Path) -> None:
    for saved, read in zip(calibration.targets, load_calibration(file).targets, strict=True):
        assert (read.map.model, read.cross_check.map.model) == (saved.map.model, saved.cross_check.map.model)
        assert "tensor" in (read.map.model, read.cross_check.map.model)
        assert read.map.model != read.cross_check.map.model
        for name in ("leave_one_out_px", "limit_px", "max_difference_px"):
            assert getattr(read.cross_check, name) == getattr(saved.cross_check, name)
        point = read.point(400.0, 200.0)
        apart_px = math.hypot(*read.cross_check.difference_px(point.x_mm, point.y_mm, 400.0, 200.0))
        assert apart_px < read.cross_check.limit_px


def test_a_file_without_the_map_that_checks_is_refused(file: Path) -> None:
    targets = json.loads(file.read_text())["targets"]
    targets[1]["cross_check"]["map"]["spectrum_v_px"][0].pop()
    assert "targets.rear.cross_check.map.spectrum: expected 2 ×" in complaint(tampered(file, targets=targets))
    targets[0]["cross_check"]["bound_px"] = 0
    said = complaint(tampered(file, targets=targets))
    assert "targets.0.cross_check.bound_px: Input should be greater than 0" in said
    del targets[0]["cross_check"]
    assert "targets.0.cross_check: Field required" in complaint(tampered(file, targets=targets))


def test_one_changed_digit_is_a_wrong_checksum(file: Path) -> None:
    text = file.read_text()
    file.write_text(text.replace('"smoothing_px": 4.0', '"smoothing_px": 5.0', 1))
    assert file.read_text() != text
    assert "checksum does not match" in complaint(file)


def test_another_version_another_unit_and_another_size_are_refused(file: Path) -> None:
    assert "is for unit 'TEST-1', this is unit 'OTHER'" in complaint(file, "OTHER")
    calibration = load_calibration(file)
    with pytest.raises(BadInputError, match=r"'front' was calibrated at 752 × 480, not 640 × 480"):
        check_image_size(calibration, file, "front", 640, 480)
    with pytest.raises(BadInputError, match="does not know target 'middle'"):
        check_image_size(calibration, file, "middle", 752, 480)
    assert "format is 'altd-calibration/9'" in complaint(tampered(file, format="altd-calibration/9"))


def test_damaged_files_are_refused_with_the_place(file: Path, tmp_path: Path) -> None:
    assert "No such file" in complaint(tmp_path / "none.json")
    good = json.loads(file.read_text())
    targets = good["targets"]
    targets[1]["map"]["spectrum_u_px"].pop()
    said = complaint(tampered(file, targets=targets))
    assert "targets.rear.map.spectrum: expected 2 × 4 × 4 numbers" in said
    del targets[0]["z_mm"]
    assert "targets.0.z_mm: Field required" in complaint(tampered(file, targets=targets))
    file.write_text("[]")
    assert "no JSON object" in complaint(file)
    file.write_text(json.dumps(good)[:500])
    assert "is not JSON" in complaint(file)


def test_a_table_of_the_file_has_all_keys_no_others_and_its_limits(file: Path) -> None:
    """``SpotSettings`` has a default for each key: a map made with other settings must not take them."""
    good = file.read_text()
    for table, key, value, words in (
        ("localiser", "power", None, "targets.1.localiser.power: Field required"),
        ("localiser", "colour", 1, "targets.1.localiser.colour: Extra inputs are not permitted, not 1"),
        ("localiser", "power", 11, "targets.1.localiser.power: Input should be less than or equal to 10"),
        ("localiser", "max_diameter_px", 0, "max_diameter_px: Input should be greater than 0, not 0"),
        ("spot", "misfit_ratio", 0.5, "targets.1.spot.misfit_ratio: Input should be greater than or equal"),
        ("spot", "grain", None, "targets.1.spot.grain: Field required"),
    ):
        targets = json.loads(good)["targets"]
        if value is None:
            del targets[1][table][key]
        else:
            targets[1][table][key] = value
        assert words in complaint(tampered(file, targets=targets)), (table, key)
    targets = json.loads(good)["targets"]
    targets[1]["map"]["x_axis"]["nodes"] = 1
    assert "targets.1.map.x_axis.nodes: Input should be" in complaint(tampered(file, targets=targets))
    targets = json.loads(good)["targets"]
    targets[1]["spot"]["shape"]["mean"][3] = 0
    assert "targets.1.spot.shape.mean.3: Input should be" in complaint(tampered(file, targets=targets))


@pytest.fixture
def with_flat(calibration: Calibration, tmp_path: Path) -> Path:
    """A calibration whose front target has a flat."""
    response = np.random.default_rng(1).uniform(0, 1, (480, 752))
    front = replace(calibration.targets[0], flat=Flat.from_response(response, "recording"))
    save_calibration(replace(calibration, targets=(front, calibration.targets[1])), tmp_path / "flat.json")
    return tmp_path / "flat.json"


def test_a_file_keeps_the_flat_and_where_it_comes_from(with_flat: Path) -> None:
    response = np.random.default_rng(1).uniform(0, 1, (480, 752))
    front, rear = load_calibration(with_flat).targets
    assert front.flat.source == "recording"
    assert np.abs(front.flat.response - response / response.mean()).max() < 2 * 1.01 / 255
    assert rear.flat is None


def test_a_damaged_flat_is_refused_with_its_place(with_flat: Path) -> None:
    targets = json.loads(with_flat.read_text())["targets"]
    good = targets[0]["flat"]["png"]
    small = base64.b64encode(cv2.imencode(".png", np.full((480, 640), 9, np.uint8))[1].tobytes()).decode()
    for png, complaint in (
        (good[: len(good) // 2 // 4 * 4], "targets.front.flat.png: "),
        ("", "targets.front.flat.png: is not a PNG"),
        ("no base64!", "targets.front.flat.png: Only base64 data is allowed"),
        (small, "targets.front.flat.png: is 640 × 480, expected 752 × 480"),
    ):
        targets[0]["flat"]["png"] = png
        assert complaint in complaint_of(with_flat, targets), complaint
    targets[0]["flat"] = {"source": "guess", "png": good}
    said = complaint_of(with_flat, targets)
    assert "targets.0.flat.source: Input should be 'recording', 'laser', 'service' or 'print'" in said
    del targets[0]["flat"]
    assert "targets.0.flat: Field required" in complaint_of(with_flat, targets)


def test_a_file_keeps_what_a_flat_of_service_has_learnt(calibration: Calibration, tmp_path: Path) -> None:
    share = np.zeros((120, 188))
    share[:, :100] = 1.0
    learnt = Learnt.of(share, 0.5, 30.0)
    flat = Flat.from_response(np.ones((480, 752)), "service", learnt=learnt)
    front, rear = calibration.targets
    file = tmp_path / "service.json"
    save_calibration(replace(calibration, targets=(replace(front, flat=flat), rear)), file)
    read, _ = load_calibration(file).targets
    assert read.flat.learnt.of_spot(200.0, 240.0) == pytest.approx(1.0, abs=0.01)
    half_a_block = NormalDist(0.0, 30.0 / 4.0).cdf(-2.0)
    assert read.flat.learnt.of_spot(401.0, 240.0) == pytest.approx(half_a_block, abs=0.01)
    known, unknown = (front.point(u_px, 240.0).covariance_mm2 for u_px in (200.0, 600.0))
    assert read.point(200.0, 240.0).covariance_mm2 == pytest.approx(known, abs=1e-6)
    jacobian = front.point(600.0, 240.0).jacobian_mm_per_px
    assert read.point(600.0, 240.0).covariance_mm2 == pytest.approx(unknown + 0.25 * jacobian @ jacobian.T)

    targets = json.loads(file.read_text())["targets"]
    stated = targets[0]["flat"]["learnt"]
    for wrong, complaint in (
        (None, "targets.front.flat.learnt: belongs to source = 'service'"),
        (stated | {"png": targets[0]["flat"]["png"]}, "flat.learnt.png: is 752 × 480, expected 188 × 120"),
        (stated | {"unlearnt_px": -1.0}, "targets.0.flat.learnt.unlearnt_px: Input should be"),
        (stated | {"diameter_px": 0.0}, "targets.0.flat.learnt.diameter_px: Input should be"),
    ):
        targets[0]["flat"]["learnt"] = wrong
        assert complaint in complaint_of(file, targets), complaint


def complaint_of(file: Path, targets: object) -> str:
    return complaint(tampered(file, targets=targets))


def test_a_measurement_recording_is_no_scan(tmp_path: Path) -> None:
    recording = open_recording(write_beams(tmp_path / "rec", [(0, 0, 0, 0)]))
    with pytest.raises(BadInputError, match="is of kind 'measurement'; a calibration needs a 'scan'"):
        calibrate([recording])


def reloaded(calibration: Calibration, folder: Path) -> Calibration:
    save_calibration(calibration, folder / "cal.json")
    return load_calibration(folder / "cal.json")


def with_front(calibration: Calibration, fingerprint: Fingerprint, flat: Flat | None = None) -> Calibration:
    front, rear = calibration.targets
    return replace(calibration, targets=(replace(front, fingerprint=fingerprint, flat=flat), rear))


def test_a_file_has_hot_pixels_and_the_texture_of_the_scan(calibration: Calibration, tmp_path: Path) -> None:
    surface = np.random.default_rng(0).normal(0, 0.06, (480, 752)).astype(np.float32)
    made = with_front(calibration, Fingerprint(HOT, Texture(surface), "scan"))
    read = reloaded(made, tmp_path).targets[0].fingerprint
    assert read.source == "scan"
    assert read.texture is not None
    np.testing.assert_array_equal(read.hot.permanent, HOT.permanent)
    np.testing.assert_array_equal(read.hot.intermittent, HOT.intermittent)
    np.testing.assert_allclose(read.texture.relative, surface, atol=0.0026)


def test_a_texture_from_the_flat_is_made_of_the_files_flat(calibration: Calibration, tmp_path: Path) -> None:
    flat = Flat(np.random.default_rng(0).integers(80, 255, (480, 752)).astype(np.uint8), "recording")
    made = with_front(calibration, Fingerprint(HOT, Texture.of_flat(flat), "flat"), flat)
    read = reloaded(made, tmp_path).targets[0].fingerprint
    np.testing.assert_array_equal(read.texture.relative, Texture.of_flat(flat).relative)


def test_a_file_of_an_older_altd_knows_nothing_of_cameras(file: Path) -> None:
    targets = json.loads(file.read_text())["targets"]
    for key in ("camera_model", "camera_driver", "fingerprint"):
        del targets[0][key]
    front = load_calibration(tampered(file, targets=targets)).targets[0]
    assert front.fingerprint is None
    assert (front.camera.model, front.camera.driver) == (None, None)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"hot_px": [[752, 0]]}, "front.fingerprint.hot_px: a pixel lies outside 752 × 480"),
        ({"hot_px": [[-1, 0]]}, "fingerprint.hot_px.0.0"),
        ({"texture": "scan"}, "front.fingerprint.png: belongs to texture 'scan'"),
        ({"texture": "scan", "png": "AAAA"}, "front.fingerprint.png: is no"),
        ({"texture": "flat"}, "front.fingerprint.texture: 'flat', but the target has none"),
        ({"texture": "moon"}, "fingerprint.texture"),
    ],
)
def test_a_fingerprint_that_does_not_fit_is_refused_in_one_line(
    file: Path, table: dict[str, object], said: str
) -> None:
    targets = json.loads(file.read_text())["targets"]
    targets[0]["fingerprint"] = {"hot_px": [], "sometimes_hot_px": [], "texture": None, "png": None} | table
    assert said in complaint(tampered(file, targets=targets))
