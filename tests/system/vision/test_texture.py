import cv2
import numpy as np
import pytest
from support.frames import HEIGHT, WIDTH, Blob, frame, light

from altd.records import Frame
from altd.vision.frame_analysis import FrameAnalysis
from altd.vision.settings import SpotSettings
from altd.vision.texture import Texture, TextureMatch, TextureSample, match, sample_of

SPOT = Blob(360.0, 250.0, 60.0)


def grain(seed: int, contrast: float = 0.08) -> np.ndarray:
    """Relative brightness − 1 of a surface, as wide as a lens makes it."""
    white = np.random.default_rng([0, seed]).normal(size=(HEIGHT, WIDTH))
    blurred = cv2.GaussianBlur(white, (0, 0), 0.8)
    return contrast * blurred / blurred.std()


def shown(
    surface: np.ndarray, by_px: tuple[float, float] = (0.0, 0.0), seed: int = 0, spot: Blob = SPOT
) -> Frame:
    """A spot that stands still on a surface whose picture moved."""
    moved = cv2.warpAffine(
        surface, np.array([[1, 0, by_px[0]], [0, 1, by_px[1]]]), (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC
    )
    return frame(light(spot) * (1 + moved), np.random.default_rng([1, seed]), noise=1.0)


def sampled(seen: Frame) -> TextureSample:
    sample = sample_of(FrameAnalysis(seen, SpotSettings()))
    assert sample is not None
    return sample


def matched(seen: Frame, surface: np.ndarray) -> TextureMatch:
    found = match(sampled(seen), Texture(surface.astype(np.float32)))
    assert found is not None
    return found


@pytest.mark.parametrize("by_px", [(0.0, 0.0), (1.0, 0.0), (0.3, -0.4), (-4.0, 3.0), (0.0, 10.5)])
def test_a_shift_is_measured_to_a_fraction_of_a_pixel(by_px: tuple[float, float]) -> None:
    surface = grain(1)
    for seed in range(5):
        found = matched(shown(surface, by_px, seed), surface)
        off = found.u_px - by_px[0], found.v_px - by_px[1]
        assert np.hypot(*off) < 0.12, off
        assert found.significance > 20
        assert found.sigma_px < 0.06


def test_the_shift_scatters_as_its_sigma_says() -> None:
    """A dim spot, so that noise decides: 1.3 leaves room for the scatter of 40 draws and of the estimate."""
    surface = grain(2)
    pulls = []
    for seed in range(40):
        picture = light(Blob(360.0, 250.0, 60.0, peak=30.0)) * (1 + surface)
        found = matched(frame(picture, np.random.default_rng([1, seed]), noise=2.0), surface)
        if found.significance > 8:
            pulls += [found.u_px / found.sigma_px, found.v_px / found.sigma_px]
    assert len(pulls) > 60
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_another_surface_is_never_taken_for_the_known_one() -> None:
    """The highest of 625 lags of noise is about 3 sigma; the verdicts ask for 8."""
    known = grain(3)
    found = [matched(shown(grain(100 + seed), seed=seed), known) for seed in range(60)]
    assert max(one.significance for one in found) < 5.5
    assert max(one.gain for one in found) < 0.35


def test_the_share_of_the_contrast_that_is_explained_is_one_or_none() -> None:
    surface, spot = grain(4, contrast=0.3), Blob(360.0, 250.0, 60.0, peak=90.0)
    assert matched(shown(surface, spot=spot), surface).explained > 0.9
    assert matched(shown(grain(5, contrast=0.3), spot=spot), surface).explained < 0.1


def test_a_clipped_spot_tells_nothing_of_what_is_explained() -> None:
    """Without its bright grains, which are cut off, the rest looks like another surface."""
    surface = grain(4, contrast=0.3)
    seen = shown(surface, spot=Blob(360.0, 250.0, 60.0, peak=240.0))
    assert sampled(seen).is_clipped
    assert matched(seen, surface).explained == 1.0


def test_where_nothing_is_known_there_is_no_answer() -> None:
    surface = grain(6)
    seen = sampled(shown(surface))
    surface[150:350, 250:450] = 0
    assert match(seen, Texture(surface.astype(np.float32))) is None


def test_the_shape_of_a_spot_is_no_texture() -> None:
    """An even plate under a spot of the usual size: less is left than a tenth of what grain makes."""
    sample = sampled(frame(light(SPOT), np.random.default_rng(7), noise=1.0))
    assert sample.contrast < 0.02


def test_a_frame_without_a_spot_has_no_sample() -> None:
    empty = frame(np.zeros((HEIGHT, WIDTH)), np.random.default_rng(8))
    assert sample_of(FrameAnalysis(empty, SpotSettings())) is None


def test_a_doubled_picture_is_told_by_how_far_it_may_draw_the_spot_aside() -> None:
    """Share times distance, within the resolution; on a print a step of the dots further on would do too."""
    rng = np.random.default_rng(7)
    surface = grain(5, 0.25)
    there = light(SPOT) * (1 + surface)
    assert matched(frame(there, rng, noise=1.0), surface).doubled_px < 0.15
    for share, far_px in ((0.2, 4.0), (0.3, 3.0), (0.3, 5.0)):
        ghost = cv2.warpAffine(there, np.array([[1.0, 0, far_px], [0, 1, 0]]), (WIDTH, HEIGHT))
        found = matched(frame((1 - share) * there + share * ghost, rng, noise=1.0), surface)
        assert 0.8 * share * far_px < found.doubled_px < 2.0 * share * far_px
        assert found.shift_px < 0.2
