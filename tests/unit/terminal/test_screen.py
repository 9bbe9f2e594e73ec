"""The screen of `altd watch`: exact for made-up data, whole on any size, and empty of what is not known."""

import itertools
import re
from pathlib import Path
from typing import Any

import pytest
from support.daemon_documents import CHECK, DUSTY, SPOT_MISSING, TARGETS, invalid, measurement, status

from altd.instruments.beam.instrument import QUANTITIES
from altd.terminal.canvas import Canvas, Style
from altd.terminal.documents import (
    CalibrationDocument,
    SelfCheckDocument,
    StatusDocument,
    TargetsDocument,
    checked,
    reading_of,
)
from altd.terminal.knowledge import HOLD_S, Knowledge
from altd.terminal.lines import status_text
from altd.terminal.screen import PAGES, ScreenView, draw

LAST_S = 1059.0


def hear(knowledge: Knowledge, document: dict[str, Any], now_s: float) -> None:
    knowledge.set_reading(reading_of(document, QUANTITIES), now_s)


def after_a_minute() -> Knowledge:
    """At ``LAST_S`` the front spot is at x 35, y -27.5 mm; each second before, 3 mm to the left."""
    knowledge = Knowledge()
    knowledge.set_documents(checked(SelfCheckDocument, CHECK), checked(TargetsDocument, TARGETS))
    for second in range(60):
        back = second - 59
        place = {"x_mm": 35.0123 + 3 * back, "y_mm": -27.5}
        lost = 20 <= second < 30
        seen = measurement(x_mm=35.0123 + 0.1 * back, front=place)
        document = invalid("rear_spot_missing") if lost else seen
        hear(knowledge, document, 1000.0 + second)
    state = status(SPOT_MISSING, DUSTY, signal="out_of_specification")
    knowledge.set_status(checked(StatusDocument, state), LAST_S)
    return knowledge


def screen(
    knowledge: Knowledge,
    now_s: float,
    rows: int = 24,
    columns: int = 80,
    *,
    utf8: bool = False,
    page: int = 0,
) -> str:
    canvas = Canvas(rows, columns, is_utf8=utf8)
    draw(knowledge, now_s, ScreenView(page), canvas)
    return canvas.text()


CHECKED = checked(SelfCheckDocument, CHECK)
SCREENS = Path(__file__).with_name("screens")
"""Checked by eye; ``test_the_spot_stands_where_…`` checks the places of spots in them by arithmetic."""


def test_the_page_of_targets_is_this_one_to_the_character() -> None:
    assert screen(after_a_minute(), LAST_S + 0.2) + "\n" == (SCREENS / "targets-ascii.txt").read_text()
    shown = screen(after_a_minute(), LAST_S + 0.2, utf8=True) + "\n"
    assert shown == (SCREENS / "targets-utf8.txt").read_text()


def test_the_spot_stands_where_the_scale_puts_it() -> None:
    """39 x 10 cells hold 1.04 · 110 mm in height: 2.86 mm a dot, 5.72 mm a column, 11.44 mm a row."""
    lines = screen(after_a_minute(), LAST_S).split("\n")
    row, column = 3 + 5 - round(-27.5 / 11.44 - 0.5) - 1, int(39 / 2 + 35.0 / 5.72)
    assert lines[row][column] == "O"
    row, column = 3 + int(5 - 13.75 / 11.44), 40 + int(39 / 2 - 36.0 / 5.72)
    assert lines[row][column] == "O"


@pytest.mark.parametrize("page", range(len(PAGES)))
@pytest.mark.parametrize("utf8", [False, True])
def test_it_is_drawn_on_any_size(page: int, utf8: bool) -> None:
    knowledge = after_a_minute()
    for rows in (1, 2, 3, 5, 15, 16, 17, 24, 50, 120):
        for columns in (1, 2, 20, 59, 60, 80, 200, 500):
            lines = screen(knowledge, LAST_S, rows, columns, utf8=utf8, page=page).split("\n")
            assert len(lines) == rows
            assert max(map(len, lines)) <= columns
            assert utf8 or all(line.isascii() for line in lines)


MEASURED = {
    "-2345.678", "0.947", "4.894", "-2342.837", "-2348.519",
    "871.246", "0.616", "5.649", "873.094", "869.398",
    "47.1459", "0.0711", "0.0796", "47.3592", "46.9326", "498.456",
    "-13.7184", "0.0617", "0.0955", "-13.5333", "-13.9035", "-244.177",
    "41.37", "-23.56", "-36.48", "44.75",
}  # fmt: skip
"""Value, sigma, sigma_now, value plus and minus three sigma, in mm/m; the spots."""

FURTHER = {"20", "0.5", "2", "3", "60", "99.99", "31", "0.08", "1", "0.1.0", "2026", "-11", "-02", "-20"} | {
    "08", "10", "00.000"
}  # fmt: skip
"""Exposures, age, durations, the window's columns, availability, the dust, lines and components, times."""


def numbers_on(text: str) -> set[str]:
    text = text.replace("ALT-0007", "").replace("60 x 16 at", "60 x")
    text = re.sub(r"trend of the last \d+ s$|lines 1 to \d+ of \d+: up, down$", "", text, flags=re.MULTILINE)
    return set(re.findall(r"[-+]?\d[\d.]*(?<!\.)", text))


@pytest.mark.parametrize("rows", range(6, 41))
def test_a_number_is_whole_or_absent_on_any_size(rows: int) -> None:
    place = {"front": {"x_mm": 41.37, "y_mm": -23.56}, "rear": {"x_mm": -36.48, "y_mm": 44.75}}
    document = measurement(
        x_mm=-2345.678, y_mm=871.246, yaw_deg=47.1459, pitch_deg=-13.7184, yaw_mm_per_m=498.456,
        pitch_mm_per_m=-244.177,
        sigma={"x_mm": 0.947, "y_mm": 0.616, "yaw_deg": 0.0711, "pitch_deg": 0.0617},
        sigma_now={"x_mm": 4.894, "y_mm": 5.649, "yaw_deg": 0.0796, "pitch_deg": 0.0955},
        **place,
    )  # fmt: skip
    knowledge = Knowledge()
    knowledge.set_documents(checked(SelfCheckDocument, CHECK), checked(TargetsDocument, TARGETS))
    hear(knowledge, document, LAST_S)
    document = status(SPOT_MISSING, DUSTY, signal="out_of_specification")
    knowledge.set_status(checked(StatusDocument, document), LAST_S)
    for page, columns in itertools.product(range(len(PAGES)), range(20, 101)):
        text = screen(knowledge, LAST_S, rows, columns, utf8=columns % 2 == 0, page=page)
        assert not numbers_on(text) - MEASURED - FURTHER, text


def test_a_part_of_a_number_is_no_other_number() -> None:
    """Else the test above would not notice it."""
    parts = {number[:end].rstrip(".") for number in MEASURED for end in range(1, len(number))}
    parts |= {number[begin:].lstrip(".") for number in MEASURED for begin in range(1, len(number) - 1)}
    assert not parts & (MEASURED | FURTHER)


@pytest.mark.parametrize("page", range(len(PAGES)))
def test_what_was_known_is_gone_when_nobody_answers(page: int) -> None:
    """The daemon hangs: no error comes, only time passes."""
    knowledge = after_a_minute()
    assert "ALT-0007" in screen(knowledge, LAST_S + HOLD_S, page=page)
    gone = screen(knowledge, LAST_S + HOLD_S + 0.01, page=page)
    assert gone.startswith("NO CONNECTION: nothing is known of the unit now\nthe daemon does not answer; ")
    for known in ("35.012", "VALID", "ALT-0007", "SPECIFICATION", "dust", "good", "O  ", "2 h 3 min"):
        assert known not in gone
    assert HOLD_S < 2.0


@pytest.mark.parametrize("page", range(len(PAGES)))
def test_it_is_gone_at_once_when_the_daemon_ends_and_back_when_it_answers(page: int) -> None:
    knowledge = after_a_minute()
    knowledge.set_lost("the daemon is not running: nothing listens at /run/altd/altd.sock")
    gone = screen(knowledge, LAST_S, page=page)
    why = "the daemon is not running: nothing listens at /run/altd/altd.sock; it is asked again and again"
    assert " ".join(gone.split("\n")[1:3]) == why
    assert not any(known in gone for known in ("35.012", "VALID", "ALT-0007", "dust"))
    hear(knowledge, measurement(), LAST_S + 1)
    back = screen(knowledge, LAST_S + 1, page=page)
    assert "VALID, 0.5 s old" in back
    assert "the unit's state is not known" in back, "that was not heard of since"
    assert not any(known in back for known in ("dust", "99.99"))


def test_an_invalid_measurement_shows_no_number_and_no_spot() -> None:
    knowledge = after_a_minute()
    hear(knowledge, invalid("rear_spot_missing"), LAST_S)
    text = screen(knowledge, LAST_S)
    assert "NOT VALID: rear_spot_missing" in text
    assert "front: camera ok, not measured" in text
    assert "rear: no laser spot" in text
    assert not any(known in text for known in ("35.01", "0.004", "0.029", "O  ", "O.", ":::"))


def test_each_target_names_its_own_camera() -> None:
    knowledge = after_a_minute()
    hear(knowledge, invalid("front_camera_silent"), LAST_S)
    text = screen(knowledge, LAST_S)
    assert "front: the camera delivers no frames" in text
    assert "rear: no spot known" in text, "nothing is known of the rear camera"
    rear = {"state": "failed", "message": "lost: no such device", "for_s": 3.0}
    knowledge.set_status(checked(StatusDocument, status(**{"camera rear": rear})), LAST_S)
    assert "rear: camera failed: lost: no such" in screen(knowledge, LAST_S)


def test_a_degree_is_never_a_question_mark() -> None:
    knowledge = after_a_minute()
    hot = SPOT_MISSING | {"detail": "camera front: 61.0°"}
    knowledge.set_status(checked(StatusDocument, status(hot, signal="failure")), LAST_S)
    page = next(number for number, (name, _) in enumerate(PAGES) if name == "causes")
    assert "61.0 deg]" in screen(knowledge, LAST_S, page=page, utf8=False)
    assert "61.0°]" in screen(knowledge, LAST_S, page=page, utf8=True)


def test_before_the_first_measurement_it_says_so() -> None:
    knowledge = Knowledge()
    assert "no answer so far" in screen(knowledge, 0.0)
    hear(knowledge, {"error": "nothing was measured", "status": ["warming_up"]}, 1.0)
    assert "NOT VALID: nothing has been measured yet" in screen(knowledge, 1.0)


@pytest.mark.parametrize("code", ["simulated", "playback"])
def test_numbers_that_are_not_of_now_are_not_called_valid(code: str) -> None:
    """A technician who looks at a recording must not take it for the unit's beam."""
    knowledge = after_a_minute()
    hear(knowledge, measurement(status=["exposures_lost", code]), LAST_S)
    canvas = Canvas(24, 80, is_utf8=False)
    draw(knowledge, LAST_S, ScreenView(), canvas)
    (text, style), *_ = canvas.runs()[1]
    assert text.startswith(f"{code.upper()}, 0.5 s old, mean of 20 exposures; exposures_lost, {code}")
    assert style is Style.WARNING
    reading = reading_of(measurement(status=[code]), QUANTITIES)
    shown = status_text(reading, checked(StatusDocument, status()), CHECKED, CalibrationDocument())
    assert f"measuring    {code.upper()}, 0.50 s old" in shown


def test_the_age_grows_between_two_answers() -> None:
    assert "VALID, 1.7 s old" in screen(after_a_minute(), LAST_S + 1.2)


def test_another_unit_has_another_past() -> None:
    knowledge = after_a_minute()
    knowledge.set_status(checked(StatusDocument, status() | {"serial": "ALT-0008"}), LAST_S + 1)
    hear(knowledge, measurement(), LAST_S + 1)
    assert knowledge.trend("x_mm", LAST_S + 1, 60, 1.0)[:-1] == [None] * 59


def test_a_value_of_a_sensor_is_shown_though_the_beam_is_lost() -> None:
    knowledge = after_a_minute()
    document = invalid("front_spot_missing") | {"roll_deg": 0.12345}
    document["sigma"] = document["sigma"] | {"roll_deg": 0.002}
    hear(knowledge, document, LAST_S)
    assert "roll       0.1235 deg +/- 0.0020" in screen(knowledge, LAST_S)


class TestView:
    def test_tab_and_arrows_go_round(self) -> None:
        view = ScreenView()
        for key in ("tab", "right", "right"):
            view = view.pressed(key)
        assert view == ScreenView(3)
        assert view.pressed("tab") == ScreenView(0) == ScreenView(1).pressed("left")
        assert ScreenView(0).pressed("left") == ScreenView(3)

    def test_help_is_left_by_any_key(self) -> None:
        helped = ScreenView(2).pressed("h")
        assert helped.help
        for key in ("h", "x", "tab", "?"):
            assert helped.pressed(key) == ScreenView(2)

    def test_a_list_is_moved_no_further_than_its_last_screen(self) -> None:
        parts: dict[str, Any] = {
            f"part {number:02d}": {"state": "ok", "message": "", "for_s": 1.0} for number in range(60)
        }
        knowledge = Knowledge()
        hear(knowledge, measurement(), 0.0)
        knowledge.set_documents(checked(SelfCheckDocument, CHECK), checked(TargetsDocument, TARGETS))
        knowledge.set_status(checked(StatusDocument, status(**parts)), 0.0)
        view = ScreenView(3)
        for _ in range(500):
            view = draw(knowledge, 0.0, view.pressed("down"), Canvas(24, 80, is_utf8=False))
        canvas = Canvas(24, 80, is_utf8=False)
        view = draw(knowledge, 0.0, view, canvas)
        assert "part 59" in canvas.text()
        assert "part 30" not in canvas.text()
        up = Canvas(24, 80, is_utf8=False)
        draw(knowledge, 0.0, view.pressed("up"), up)
        assert "part 59" not in up.text()


def test_a_hundred_causes_leave_the_keys_in_sight() -> None:
    cause = {
        "code": "stale", "signal": "failure", "of": None, "active": True, "for_s": 1.0, "times": 1,
        "brief": "no new measurement", "remedy": "look", "detail": "",
    }  # fmt: skip
    knowledge = after_a_minute()
    knowledge.set_status(checked(StatusDocument, status(*[cause] * 100, signal="failure")), LAST_S)
    lines = screen(knowledge, LAST_S).split("\n")
    assert lines[-1].startswith("tab, arrows: [targets]")
    assert lines[-2] == "... more on the page of causes"
    assert sum("O" in line[:80] for line in lines[3:14]) >= 1
