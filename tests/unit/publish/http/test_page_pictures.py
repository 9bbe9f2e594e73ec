"""The page's newest pictures, run by Node.js: none is older than a second or so."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.page_in_node import Driven

HERE = Path(__file__).parent


@pytest.fixture
def pictures(tmp_path: Path) -> Iterator[Driven]:
    with Driven.driven(HERE / "watcher_in_node.mjs", tmp_path, "watcher") as pictures:
        yield pictures


def message(sequence: int, age_s: float = 0.1, held_s: float = 0.05) -> dict[str, Any]:
    return {
        "held_s": held_s,
        "pictures": [{"target": "front", "sequence": sequence, "age_s": age_s, "spot": None, "bytes": 0}],
    }


def test_a_picture_is_as_old_as_its_light_and_its_way(pictures: Driven) -> None:
    """It came 350 ms after it was asked for; the unit held it for 50 ms of them."""
    shown = pictures.do(pass_ms=350, message=message(7, age_s=0.1, held_s=0.05))
    assert shown["address"] == "ws://plant/unit7/api/v1/pictures", "the page may be behind a prefix"
    assert shown["shown"] == {"front": [7, pytest.approx(0.4)]}
    assert pictures.do(pass_ms=800, tick=True)["shown"] == {"front": [7, pytest.approx(1.2)]}
    assert pictures.do(pass_ms=200, tick=True)["shown"] == {}


@pytest.mark.parametrize("slept_ms", [1400, 3_600_000])
def test_a_picture_that_waited_for_a_computer_that_slept_is_not_shown(
    pictures: Driven, slept_ms: int
) -> None:
    pictures.do(pass_ms=100, message=message(7))
    shown = pictures.do(pass_ms=slept_ms, message=message(8), tick=True)
    assert shown["shown"] == {}
    assert shown["asked"] == 3  # the next is asked for nevertheless
    assert pictures.do(pass_ms=100, message=message(9))["shown"] == {"front": [9, pytest.approx(0.15)]}


def test_a_browser_whose_clock_is_set_back_keeps_no_picture_for_it(pictures: Driven) -> None:
    pictures.do(pass_ms=100, message=message(7))
    assert pictures.do(pass_ms=-3_600_000, tick=True)["shown"] == {}
    pictures.do(message=message(8))
    assert pictures.do(pass_ms=100, message=message(9))["shown"] == {"front": [9, pytest.approx(0.15)]}
