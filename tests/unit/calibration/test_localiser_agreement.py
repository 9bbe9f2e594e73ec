"""Two localisers held against each other over the nodes of a target, on frames with known truth."""

import numpy as np
import pytest
from support.frames import Blob, frame, light

from altd.calibration.spot_reference import Agreement, localiser_agreement, verdict
from altd.records import Frame
from altd.vision.flat import Flat
from altd.vision.settings import SpotSettings

WIDTH, HEIGHT = 360, 300
READ = 1.0
PLACES = [(u, v) for v in (80.0, 120.0, 160.0, 200.0) for u in (80.0, 130.0, 180.0, 230.0, 280.0)]
SETTINGS = SpotSettings(method="profile", full_well_electrons=1e9)  # the frames have no shot noise


def surface(seed: int) -> np.ndarray:
    """Grain of contrast 0.25."""
    return np.maximum(1 + 0.25 * np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH)), 0.1)


def frames(response: np.ndarray | float, *, ghosts: bool = False) -> list[Frame]:
    rng = np.random.default_rng(1)
    shown = []
    for u, v in PLACES:
        blobs = [Blob(u + rng.uniform(-0.5, 0.5), v + rng.uniform(-0.5, 0.5), peak=140.0)]
        if ghosts:
            around = rng.uniform(0, 2 * np.pi)
            blobs.append(Blob(u + 20 * np.cos(around), v + 20 * np.sin(around), 30.0, peak=20.0))
        shown.append(frame(response * light(*blobs, width=WIDTH, height=HEIGHT), rng, READ))
    return shown


def both(pictures: list[Frame], flat: Flat | None = None) -> Agreement:
    found = localiser_agreement(pictures, SETTINGS, flat)
    assert found.nodes == len(PLACES)
    return found


def test_on_a_clean_target_they_agree_as_noise_lets_them() -> None:
    clean = both(frames(1.0))
    assert 0.2 * clean.sigma_px < clean.scatter_px < clean.sigma_px < 0.02
    assert clean.difference_px == pytest.approx(clean.scatter_px, rel=0.25)
    told = verdict("rear", "profile", clean, 0.0)
    assert told.doubt is None
    assert told.remark.startswith("rear: profile and ellipse lie 0.0")
    assert f"bound {clean.limit_px(0.0):.3f} px" in told.remark


def test_through_the_right_flat_they_agree_through_another_ones_they_do_not() -> None:
    pictures = frames(surface(2))
    right = both(pictures, Flat.from_response(surface(2), "recording"))
    assert right.scatter_px < right.limit_px(0.0) / 2
    wrong = verdict("front", "profile", both(pictures, Flat.from_response(surface(3), "recording")), 0.0)
    assert "\n" not in wrong.doubt
    assert "a flat that is not this target's" in wrong.doubt


def test_a_reflection_that_wanders_about_the_spots_is_doubted() -> None:
    assert verdict("front", "profile", both(frames(1.0, ghosts=True)), 0.0).doubt is not None


def test_grain_without_a_flat_is_excused_by_the_pattern_and_print_by_itself() -> None:
    grainy = both(frames(surface(2)))
    assert grainy.scatter_px > grainy.limit_px(0.0)
    assert verdict("rear", "profile", grainy, 0.0).doubt is not None
    assert verdict("rear", "profile", grainy, grainy.scatter_px).doubt is None
    printed = verdict("front", "moment", grainy, None)
    assert printed.doubt is None
    assert printed.remark.endswith("print moves them differently")


def test_what_changes_evenly_over_the_target_is_not_scatter() -> None:
    """Ghosts on the same side everywhere shift one localiser against the other, as a map takes in."""
    rng = np.random.default_rng(4)
    pictures = [
        frame(light(Blob(u, v), Blob(u + 20, v, 30.0, peak=15.0), width=WIDTH, height=HEIGHT), rng, READ)
        for u, v in PLACES
    ]
    shifted = both(pictures)
    assert shifted.difference_px > 0.1
    assert shifted.scatter_px < shifted.limit_px(0.0)


def test_too_few_spots_are_said_to_be_too_few() -> None:
    dark = [frame(np.zeros((HEIGHT, WIDTH)))] * 20
    nothing = localiser_agreement([*frames(1.0)[:5], *dark], SETTINGS, None)
    assert nothing is None
    assert verdict("rear", "profile", nothing, 0.0).remark == (
        "rear: the ellipse found too few spots to compare it with the profile"
    )
