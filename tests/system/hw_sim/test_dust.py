import numpy as np
import pytest

from hw_sim.beam import BeamPose
from hw_sim.dust import CELL_MM, HALF_MM, make_dust
from hw_sim.unit import CAMERAS, REAR, Unit, UnitConfig


def dusty(amount: float) -> Unit:
    return Unit(UnitConfig(seed=7, speckle_contrast=0.0, lux=0.0, hot_pixels=0, bits=16, dust=amount))


def test_dust_lies_only_where_it_is_and_goes_as_it_came() -> None:
    unit, clean = dusty(0.0), dusty(0.0)
    unit.set_dust(1.0)
    for camera in CAMERAS:
        assert not np.array_equal(
            unit.expose(camera, 0, 0).pixels,
            clean.expose(camera, 0, 0).pixels,
        )
    unit.set_dust(0.0)
    for camera in CAMERAS:
        assert np.array_equal(unit.expose(camera, 0, 0).pixels, clean.expose(camera, 0, 0).pixels)


def test_more_dust_holds_all_of_less_and_covers_the_share_that_it_says() -> None:
    some, heavy = (make_dust(amount, np.random.default_rng(1)).transmission for amount in (0.5, 1.0))
    assert np.all(heavy <= some + 1e-6)
    covered = float(np.mean(heavy < 0.5))
    # 1000 discs whose diameters are log-even from 0.1 to 1 mm: E[d²] = (1 − 0.01) / (2 ln 10) mm².
    area_mm2 = np.prod(np.array(HALF_MM) * 2)
    assert covered == pytest.approx(
        1000 * np.pi / 4 * 0.99 / (2 * np.log(10)) / area_mm2,
        rel=0.15,
    )
    assert np.quantile(heavy, 0.02) > 0.85  # beside the specks, smears alone
    assert heavy.shape == tuple(round(2 * half / CELL_MM) for half in reversed(HALF_MM))


def test_a_speck_on_the_window_casts_its_shadow_along_the_beam() -> None:
    """The place of the shadow on the rear target, from the two slopes and the distance alone."""
    clean, unit = dusty(0.0), dusty(1.0)
    where = []
    for slope in (0.0, 0.02):
        pose = BeamPose(0.0, 0.0, slope, 0.0)
        for each in (clean, unit):
            each.place(pose)
        view = unit.imagers[REAR].view
        dirty_e, clean_e = (
            each.imagers[REAR].mean_e(
                each.spots(REAR, 0),
                leds_on=False,
                exposure_ms=1.6,
            )
            for each in (unit, clean)
        )
        plate = view.response / clean.imagers[REAR].view.response  # factor of the plate's own dust
        shadow = 1.0 - dirty_e / (clean_e * plate + 1e-9)
        near = np.hypot(view.x_mm - 280.0 * slope, view.y_mm) < 5.0
        where.append((view.x_mm[near] - 280.0 * slope, view.y_mm[near], shadow[near]))
    (x0, y0, s0), (x1, y1, s1) = where
    bins = np.arange(-5.0, 5.5, 0.5)
    maps = [
        np.histogram2d(y, x, (bins, bins), weights=s)[0]
        / np.maximum(np.histogram2d(y, x, (bins, bins))[0], 1)
        for x, y, s in ((x0, y0, s0), (x1, y1, s1))
    ]
    assert maps[0].max() > 0.05  # a speck is there
    assert np.corrcoef(maps[0].ravel(), maps[1].ravel())[0, 1] > 0.9


@pytest.mark.parametrize("amount", [-0.1, 1.1, float("nan")])
def test_dust_outside_none_to_heavy_is_refused(amount: float) -> None:
    with pytest.raises(ValueError, match=r"dust of .* is not between 0 and 1"):
        dusty(amount)
