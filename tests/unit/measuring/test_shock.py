"""Shocks: spots that all jump, and what is none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from support.located import SPOT, located

from altd.measuring.shock import ShockWatch
from altd.reasons import Reason
from altd.records import NoSpot

PERIOD_NS = 50_000_000
Path = Callable[[str, float], float]


def shocks(path: Path, lost: tuple[int, ...] = (), seconds: float = 3.0) -> list[int]:
    """The numbers of the exposures with which a shock is seen; ``path`` gives u of a camera at a second."""
    watch = ShockWatch(("front", "rear"))
    found = []
    for number in range(round(seconds * 20)):
        for camera in ("front", "rear"):
            one = located(camera, number, number * PERIOD_NS + (camera == "rear") * 20_000_000)
            spot = replace(SPOT, u_px=path(camera, number * 0.05))
            lost_now = number in lost
            one = replace(one, spot=NoSpot(Reason.SPOT_MISSING) if lost_now else spot)
            if watch.is_shock(one):
                found.append(number)
    return found


def jump_px(at_s: float, px: float) -> Callable[[float], float]:
    return lambda t_s: 300.0 + (px if t_s >= at_s else 0.0)


def test_a_jump_of_all_spots_is_one_shock() -> None:
    assert shocks(lambda camera, t_s: jump_px(1.0, 12.0)(t_s)) == [20]


def test_two_jumps_are_two_shocks() -> None:
    assert shocks(lambda camera, t_s: jump_px(1.0, 12.0)(t_s) + jump_px(2.0, -15.0)(t_s)) == [20, 40]


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(lambda camera, t_s: 300 + 120.0 * t_s, id="steady motion, 30 mm/s"),
        pytest.param(lambda camera, t_s: 300 + 1.5 * math.sin(2 * math.pi * 7.3 * t_s), id="vibration"),
        pytest.param(
            lambda camera, t_s: jump_px(1.0, 12.0)(t_s) if camera == "rear" else 300.0, id="one spot alone"
        ),
        pytest.param(
            lambda camera, t_s: jump_px(1.0 + (camera == "rear"), 12.0)(t_s), id="one after the other"
        ),
    ],
)
def test_what_is_no_shock(path: Path) -> None:
    assert shocks(path) == []


def test_a_beam_that_was_away_and_comes_back_elsewhere_is_no_shock() -> None:
    assert shocks(lambda camera, t_s: jump_px(1.0, 50.0)(t_s), lost=tuple(range(15, 25))) == []
