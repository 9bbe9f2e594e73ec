import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.played_unit import PlayedUnit

from altd.calibration.file import load_calibration, save_calibration
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from altd.measuring.calibration import Calibration
from altd.records import CameraIdentity
from altd.vision.fingerprint import Fingerprint
from altd.vision.flat import Flat
from altd.vision.hot_pixels import HotPixels, places_of
from altd.vision.texture import Texture

HOT = HotPixels(places_of([(3, 4), (700, 20)]), places_of([(5, 6)]))


@pytest.fixture(scope="module")
def calibration(played_unit: PlayedUnit) -> Calibration:
    made = load_calibration(played_unit.calibration)
    front, rear = made.targets
    return replace(made, targets=(replace(front, camera=CameraIdentity("F-7", "mini", "aravis")), rear))


def reloaded(calibration: Calibration, folder: Path) -> Calibration:
    save_calibration(calibration, folder / "cal.json")
    return load_calibration(folder / "cal.json")


def with_front(calibration: Calibration, fingerprint: Fingerprint, flat: Flat | None = None) -> Calibration:
    front, rear = calibration.targets
    return replace(calibration, targets=(replace(front, fingerprint=fingerprint, flat=flat), rear))


def test_the_file_carries_the_cameras_identities(calibration: Calibration, tmp_path: Path) -> None:
    front, rear = reloaded(calibration, tmp_path).targets
    assert front.camera == CameraIdentity("F-7", "mini", "aravis")
    assert rear.camera == CameraIdentity()


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


def edited(calibration: Calibration, folder: Path, **changes: object) -> Path:
    """The front target's table changed, None removes a key, and the checksum made good."""
    save_calibration(calibration, folder / "cal.json")
    document = json.loads((folder / "cal.json").read_text())
    document["targets"][0] |= changes
    for key in [key for key, value in changes.items() if value is None]:
        del document["targets"][0][key]
    document.pop("checksum")
    document["checksum"] = checksum_of(document)
    (folder / "cal.json").write_text(json.dumps(document))
    return folder / "cal.json"


def test_a_file_of_an_older_altd_knows_nothing_of_cameras(calibration: Calibration, tmp_path: Path) -> None:
    older = edited(calibration, tmp_path, camera_model=None, camera_driver=None, fingerprint=None)
    front = load_calibration(older).targets[0]
    assert front.fingerprint is None
    assert (front.camera.model, front.camera.driver) == (None, None)


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"hot_px": [[752, 0]]}, "front.fingerprint.hot_px: a pixel lies outside 752 × 480"),
        ({"hot_px": [[-1, 0]]}, "fingerprint.hot_px.0.0"),
        ({"texture": "scan"}, "front.fingerprint.png: belongs to texture 'scan'"),
        ({"texture": "scan", "png": "AAAA"}, "front.fingerprint.png: is no"),
        ({"texture": "flat"}, "front.fingerprint.texture: 'flat', but the target has none"),
        ({"texture": "moon"}, "fingerprint.texture"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(
    calibration: Calibration, tmp_path: Path, table: dict[str, object], complaint: str
) -> None:
    whole = {"hot_px": [], "sometimes_hot_px": [], "texture": None, "png": None} | table
    with pytest.raises(BadInputError) as caught:
        load_calibration(edited(calibration, tmp_path, fingerprint=whole))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
