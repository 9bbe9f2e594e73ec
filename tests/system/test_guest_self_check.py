"""The whole daemon checks itself in a guest, by LEDs on lines of the kernel's GPIO simulator.

The daemon's own driver switches them; the pictures of two v4l2loopback cameras show LEDs as the pins are.
"""

from pathlib import Path
from typing import Any

import pytest
from support.fed_unit import render_with_leds, write_config
from support.guest import run_in_guest
from support.held import OF_LATE_FRAMES

pytestmark = pytest.mark.real_time

SEED = 3
FPS = 20
EXPOSURES = 160
"""More than altd remembers: they are fed again and again, and none is to be taken for a frozen camera's."""
LAMPS = """
[lamps]
driver = "gpiod"
chip = "unit"
lines = ["LED_A", "LED_B"]
"""


@pytest.fixture(scope="module")
def seen(unit_3: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("unit")
    run = run_in_guest(
        tmp_path_factory.mktemp("self_check"),
        "self_check.py",
        write_config(folder / "altd.toml", SEED, unit_3 / "cal.json", FPS, LAMPS),
        render_with_leds(SEED, folder, EXPOSURES),
        FPS,
        kernel_arguments=("v4l2loopback.devices=2", "v4l2loopback.max_buffers=8"),
        timeout_s=400,
    )
    return run.results


def test_is_good_at_the_start(seen: Any) -> None:
    check = seen["start"]["components"]["self-check"]
    assert (check["state"], check["message"]) == ("ok", "good")
    assert check["checks_good"] == 1
    assert check["exposures_lost"] > 0


def test_names_leds_that_stay_dark_though_their_lines_are_set(seen: Any) -> None:
    check = seen["cut"]["check"]
    assert check["verdict"] == "unknown"
    for target in ("front", "rear"):
        assert check["targets"][target]["leds"] == ["dark"] * 6
        assert f"{target}: no LED can be used; LED 1, 2, 3, 4, 5, 6: dark" in check["reasons"]
    assert all("geometry_unknown" in status for status in seen["cut"]["measured"])
    assert seen["cut"]["status"]["components"]["lamps"]["state"] == "ok", "as far as the chip knows"


def test_names_a_chip_that_went_away(seen: Any) -> None:
    message = seen["unplugged"]["components"]["lamps"]["message"]
    assert message.startswith("GPIO chip 'unit' (/dev/gpiochip")
    assert ") is gone" in message


USUAL = {"simulated", "rehearsal", "exposures_lost"}


def test_names_who_has_taken_a_line_away(seen: Any) -> None:
    check = seen["taken"]["check"]
    assert check["verdict"] == "unknown"
    (reason,) = check["reasons"]
    assert reason.startswith("the frame LEDs could not be switched: GPIO chip 'unit' (")
    assert "'LED_A' taken by 'torch'" in reason
    assert check["exposures_lost"] == 0
    assert all("geometry_unknown" in status for status in seen["taken"]["measured"])


def test_is_good_again_once_the_lines_are_back(seen: Any) -> None:
    check, measured = seen["back"]["check"], [set(status) for status in seen["back"]["measured"]]
    assert (check["verdict"], check["reasons"]) == ("good", [])
    assert [check["targets"][target]["leds_found"] for target in ("front", "rear")] == [6, 6]
    assert [status for status in measured if not status <= USUAL | OF_LATE_FRAMES] == []
    assert any(status <= USUAL for status in measured)


def test_measures_all_the_while(seen: Any) -> None:
    assert seen["alive"]
    assert len(seen["measured"]) > 100
    invalid = [set(status) for valid, status in seen["measured"] if not valid]
    assert len(invalid) < 0.5 * len(seen["measured"])
    assert all(status & OF_LATE_FRAMES for status in invalid)
    assert not {"geometry_drift", "geometry_unverified"} & set().union(*invalid)
