"""An inclinometer's values in a measurement of the beam: on the board and on every interface."""

import json
import re
from dataclasses import replace

import pytest
from support.clock import FakeClock
from support.measurements import BEAM, beam_of, measurement

from altd.files.documents import line_of
from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.http.answers import page_of
from altd.publish.modbus.registers import REGISTERS, Snapshot, image
from altd.publish.serial.telegram import encode
from altd.publish.serial.words import measurement_text, watch_line
from altd.reasons import Reason
from altd.records import Measurement
from altd.records.sensors import Quality, SensorValue
from altd.status.board import Board
from altd.status.measurement_json import as_object

FITTED = QUANTITIES.with_sensor("roll_deg")
GOOD = SensorValue(Quality.GOOD, value=-1.25, sigma=0.08, t_ns=79 * 10**8, age_s=0.1, expires_ns=87 * 10**8)
FROZEN = SensorValue(Quality.FROZEN, "the same words for 0.8 s")
WARNS = [Reason.ROLL_MISSING]


def with_roll(said: SensorValue, *reasons: Reason) -> Measurement:
    plain = replace(measurement(160, 8_000_000_000, *reasons), quantities=FITTED)
    return plain.with_sensors({"roll_deg": said})


def reasons(shown: Measurement | None) -> list[Reason]:
    return [fault.reason for fault in shown.status]


def test_a_sensor_adds_its_value_and_leaves_the_beam_alone() -> None:
    both = with_roll(GOOD)
    assert (both.number("roll_deg"), both.sigma("roll_deg")) == (-1.25, 0.08)
    assert beam_of(both) == BEAM
    assert both.status == ()


def test_a_sensor_that_says_nothing_is_warned_of_and_the_beam_is_valid() -> None:
    both = with_roll(FROZEN)
    assert both.number("roll_deg") is both.sigma("roll_deg") is None
    assert both.valid
    assert beam_of(both) == BEAM
    assert [(str(fault), fault.detail) for fault in both.status] == [("roll_missing", FROZEN.detail)]


def test_a_sensor_that_speaks_again_takes_its_warning_back() -> None:
    again = with_roll(FROZEN, Reason.PLAYBACK).with_sensors({"roll_deg": GOOD})
    assert reasons(again) == [Reason.PLAYBACK]


def test_roll_stays_when_the_beam_is_blocked() -> None:
    blocked = with_roll(GOOD, Reason.SPOT_MISSING)
    assert not blocked.valid
    assert blocked.number("roll_deg") == -1.25
    assert blocked.number("x_mm") is None
    assert blocked.without_numbers(blocked.status).number("roll_deg") == -1.25


class TestBoard:
    def test_drops_roll_by_its_own_age_and_keeps_the_beam(self) -> None:
        clock = FakeClock(8_000_000_000)
        board = Board(clock, 1.0, FITTED, complete=lambda plain: plain.with_sensors({"roll_deg": GOOD}))
        board.publish(replace(measurement(), quantities=FITTED))
        clock.now_ns = GOOD.expires_ns
        assert board.read().number("roll_deg") == -1.25  # type: ignore[union-attr]
        clock.now_ns += 1
        old = board.read()
        assert old.number("roll_deg") is None
        assert old.from_sensors["roll_deg"].quality is Quality.OLD
        assert reasons(old) == WARNS
        assert beam_of(old) == BEAM
        assert board.read() is old  # interfaces recognise it

    def test_a_stale_measurement_drops_it_too(self) -> None:
        clock = FakeClock(8_000_000_000)
        late = replace(GOOD, expires_ns=9_500_000_000)
        board = Board(clock, 1.0, FITTED, complete=lambda plain: plain.with_sensors({"roll_deg": late}))
        board.publish(replace(measurement(), quantities=FITTED))
        clock.now_ns = 9_400_000_000
        assert reasons(board.read()) == [Reason.STALE]
        assert board.read().number("roll_deg") == -1.25  # type: ignore[union-attr]
        clock.now_ns = 9_600_000_000
        assert reasons(board.read()) == [*WARNS, Reason.STALE]
        assert board.read().number("roll_deg") is None  # type: ignore[union-attr]


class TestFaces:
    def test_json_has_value_sigma_age_and_quality(self) -> None:
        document = as_object(with_roll(GOOD))
        assert document["roll_deg"] == -1.25
        assert document["sigma"]["roll_deg"] == 0.08
        assert document["sensors"] == {"roll_deg": {"quality": "good", "age_s": 0.1}}

    def test_json_says_why_there_is_none(self) -> None:
        document = json.loads(line_of(as_object(with_roll(FROZEN))))
        assert document["roll_deg"] is document["sigma"]["roll_deg"] is None
        assert document["sensors"] == {"roll_deg": {"quality": "frozen", "age_s": None}}
        assert document["status"] == ["roll_missing"]
        assert document["valid"] is True

    def test_json_without_an_inclinometer_is_what_it_was(self) -> None:
        document = as_object(measurement())
        assert "sensors" not in document
        assert list(document["sigma"]) == ["x_mm", "y_mm", "yaw_deg", "pitch_deg"]

    @pytest.mark.parametrize("blocked", [(), (Reason.SPOT_MISSING,)])
    def test_registers_and_telegram_have_it_with_and_without_beam(self, blocked: tuple[Reason, ...]) -> None:
        shown = with_roll(GOOD, *blocked)
        words = image(Snapshot(shown, 0.1, 1))
        at = {row.name: row for row in REGISTERS if row.address < 60}["roll"].address
        assert words[at : at + 2] == [0xBFA0, 0x0000]  # -1.25, IEEE 754
        assert encode(shown).split(b"*")[0].endswith(b",-1.2500")

    def test_registers_say_not_known_when_there_is_none(self) -> None:
        words = image(Snapshot(with_roll(FROZEN), 0.1, 1))
        assert words[32:34] == [0x7FC0, 0x0000]
        assert words[0] == 1  # valid, and no bit of another reason

    def test_the_console_shows_it_whether_or_not_the_beam_is_seen(self) -> None:
        assert "  roll      -1.2500 deg +/- 0.0800" in measurement_text(with_roll(GOOD)).splitlines()
        blocked = measurement_text(with_roll(GOOD, Reason.SPOT_MISSING)).splitlines()
        assert blocked[1:3] == ["  NOT VALID", "  roll      -1.2500 deg +/- 0.0800"]
        assert "  roll      not available" in measurement_text(with_roll(FROZEN)).splitlines()
        assert "the same words for 0.8 s" in measurement_text(with_roll(FROZEN))

    def test_watch_keeps_its_columns_and_says_that_there_is_none(self) -> None:
        assert watch_line(with_roll(GOOD)) == watch_line(measurement())
        assert watch_line(with_roll(FROZEN)).endswith(" roll_missing")

    def test_the_page_has_a_row_for_it_where_an_inclinometer_is_fitted(self) -> None:
        shown = '"key": "roll_deg".*"is_shown": true'
        assert re.search(shown, page_of(FITTED))
        assert not re.search(shown, page_of(QUANTITIES))
