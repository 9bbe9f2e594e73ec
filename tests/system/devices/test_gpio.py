"""The GPIO driver on the kernel's own simulated chips; the levels are read at the pins."""

from typing import Any

import pytest
from support.guest import run_in_guest
from support.places import ROOT

UNIT = ROOT / "systemd" / "altd.service"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    found: dict[str, Any] = run_in_guest(tmp_path_factory.mktemp("gpio"), "gpio_driver.py").results
    return found


def test_frame_leds_switch_together_dark_from_opening_to_closing(seen: dict[str, Any]) -> None:
    pulled = [0, 1]  # levels of pins that are not driven
    assert seen["frame, active_low False"] == {
        "before": pulled,
        "opened": [0, 0],
        "lit": [1, 1],
        "dark": [0, 0],
        "lit again": [1, 1],
        "closed": pulled,
    }


def test_active_low_leds_are_lit_by_the_low_level(seen: dict[str, Any]) -> None:
    levels = seen["frame, active_low True"]
    assert [levels[step] for step in ("opened", "lit", "dark")] == [[1, 1], [0, 0], [1, 1]]


def test_others_see_who_holds_the_lines(seen: dict[str, Any]) -> None:
    assert seen["consumers"] == ["altd", "altd"]


def test_one_glass_is_without_voltage_and_from_opening_to_closing_none_else(seen: dict[str, Any]) -> None:
    assert seen["glasses"] == {
        "opened": [0, 0],
        "t1": [0, 1],
        "t2": [1, 0],
        "": [0, 0],
        "closed": [0, 1],  # the pins' own levels
    }


def test_indicators_shine_each_by_itself(seen: dict[str, Any]) -> None:
    assert seen["indicators"] == {
        "": [0, 0, 0, 0],
        "ok power": [0, 0, 1, 1],
        "error": [0, 1, 0, 0],
        "data error power ok": [1, 1, 1, 1],
    }


def test_an_indicator_without_a_line_is_left_out(seen: dict[str, Any]) -> None:
    assert seen["some indicators"] == [0, 1, 0, 0]


def test_a_line_without_a_name_is_found_by_its_number(seen: dict[str, Any]) -> None:
    assert seen["by number"] == [None, None, "altd"]


def test_the_inventory_names_chips_lines_and_who_holds_them(seen: dict[str, Any]) -> None:
    lines = ["LED_A", "LED_B", "DATA", "ERROR", "POWER", "OK", "TWICE", "TWICE"]
    assert seen["inventory"] == [["gpiochip0", "unit", lines], ["gpiochip1", "plain", ["", "", ""]]]
    assert seen["inventory while taken"] == [None, "blinker", *[None] * 6]


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("taken", "GPIO chip 'unit' (/dev/gpiochip0): 'LED_B' taken by 'blinker'"),
        (
            "no chip",
            "no GPIO chip 'units', those that can be opened: 'unit' (gpiochip0), 'plain' (gpiochip1)",
        ),
        ("no path", "there is no /dev/gpiochip77"),
        ("no chip at the path", "/dev/null is not a GPIO chip"),
        (
            "no line",
            "GPIO chip 'unit' (/dev/gpiochip0) has no line 'LED_C', its lines: "
            "'LED_A', 'LED_B', 'DATA', 'ERROR', 'POWER', 'OK', 'TWICE', 'TWICE'",
        ),
        (
            "no line without names",
            "GPIO chip 'plain' (/dev/gpiochip1) has no line 'LED_A', its lines: "
            "3 without names, give the number, from 0",
        ),
        (
            "number too high",
            "GPIO chip 'plain' (/dev/gpiochip1) has no line '3', its lines: "
            "3 without names, give the number, from 0",
        ),
        (
            "two of a name",
            "GPIO chip 'unit' (/dev/gpiochip0) has 2 lines 'TWICE': give the number, one of 6, 7",
        ),
        (
            "the same line twice",
            "GPIO chip 'unit' (/dev/gpiochip0): two of the lines 'LED_A', '0' are the same",
        ),
        ("not open", "GPIO chip 'unit': its lines are not open"),
        (
            "root alone",
            "no permission to open /dev/gpiochip0, which is for root only: see docs/selfcheck.md",
        ),
        (
            "for a group",
            "no GPIO chip 'unit', those that can be opened: none; "
            "no permission to open /dev/gpiochip0, which is for group video; "
            "no permission to open /dev/gpiochip1, which is for root only: see docs/selfcheck.md",
        ),
        ("gone", "GPIO chip 'unit' (/dev/gpiochip0) is gone"),
        ("while gone", "no GPIO chip 'unit', those that can be opened: 'plain' (gpiochip1)"),
    ],
)
def test_what_cannot_be_had_is_said_in_a_sentence(seen: dict[str, Any], case: str, words: str) -> None:
    assert seen[case] == words


def test_the_service_may_use_chips_by_the_name_that_the_kernel_gives_them(seen: dict[str, Any]) -> None:
    assert "gpiochip" in seen["devices"]
    assert "\nDeviceAllow=char-gpiochip rw\n" in UNIT.read_text()


def test_a_chip_that_went_away_is_found_again_by_its_label(seen: dict[str, Any]) -> None:
    assert seen["back"] == [[1, 1], True]
