"""Pictures, trends and lines of text, each against what can be said of it beforehand."""

import pytest
from support.daemon_documents import CALIBRATION, CHECK, TARGETS, measurement, status

from altd.instruments.beam.instrument import QUANTITIES
from altd.terminal.canvas import Canvas, PlotCells, draw_target, draw_trend, half_size_mm, limits_of, rows_for
from altd.terminal.documents import (
    CalibrationDocument,
    SelfCheckDocument,
    ShownBeam,
    StatusDocument,
    TargetsDocument,
    checked,
    reading_of,
)
from altd.terminal.lines import WIDTH, is_healthy, self_check_table, status_text


@pytest.fixture
def targets() -> TargetsDocument:
    return checked(TargetsDocument, TARGETS)


class TestPicture:
    def test_it_is_to_scale_in_both_directions(self, targets: TargetsDocument) -> None:
        """A cell is twice as high as wide: 10 mm to the right are as far as 10 mm upwards."""
        frame = PlotCells.holding(targets, 0, 0, 40, 100)
        zero, right, up = (frame.dot_of(place) for place in ((0.0, 0.0), (50.0, 0.0), (0.0, 50.0)))
        assert right[0] - zero[0] == pytest.approx(zero[1] - up[1], abs=1)  # a dot is a whole one
        assert right[0] - zero[0] == pytest.approx(50.0 / frame.mm_per_dot, abs=1)
        assert right[1] == zero[1]
        assert up[0] == zero[0]

    @pytest.mark.parametrize("cells", [(40, 100), (10, 39), (24, 20), (3, 200)])
    def test_every_corner_lies_inside(self, targets: TargetsDocument, cells: tuple[int, int]) -> None:
        frame = PlotCells.holding(targets, 5, 7, *cells)
        assert half_size_mm(targets) == (72 * 1.04, 55 * 1.04)
        assert all(frame.holds(corner) for target in targets.targets for corner in target.valid_mm)
        assert all(frame.holds((x, y)) for x in (-70, 70) for y in (-55, 55))

    def test_a_picture_takes_the_rows_that_its_width_asks_for(self, targets: TargetsDocument) -> None:
        assert rows_for(targets, 72) == 28  # 72 columns are 144 dots for 144 mm: 110 dots are 27.5 rows

    def test_what_lies_outside_is_not_drawn_at_a_wrong_place(self, targets: TargetsDocument) -> None:
        shown = []
        for spot in (None, (500.0, 0.0), (0.0, -1e300)):
            canvas = Canvas(20, 60, is_utf8=True)
            draw_target(
                canvas, PlotCells.holding(targets, 2, 2, 16, 50), targets, "front", [(1e9, 0.0)], spot
            )
            shown.append(canvas.text())
        assert shown[0] == shown[1] == shown[2]
        assert "O" not in shown[0]

    def test_up_is_up_and_right_is_right(self, targets: TargetsDocument) -> None:
        frame = PlotCells.holding(targets, 0, 0, 20, 60)
        row, column = frame.cell_of((30.0, 20.0))
        assert (row < 10, column > 30) == (True, True)


class TestTrend:
    @pytest.mark.parametrize(
        ("rows", "is_utf8", "values", "shown"),
        [
            (1, True, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "▁▂▃▄▅▆▇█"),
            (2, True, [0.0, 1.0, 0.5], " █▁\n▁██"),
            (2, False, [0.0, None, 1.0], "  #\n# #"),
            (1, True, [None, None, None], ""),
        ],
        ids=["each level is an eighth of a row", "filled from below", "ASCII", "never known"],
    )
    def test_is_drawn(self, rows: int, is_utf8: bool, values: list[float | None], shown: str) -> None:
        canvas = Canvas(rows, len(values), is_utf8=is_utf8)
        draw_trend(canvas, 0, 0, rows, values, None)
        assert canvas.text() == shown

    def test_noise_is_not_blown_up_to_motion(self) -> None:
        """Values within one sigma fill a sixth of the height at most."""
        assert limits_of([], None) is None
        low, high = limits_of([1.0, 1.004], 0.004) or (0.0, 0.0)
        assert high - low == pytest.approx(6 * 0.004)
        assert (low + high) / 2 == pytest.approx(1.002)

    @pytest.mark.parametrize("values", [[3.0, 3.0], [1e9, -1e9], [5e-324, 0.0]])
    def test_any_numbers_that_a_document_may_hold_can_be_drawn(self, values: list[float]) -> None:
        canvas = Canvas(3, 2, is_utf8=True)
        draw_trend(canvas, 0, 0, 3, values, None)
        assert canvas.text().strip()


def reading(**changes: object) -> ShownBeam:
    found = reading_of(measurement(**changes), QUANTITIES)
    assert found is not None
    return found


class TestStatus:
    def test_it_is_this_text(self) -> None:
        check = checked(
            SelfCheckDocument,
            {"verdict": None, "reasons": ["there was no self-check since the unit started"]},
        )
        laser = {"state": "failed", "message": "lost: no such thing", "for_s": 3.0}
        assert (
            status_text(
                reading(),
                checked(StatusDocument, status(laser=laser)),
                check,
                checked(CalibrationDocument, CALIBRATION),
            )
            == """\
unit         ALT-0007, altd 0.1.0, calibration 2026-11-02, workshop, stage 2
state        good for 2 h 3 min

measuring    VALID, 0.50 s old, mean of 20 exposures, number 160,
             2026-11-20T08:15:30.125Z
  x          35.012 mm  +/- 0.004    now 0.029
  y         -27.500 mm  +/- 0.004    now 0.015
  yaw        1.1459 deg +/- 0.0011   now 0.0020  =    20.002 mm/m
  pitch     -1.7184 deg +/- 0.0011   now 0.0016  =   -30.001 mm/m

cross-check  front: spot at u 234.95 v 350.05 px, x 35.011 y -27.498 mm by the
             second map
             rear: spot at u 231.45 v 185.05 px, x -35.998 y 13.752 mm by the
             second map
             yaw 1.1475 pitch -1.7169 deg by the second maps

available    99.99 % of the last hour; 99.99 % of the last day; 99.99 % of the
             last 31 days
operated     812.5 h
self-check   none: there was no self-check since the unit started
calibration  front: rms 0.021 px, largest residual 0.012 mm, with flat
             rear: largest residual 0.010 mm, without flat

component  state     for
laser      failed    3.0 s
    lost: no such thing
ok           camera front, measuring"""
        )

    @pytest.mark.parametrize(
        ("valid", "signal", "fine"),
        [
            (True, "good", True),
            (True, "maintenance_required", True),
            (True, "check_function", False),
            (True, "out_of_specification", False),
            (True, "failure", False),
            (False, "good", False),
        ],
    )
    def test_fine_is_who_may_be_used(self, valid: bool, signal: str, fine: bool) -> None:
        assert is_healthy(reading(valid=valid), checked(StatusDocument, status(signal=signal))) is fine
        assert not is_healthy(None, checked(StatusDocument, status()))

    def test_a_self_check_is_this_table(self) -> None:
        part = {"of": "rear", "verdict": "bad", "unit": "mm", "error": 0.13755, "sigma": 0.00153}
        limits = {"suspect": 0.03, "bad": 0.1}
        lit = CHECK["targets"]["front"]
        leds = [*["always_lit"] * 3, "dark", "used", "used"]
        stuck = lit | {"leds_found": 2, "leds": leds, "detail": "2 of 6 LEDs can be used"}
        document = {
            "verdict": "bad",
            "reasons": ["rear: moved by up to 0.138 °", "front: 2 of 6 LEDs can be used"],
            "parts": [
                {**part, **limits},
                {**part, **limits, "of": "front", "error": None, "verdict": "unknown"},
            ],
            "targets": {"rear": lit, "front": stuck},
            "notes": ["front: another light"],
            "origin": "simulated",
        }
        assert (
            "\n".join(self_check_table(checked(SelfCheckDocument, document)))
            == """\
check        verdict  good if   bad if   value, +/- 1 sigma
LEDs rear    good     >= 3               6 of 6 used
LEDs front   unknown  >= 3               2 of 6 used, 3 always lit, 1 dark
drift rear   bad      <= 0.03   > 0.1    0.1376 +/- 0.0015 mm
drift front  unknown  <= 0.03   > 0.1    not known

verdict  BAD: check cameras and targets for a blow or loose screws; then
         calibrate the unit again
  - rear: moved by up to 0.138 °
  - front: 2 of 6 LEDs can be used
  - front: another light
judged from SIMULATED frames"""
        )

    def test_no_line_is_wider_than_a_screen(self) -> None:
        parts = {"serial /dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A10K1XYZ-if00-port0": {"x" * 90: 1}}
        components = {name: {"state": "degraded", "message": "m" * 300, "for_s": 1e9} for name in parts}
        check = checked(SelfCheckDocument, {"verdict": "bad", "reasons": ["v" * 200]})
        calibration = checked(CalibrationDocument, CALIBRATION)
        text = status_text(reading(), checked(StatusDocument, status(**components)), check, calibration)
        assert max(map(len, text.split("\n"))) <= WIDTH < 80
