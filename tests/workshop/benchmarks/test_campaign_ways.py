"""Each way of ``make campaign`` disturbs what its name says, by arithmetic on made-up scenes and frames."""

import math

import numpy as np
import pytest
from support.foreign import need

from altd.records import PixelArray
from benchmarks.campaign.scene import MeanImage, Noise, Scene, SpotShape, noisy_image
from benchmarks.campaign.way import CAMERAS, Draw, Shot, Spoil, Way, both, spoil_pixels
from benchmarks.campaign.ways import WAYS, ambient, cameras, frames, spots, surfaces

ROWS, COLUMNS, PX_PER_MM = 240, 376, 4.0
RADIUS_PX, PEAK = 20.0, 100.0
SHAPE = SpotShape(180.0, 110.0, (RADIUS_PX**-2, 0.0, RADIUS_PX**-2), 1.0, PEAK)
OPTICAL = [*spots.WAYS.ways, *surfaces.WAYS.ways, *ambient.WAYS.ways]
ELECTRONIC = [*frames.WAYS.ways, *cameras.WAYS.ways]


def draw(seed: int = 0) -> Draw:
    return Draw(np.random.default_rng(seed))


def made(name: str, seed: int = 0) -> Spoil:
    spoil = WAYS[name].make(draw(seed))
    assert isinstance(spoil, Spoil)
    return spoil


def scene(camera: str = "rear") -> Scene:
    """A Gaussian of 1/e² radius 20 px on 50 electrons of background, seen by pixels of response 10."""
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)
    beam = 10 * PEAK * np.exp(-2 * ((u - 180) ** 2 + (v - 110) ** 2) / RADIUS_PX**2)
    return Scene(
        camera,
        beam.astype(np.float32),
        np.full((ROWS, COLUMNS), 50, np.float32),
        np.full((ROWS, COLUMNS), 10, np.float32),
        SHAPE,
        PX_PER_MM,
    )


def centroid(picture: np.ndarray) -> tuple[float, float]:
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return float((u * picture).sum() / picture.sum()), float((v * picture).sum() / picture.sum())


def lit(spoil: Spoil, camera: str | None = None, since: int = 0) -> Scene:
    assert spoil.light is not None
    return spoil.light(scene(camera or sorted(spoil.cameras)[0]), since)


def share_and_place(name: str, seed: int) -> tuple[float, float]:
    """The light that a way has added, relative to the spot's, and its distance from it in mm."""
    clean, spoilt = scene(), lit(made(name, seed), "rear")
    added = spoilt.electrons - clean.electrons
    u, v = centroid(added)
    return float(added.sum() / clean.beam.sum()), math.hypot(u - 180, v - 110) / PX_PER_MM


@pytest.mark.parametrize("seed", range(3))
def test_a_reflection_has_the_share_and_the_distance_that_its_note_says(seed: int) -> None:
    words = made("reflection", seed).note.split()
    share, far_mm = share_and_place("reflection", seed)
    assert share == pytest.approx(float(words[0].rstrip("%")) / 100, abs=0.006)
    assert far_mm == pytest.approx(float(words[1]), abs=0.06)


@pytest.mark.parametrize("make", ["reflection_blurred", "reflection_sharper"])
def test_a_wider_or_narrower_reflection_keeps_its_share_of_light(make: str) -> None:
    share, _ = share_and_place(make, 3)
    assert share == pytest.approx(float(made(make, 3).note.split("%")[0]) / 100, abs=0.006)


def test_a_ring_is_dark_in_its_middle_and_has_its_share() -> None:
    share, _ = share_and_place("reflection_ring", 1)
    assert share == pytest.approx(float(made("reflection_ring", 1).note.split("%")[0]) / 100, rel=0.1)


def test_a_fixed_reflection_stays_where_the_first_exposure_put_it() -> None:
    spoil = made("reflection_fixed", 2)
    assert spoil.light is not None
    first = spoil.light(scene(), 0)
    moved = Scene("rear", scene().beam, scene().rest, scene().response, SHAPE.moved(30, 10), PX_PER_MM)
    assert np.array_equal(first.beam, spoil.light(moved, 1).beam)


def test_a_comet_tail_pulls_the_light_to_one_side() -> None:
    share, far_mm = share_and_place("comet_tail", 0)
    assert 0.02 <= share <= 0.2
    assert far_mm > 0.3


def test_half_black_leaves_no_light_on_one_side_of_its_edge_and_all_on_the_other() -> None:
    ratio = lit(made("half_black_soft", 1), "rear").electrons / scene().electrons
    assert (ratio.min(), ratio.max()) == (0.0, 1.0)
    dark, (u, v) = ratio < 0.5, centroid(np.asarray(ratio < 0.5, float))
    assert 0.1 < dark.mean() < 0.9
    assert math.hypot(u - 180, v - 110) > RADIUS_PX


def test_grease_takes_the_share_that_it_says_and_no_more() -> None:
    spoil = made("grease", 4)
    ratio = lit(spoil, "rear").electrons / scene().electrons
    assert ratio.max() == pytest.approx(1.0)
    assert 1 - ratio.min() == pytest.approx(float(spoil.note.split("%")[0]) / 100, abs=0.006)


def test_a_larger_and_a_smaller_spot_have_the_same_light_in_the_same_place() -> None:
    for make in ("spot_larger", "spot_smaller"):
        spoilt = lit(made(make, 0), "rear")
        assert float(spoilt.beam.sum()) == pytest.approx(float(scene().beam.sum()), rel=0.02)
        assert centroid(spoilt.beam) == pytest.approx((180, 110), abs=0.05)


def test_fog_takes_from_the_beam_what_it_gives_to_the_halo() -> None:
    spoilt = made("fog", 1)
    share = float(spoilt.note.split("%")[0]) / 100
    assert lit(spoilt, "rear").beam[110, 180] < scene().beam[110, 180] * (1 - 0.5 * share)


def test_fringes_have_the_contrast_that_they_say() -> None:
    spoil = made("fringes", 3)
    bright = scene().beam > 1.0
    ratio = lit(spoil, "rear").beam[bright] / scene().beam[bright]
    assert (ratio.max() - ratio.min()) / 2 == pytest.approx(
        float(spoil.note.split()[1].rstrip("%,")) / 100, abs=0.01
    )


def test_lamps_alone_leave_no_laser_and_say_so() -> None:
    for make in ("lamp_disc_alone", "lamp_hump_alone"):
        spoil = made(make, 2)
        assert spoil.no_beam
        assert not lit(spoil, "rear").beam.any()


def test_a_doubled_picture_doubles_the_background_too_and_adds_no_light() -> None:
    spoilt = lit(made("wet_window", 2), "rear")
    assert float(spoilt.electrons.mean()) == pytest.approx(float(scene().electrons.mean()), rel=0.02)
    assert spoilt.electrons[5, 5] == pytest.approx(50.0, rel=0.01)


def test_a_bent_view_moves_the_spot_by_what_it_says() -> None:
    spoil = made("bent_view_of_plate", 1)
    u, v = centroid(lit(spoil, "rear").electrons - 50)
    assert 0.7 <= math.hypot(u - 180, v - 110) / float(spoil.note.split()[1]) <= 1.05


def test_a_photographed_beam_has_its_centroid_where_the_beam_is() -> None:
    need(spots.BEAMS.exists(), "the photographs of ../shared/data are not here")
    spoilt = lit(made("photographed_beam", 1), "rear")
    assert centroid(spoilt.rest - 50) == pytest.approx((180, 110), abs=0.7)


@pytest.mark.parametrize("way", OPTICAL, ids=lambda way: way.name)
def test_a_way_of_light_changes_light_only_of_what_it_was_given(way: Way) -> None:
    changed = False
    for seed in range(6):
        spoil = made(way.name, seed)
        before = scene(sorted(spoil.cameras)[0])
        assert spoil.light is not None
        moved = Scene(before.camera, before.beam, before.rest, before.response, SHAPE.moved(9, 0), PX_PER_MM)
        kept = before.beam.copy(), before.rest.copy()
        after = spoil.light(before, 0)
        changed |= not np.allclose(after.electrons, before.electrons) or spoil.light(moved, 1) is not moved
        assert np.array_equal(before.beam, kept[0])
        assert np.array_equal(before.rest, kept[1])
        assert np.isfinite(after.electrons).all()
        assert after.electrons.min() >= 0
        assert after.electrons.dtype == np.float32
    assert changed


def shots(bits: int = 8, count: int = 6) -> list[Shot]:
    """Frames whose pixels tell camera, exposure, row and column apart."""
    dtype = np.uint8 if bits == 8 else np.uint16
    rng = np.random.default_rng(bits)
    return [
        Shot(camera, k, k, k, rng.integers(1, (1 << bits) - 1, (480, 752)).astype(dtype), bits)
        for k in range(count)
        for camera in CAMERAS
    ]


def spoilt_shots(spoil: Spoil, bits: int = 8, onset: int = 3) -> tuple[list[Shot], list[Shot]]:
    clean, dirty = shots(bits), shots(bits)
    spoil_pixels(spoil, dirty, onset)
    return clean, spoil.stream(dirty, onset) if spoil.stream else dirty


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("way", ELECTRONIC, ids=lambda way: way.name)
def test_a_way_of_frames_leaves_all_before_the_onset_and_keeps_depth_and_size(way: Way, bits: int) -> None:
    changed = False
    for seed in range(4):
        spoil = made(way.name, seed)
        for clean, dirty in zip(*spoilt_shots(spoil, bits), strict=True):
            same = np.array_equal(clean.pixels, dirty.pixels)
            if clean.k < 3:
                assert same
            changed |= not same
            assert (dirty.pixels.shape, dirty.pixels.dtype) == (clean.pixels.shape, clean.pixels.dtype)
            assert int(dirty.pixels.max()) < 1 << bits
            assert (dirty.sequence, dirty.t_ns, dirty.camera) == (clean.sequence, clean.t_ns, clean.camera)
    assert changed


def picture_of(
    spoil: Spoil, pixels: PixelArray, before: PixelArray | None = None, bits: int = 8
) -> PixelArray:
    assert spoil.pixels is not None
    return spoil.pixels(pixels, before, bits)


def test_a_torn_frame_has_the_upper_part_of_the_frame_before() -> None:
    before, now = np.full((100, 40), 7, np.uint8), np.full((100, 40), 9, np.uint8)
    pictures = [picture_of(made("torn", seed), now, before) for seed in range(8)]
    torn = [picture for picture in pictures if (picture == 7).any()]
    assert torn
    for picture in torn:
        cut = int((picture[:, 0] == 7).sum())
        assert (picture[:cut] == 7).all()
        assert (picture[cut:] == 9).all()
        assert 0 < cut <= 15  # around the brightest row, here the first


def test_a_frozen_camera_shows_the_last_good_picture_for_ever() -> None:
    spoil = made("frozen", 0)
    clean, dirty = spoilt_shots(spoil)
    frozen = [
        shot
        for shot in dirty
        if shot.k >= 3
        and any(
            np.array_equal(shot.pixels, last.pixels)
            for last in clean
            if last.k == 2 and last.camera == shot.camera
        )
    ]
    assert len(frozen) in (3, 6)


def test_a_late_camera_shows_what_was_some_frames_ago() -> None:
    spoil = made("one_camera_late", 0)
    camera, late = spoil.note.split()[0], int(spoil.note.split()[1])
    clean, dirty = spoilt_shots(spoil)
    pictures = {(shot.camera, shot.k): shot.pixels for shot in clean}
    for shot in dirty:
        ago = max(shot.k - late, 0) if shot.k >= 3 and shot.camera == camera else shot.k
        assert np.array_equal(shot.pixels, pictures[shot.camera, ago])


def test_exchanged_cameras_show_each_others_pictures() -> None:
    clean, dirty = spoilt_shots(made("exchanged"))
    pictures = {(shot.camera, shot.k): shot.pixels for shot in clean}
    other = {"front": "rear", "rear": "front"}
    for shot in dirty:
        assert np.array_equal(
            shot.pixels, pictures[other[shot.camera] if shot.k >= 3 else shot.camera, shot.k]
        )


@pytest.mark.parametrize(("make", "far"), [("shifted_1_px", 1), ("shifted_2_px", 2), ("shifted_4_px", 4)])
def test_a_shifted_picture_lies_whole_pixels_off(make: str, far: int) -> None:
    pixels = np.zeros((60, 80), np.uint8)
    pixels[30, 40] = 200
    v, u = np.argwhere(picture_of(made(make, 5), pixels) == 200)[0]
    assert max(abs(v - 30), abs(u - 40)) == far


def test_a_turned_picture_turns_by_the_angle_that_it_says() -> None:
    spoil = made("turned", 2)
    pixels = np.zeros((480, 752), np.uint8)
    pixels[235:245, 640:660] = 200
    before, after = centroid(pixels), centroid(picture_of(spoil, pixels))
    turned = [math.degrees(math.atan2(239.5 - v, u - 375.5)) for u, v in (before, after)]
    assert turned[1] - turned[0] == pytest.approx(float(spoil.note.rstrip("°")), abs=0.02)


def test_two_ways_at_once_do_what_each_does() -> None:
    one, two = made("reflection", 1), made("half_black", 1)
    pair = both(one, two)
    assert pair.light is not None
    for camera in CAMERAS:
        expected = scene(camera)
        for part in (one, two):
            if camera in part.cameras:
                assert part.light is not None
                expected = part.light(expected, 0)
        assert np.array_equal(pair.light(scene(camera), 0).electrons, expected.electrons)


def test_noise_belongs_to_the_light_that_is_left() -> None:
    """The scatter of many exposures of even light is what the exposing says, at 8 and at 12 bits."""
    for bits in (8, 12):
        mean = MeanImage(np.full((ROWS, COLUMNS), 60, np.float32), np.full((ROWS, COLUMNS), 3, np.float32))
        rng = np.random.default_rng(1)
        pictures = [noisy_image(mean, Noise(1).picture((ROWS, COLUMNS), rng), bits) for _ in range(4)]
        assert np.std(pictures) == pytest.approx(math.hypot(3, math.sqrt(1 / 12)), rel=0.01)
        assert not np.array_equal(pictures[0], pictures[1])


def test_there_are_sixty_ways_and_more() -> None:
    spoiling = [way for way in WAYS.values() if way.kind != "good"]
    assert len(spoiling) >= 60
    assert {way.kind for way in spoiling} == {
        "spots",
        "surfaces",
        "ambient",
        "frames",
        "cameras",
        "times",
        "numbers",
    }
