"""The LEDs of a plate in pictures whose light is a formula."""

import numpy as np
import pytest

from altd.instruments.planar.leds import find_leds, led_image, rim_points_px

LEVEL = 150.0


def picture(places: list[tuple[float, float]], radius_px: float) -> np.ndarray:
    """Discs with half their light at the radius, on a background that slopes."""
    v, u = np.mgrid[:120, :160]
    counts = 10.0 + 0.05 * u + 0.02 * v
    for at_u, at_v in places:
        counts += LEVEL / (1.0 + np.exp((np.hypot(u - at_u, v - at_v) - radius_px) / 0.5))
    return counts.astype(np.float32)


@pytest.mark.parametrize("radius_px", [6.0, 9.13])
def test_a_rim_is_where_half_the_light_of_a_disc_is(radius_px: float) -> None:
    place = 60.3, 51.8
    image = led_image(picture([place], radius_px))
    (disc,) = find_leds(image)
    assert (disc.u_px, disc.v_px) == pytest.approx(place, abs=0.02)
    distance_px = np.hypot(*(rim_points_px(image, disc) - place).T)
    assert len(distance_px) == 32
    assert distance_px.mean() == pytest.approx(radius_px, abs=0.05)
    assert distance_px.std() < 0.1


def test_a_disc_that_the_border_cuts_is_no_led() -> None:
    found = find_leds(led_image(picture([(60.0, 50.0), (2.0, 90.0), (110.0, 30.0)], 7.0)))
    assert sorted(round(disc.u_px) for disc in found) == [60, 110]
