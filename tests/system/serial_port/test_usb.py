"""USB serial ports of a real kernel driver: pulled, plugged in under another number, and not listened to."""

import re
from typing import Any

import pynmea2
import pytest
from support.foreign import need_program
from support.guest import run_in_guest

pytestmark = pytest.mark.real_time

PLUGS = 2
GREETING = "\r\nActive Laser Target"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The log of the controllers in the guest."""
    need_program("mbpoll")
    need_program("setpriv", "util-linux")
    slow_bus = ("dummy_hcd.is_high_speed=0",)  # packets of 64 bytes, so that a telegram can be torn
    folder = tmp_path_factory.mktemp("usb")
    return run_in_guest(folder, "usb_serial.py", PLUGS, kernel_arguments=slow_bus, timeout_s=150.0).results


@pytest.fixture(scope="module")
def unplugged(seen: Any) -> Any:
    return seen["unplugged"]


def is_whole(line: str) -> bool:
    """Whether pynmea2, which this project did not write, takes the line."""
    try:
        pynmea2.parse(line, check=True)
    except pynmea2.ParseError:
        return False
    return True


def test_after_each_plug_there_are_whole_telegrams_only(unplugged: Any) -> None:
    assert len(unplugged["telegrams"]) == PLUGS + 1
    last_sequence = 0
    for heard in unplugged["telegrams"]:
        first, *lines, torn = heard.split("\r\n")
        assert first == ""  # end of the controller's buffer from before the plug was pulled
        assert len(lines) >= 2
        if is_whole(torn):  # torn within the two bytes of its end: it must be as true as the others
            lines.append(torn)
        for number, line in enumerate(lines):
            assert is_whole(line), line
            assert line.startswith("$PALTQ" if number % 2 else "$PALTM")
        sequences = [int(line.split(",")[1 if number % 2 else 3]) for number, line in enumerate(lines)]
        assert sequences[1::2] == sequences[0::2][: len(sequences) // 2]
        assert sequences[0] > last_sequence  # nothing old was kept for later
        assert sequences == sorted(sequences)
        last_sequence = sequences[-1]


def test_the_plug_was_pulled_while_telegrams_were_being_written(unplugged: Any) -> None:
    assert unplugged["counters"]["telegram"]["telegrams_dropped"] >= PLUGS
    torn = [heard.rpartition("\r\n")[2] for heard in unplugged["telegrams"][:-1]]
    assert any(torn)


def test_a_controller_that_reads_lines_loses_no_telegram_after_the_plug(unplugged: Any) -> None:
    """It knows of no plug: the torn line and what comes next are one stream to it."""
    lines = "".join(unplugged["telegrams"]).split("\r\n")
    torn = [line for line in lines[:-1] if line and not is_whole(line)]
    assert 0 < len(torn) <= PLUGS
    assert all("$" not in line[1:] for line in torn)


def test_a_pulled_port_is_told_at_once_and_served_soon_after_it_is_back(unplugged: Any) -> None:
    for number, plug in enumerate(unplugged["rounds"]):
        assert plug["failed_s"] < 1.0
        assert plug["served_s"] < 2.5
        assert plug["first_telegram_s"] < 3.0
        for message in plug["messages"].values():
            assert "unplugged" in message
        if number:
            before = unplugged["rounds"][number - 1]["names"]
            assert not set(plug["names"].values()) & set(before.values())  # every port has another number
    assert {counters["failures"] for counters in unplugged["counters"].values()} == {PLUGS}


def test_the_console_greets_again_and_has_forgotten_what_it_was_saying(unplugged: Any) -> None:
    assert len(unplugged["console"]) == PLUGS + 1
    for heard in unplugged["console"]:
        _, *greeted = heard.split(GREETING)  # before it: what lay at the far end when the plug was pulled
        assert len(greeted) == 1
        assert re.match(r"[^\r]*\. Type help and press Enter\.\r\n> measure\r\n", greeted[0])
    assert "answers_dropped" not in unplugged["counters"]["console"]


def test_modbus_answers_after_each_plug(unplugged: Any) -> None:
    values = [plug["value"] for plug in unplugged["rounds"]] + [unplugged["last_value"]]
    assert values == ["10.012"] * (PLUGS + 1)


def test_a_program_that_heeds_no_locks_is_kept_out(unplugged: Any) -> None:
    assert "resource busy" in unplugged["stranger"]


def test_controllers_that_take_nothing_hold_up_neither_the_unit_nor_its_end(seen: Any) -> None:
    stalled = seen["stalled"]
    assert "does not accept the telegrams" in stalled["messages"]["telegram"]
    assert stalled["counters"]["telegram"]["telegrams_dropped"] > 10
    assert stalled["counters"]["modbus_rtu"]["answers_dropped"] > 10
    assert stalled["slowest_s"] < 0.5
    assert stalled["stopped_s"] < 3.0  # cdc_acm holds a close for 30 s
    assert stalled["ended_s"] < 3.0
    assert stalled["status"] == 0
    assert seen["unplugged"]["slowest_s"] < 1.0
