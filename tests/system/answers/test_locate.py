import csv
import io
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.cli import altd_here
from support.frames import Blob, frame, light
from support.photographs import dots

from altd.answers.locate import doubt
from altd.records import Frame, Spot
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.localise import locate, locate_ellipse
from altd.vision.settings import SpotSettings

KEYS = [
    *("image", "u_px", "v_px", "sigma_px", "diameter_px", "peak", "reason", "detail"),
    *("ellipse_u_px", "ellipse_v_px", "ellipse_sigma_px", "doubt"),
]


@pytest.fixture
def pictures(tmp_path: Path) -> list[Path]:
    """A spot, none, a text, a picture in colour, one that is not there, and a spot again."""
    spot = frame(light(Blob(300.5, 200.25)) * 200, bits=16).pixels
    names = ("spot.png", "dark.pgm", "text.png", "colour.png", "none.png", "last.png")
    paths = [tmp_path / name for name in names]
    cv2.imwrite(str(paths[0]), spot)
    cv2.imwrite(str(paths[1]), np.full((100, 120), 7, np.uint8))
    paths[2].write_text("hello")
    cv2.imwrite(str(paths[3]), np.zeros((64, 64, 3), np.uint8))
    cv2.imwrite(str(paths[5]), spot)
    return paths


def test_an_object_an_image(pictures: list[Path]) -> None:
    outcome = altd_here("locate", *pictures[:2])
    assert (outcome.status, outcome.err) == (0, "")
    spot, dark = outcome.objects
    assert list(spot) == list(dark) == KEYS
    assert (spot["u_px"], spot["v_px"]) == pytest.approx((300.5, 200.25), abs=0.01)
    assert spot["sigma_px"] > 0
    assert (spot["ellipse_u_px"], spot["ellipse_v_px"]) == pytest.approx((300.5, 200.25), abs=0.01)
    assert spot["ellipse_sigma_px"] > 0
    assert spot["reason"] is spot["detail"] is spot["doubt"] is None
    assert dark["reason"] == "spot_missing"
    assert all(dark[key] is None for key in KEYS if key not in ("image", "reason", "detail"))


def test_images_that_are_none_do_not_stop_the_others(pictures: list[Path]) -> None:
    outcome = altd_here("locate", *pictures)
    assert outcome.status == 2
    assert [row["image"] for row in outcome.objects] == [str(path) for path in pictures]
    assert [row["reason"] for row in outcome.objects] == [None, "spot_missing", *["unreadable"] * 3, None]
    assert outcome.objects[0] == {**outcome.objects[5], "image": str(pictures[0])}
    said = outcome.err.splitlines()
    assert len(said) == 3
    for line, path, why in zip(
        said,
        pictures[2:5],
        ("is not an image", "is not an 8- or 16-bit grey image", "No such file or directory"),
        strict=True,
    ):
        assert line.startswith(f"altd locate: {path}: {why}")


def test_csv_has_the_same_in_rows(pictures: list[Path]) -> None:
    outcome = altd_here("locate", "--format", "csv", *pictures)
    objects = altd_here("locate", *pictures).objects
    header, *rows = csv.reader(io.StringIO(outcome.out, newline=""), strict=True)
    assert outcome.status == 2
    assert header == KEYS
    assert rows == [["" if row[key] is None else str(row[key]) for key in KEYS] for row in objects]


def told(picture: Frame) -> str | None:
    spot = locate(picture)
    assert isinstance(spot, Spot)
    return doubt(FrameAnalysis(picture, SpotSettings()), spot, locate_ellipse(picture))


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("diameters", [(16, 16), (44, 20), (44, 44), (90, 90), (150, 70)])
def test_good_spots_are_not_doubted(bits: int, diameters: tuple[float, float]) -> None:
    rng = np.random.default_rng(bits + round(diameters[0]))
    full = (1 << bits) - 1
    for _ in range(10):
        u, v, angle = *rng.uniform((300, 200), (301, 201)), rng.uniform(0, 3)
        spot = light(Blob(u, v, *diameters, angle, peak=0.7 * full))
        electrons = rng.poisson(spot * 10_000 / full) * full / 10_000
        assert (
            told(frame(electrons, rng, noise=max(0.7, 5e-4 * full), background=0.03 * full, bits=bits))
            is None
        )


@pytest.mark.parametrize("share", [0.1, 0.2])
@pytest.mark.parametrize("away_px", [12.0, 20.0, 28.0])
def test_a_spot_with_a_second_light_in_it_is_doubted(share: float, away_px: float) -> None:
    rng = np.random.default_rng(3)
    ghost = Blob(300.3 + away_px, 200.6, 30.0, peak=150 * share)
    said = told(frame(light(Blob(300.3, 200.6), ghost), rng))
    assert said is not None
    assert "localisers differ" in said


def test_a_spot_that_something_clips_is_doubted() -> None:
    spot = light(Blob(300.3, 200.6))
    spot[:, 310:] *= 0.3
    assert told(frame(spot, np.random.default_rng(4))) is not None


@pytest.mark.parametrize("name", ["TEM00_200mm.pgm", "k-500mm.png", "t-348mm.pgm", "t-hene.pgm"])
def test_photographs_are_doubted_by_what_their_table_says(name: str, shared_data: Path) -> None:
    """The page: none of them is as even as its noise is low; the two lie 0.4 to 4.1 px apart."""
    (row,) = altd_here("locate", shared_data / "beams" / name).objects
    apart_px = np.hypot(row["u_px"] - row["ellipse_u_px"], row["v_px"] - row["ellipse_v_px"])
    allowed_px = 5 * np.hypot(row["sigma_px"], row["ellipse_sigma_px"])
    assert apart_px > 3 * allowed_px
    said = re.fullmatch(r"the two localisers differ by (\S+) px, (\S+) px are allowed", row["doubt"])
    assert said is not None
    assert tuple(map(float, said.groups())) == pytest.approx((apart_px, allowed_px), abs=2e-3)


def test_a_spot_of_which_the_second_localiser_sees_nothing_is_doubted() -> None:
    dark = FrameAnalysis(frame(light()), SpotSettings())
    assert doubt(dark, Spot(300.0, 200.0, 0.01, 40.0, 150.0), None) is not None


PRINT = dots()
MIDDLE_PX = (np.array(PRINT.shape) - 1) / 2
TURNED = light(Blob(*MIDDLE_PX, 32.0, 12.0, 0.6, 1.0), width=len(PRINT), height=len(PRINT))


def polar(angle_rad: float = 0.0, off_px: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Along and across an axis through a spot, and px from its middle."""
    v, u = np.indices(PRINT.shape) - MIDDLE_PX[:, None, None] - off_px
    return (
        u * np.cos(angle_rad) + v * np.sin(angle_rad),
        v * np.cos(angle_rad) - u * np.sin(angle_rad),
    )


def beam(diameter_px: float, order: float = 1.0) -> np.ndarray:
    """A super-Gaussian of peak 1."""
    return np.exp(-2 * (2 * np.hypot(*polar()) / diameter_px) ** (2 * order))


def photographed(irradiance: np.ndarray, bits: int, seed: int, on_print: bool = False) -> Frame:
    """A picture of 10,000 electrons at full scale, with a read noise of 25."""
    rng, full = np.random.default_rng(seed), (1 << bits) - 1
    seen = irradiance * PRINT / PRINT.max() if on_print else irradiance
    electrons = rng.poisson(np.maximum(seen, 0) * 7000.0) + rng.normal(0, 25, seen.shape)
    return frame(electrons * full / 10_000, background=0.03 * full, bits=bits)


@pytest.mark.parametrize("on_print", [False, True])
@pytest.mark.parametrize("bits", [8, 12])
def test_two_touching_lobes_are_no_spot_or_are_doubted(bits: int, on_print: bool) -> None:
    """TEM01, whose middle is dark; from a width of 12 px on the lobes are two spots."""
    for seed, width_px in enumerate((8, 9, 10, 12, 16, 20)):
        along, across = polar(0.5 * seed)
        lobes = 2 * np.e * (along / width_px) ** 2 * np.exp(-2 * (along**2 + across**2) / width_px**2)
        picture = photographed(lobes, bits, seed, on_print)
        spot = locate(picture)
        if isinstance(spot, Spot):
            assert "the spot has two lobes" in str(told(picture))
        else:
            assert spot.reason == "ambiguous"
        assert isinstance(spot, Spot) is (width_px < 12)


@pytest.mark.parametrize("on_print", [False, True])
@pytest.mark.parametrize("bits", [8, 12])
def test_a_spot_that_moved_between_two_fields_is_doubted(bits: int, on_print: bool) -> None:
    for seed, diameter_px in enumerate((16, 30, 44, 70)):
        combed = beam(diameter_px)
        combed[1::2] = np.roll(combed[1::2], (12, -12, 3, 12)[seed], axis=1)
        said = told(photographed(combed, bits, seed, on_print))
        assert said == "even and odd rows show different pictures: the camera interlaces"


def test_a_spot_in_one_field_alone_is_doubted() -> None:
    rows = np.arange(len(PRINT))[:, None] % 2
    assert "interlaces" in str(told(photographed(beam(44) * rows, 12, 1)))


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("diameter_px", [3, 4, 5])
def test_a_spot_below_the_size_limit_is_of_the_wrong_size(
    diameter_px: int, bits: int, tmp_path: Path
) -> None:
    picture = photographed(beam(diameter_px), bits, diameter_px).pixels
    picture[(3, 40, 150), (9, 140, 20)] = (1 << bits) - 1  # hot pixels are no spots
    cv2.imwrite(str(tmp_path / "small.png"), picture * (1 if bits == 8 else 16))
    picture[74:94, 74:94] = np.median(picture)
    cv2.imwrite(str(tmp_path / "none.png"), picture * (1 if bits == 8 else 16))
    small, none = altd_here("locate", tmp_path / "small.png", tmp_path / "none.png").objects
    assert small["reason"] == "wrong_size"
    said = re.fullmatch(r"diameter (\S+) px, expected 8 to 101 px", small["detail"])
    assert said is not None
    assert float(said[1]) == pytest.approx(diameter_px, abs=0.6)
    assert none["reason"] == "spot_missing"


@pytest.mark.parametrize("on_print", [False, True])
@pytest.mark.parametrize("bits", [8, 12])
def test_good_spots_have_one_lobe_and_equal_fields(bits: int, on_print: bool) -> None:
    """Gaussian, turned ellipse, top hat, coarse and fine speckle; the two localisers may differ."""
    rng = np.random.default_rng(bits)
    grains = [rng.normal(0, 0.2, PRINT.shape), cv2.GaussianBlur(rng.normal(0, 1.4, PRINT.shape), (0, 0), 2)]
    speckled = (beam(50) * np.maximum(1 + grain, 0) for grain in grains)
    for seed, irradiance in enumerate((beam(20), beam(60), TURNED, beam(40, order=6), *speckled)):
        said = told(photographed(irradiance, bits, seed, on_print))
        assert said is None or said.startswith("the two localisers differ")
