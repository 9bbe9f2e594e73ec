"""The register table against what the page promises; decoding is struct's, not the product's."""

import math
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.modbus_wire import Measured

from altd.instruments.beam.instrument import QUANTITIES as OF_BEAM
from altd.instruments.beam.solver import Beam
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.publish.modbus.registers import Type, image
from altd.publish.modbus.values import REASON_CODES, STATUS_BITS
from altd.reasons import Reason, StatusGroup
from altd.records import Fault, Measurement, Value
from tools.pages.example import MEASURED, view_of


def decode(words: list[int], address: int, layout: str) -> Any:
    """A value of a register image, big-endian."""
    size = struct.calcsize(layout) // 2
    (value,) = struct.unpack(f">{layout}", struct.pack(f">{size}H", *words[address : address + size]))
    return value


def floats(words: list[int]) -> list[float]:
    return [decode(words, address, "f") for address in range(20, 50, 2)]


def integers(words: list[int]) -> list[int]:
    return [decode(words, address, "i") for address in range(60, 90, 2)]


def read(measurement: Measurement | None, age_s: float | None = 0.52, published: int = 1) -> list[int]:
    return image(view_of(measurement, age_s, published))


def test_a_valid_measurement_reads_as_it_was_measured(measured: Measured) -> None:
    words = read(measured(roll_deg=0.25), published=141)

    expected = [
        *(10.012, 4.987, 1.1459, -1.7184, 1000 * math.tan(math.radians(1.1459))),
        *(1000 * math.tan(math.radians(-1.7184)), 0.25, 0.004, 0.005, 0.0011, 0.0012),
        *(10.012, 4.987, 15.613, -3.413),
    ]
    assert floats(words) == pytest.approx(expected, rel=1e-7)
    assert integers(words) == [round(10_000 * value) for value in expected]
    assert words[0] == 1, "valid and nothing else"
    assert words[2:5] == [0, 0, 0]
    assert words[5] == 141
    assert words[6] == 520
    assert words[7] == 20
    assert decode(words, 8, "I") == 160
    assert decode(words, 10, "I") == 1_795_162_530
    assert words[12] == 125
    assert words[14] == 1


def test_the_test_registers_never_change(measured: Measured) -> None:
    for words in (read(None), read(measured())):
        assert decode(words, 100, "f") == pytest.approx(123.456, rel=1e-7)
        assert words[102:104] == [0x1234, 0x5678]
        assert decode(words, 104, "i") == -123_456_789
        assert words[106] == 0xABCD


def test_before_the_first_measurement_nothing_is_known() -> None:
    words = read(None, age_s=None, published=0)
    assert words[0] == 0b10
    assert words[2:5] == [Reason.WARMING_UP.modbus_code, 0, 0]
    assert words[5] == 0
    assert words[6:8] == [0xFFFF, 0xFFFF]
    assert words[8:13] == [0xFFFF] * 5
    assert all(math.isnan(value) for value in floats(words))
    assert set(integers(words)) == {-0x8000_0000}


def test_an_invalid_measurement_shows_no_number_but_what_is_known(measured: Measured) -> None:
    words = read(
        measured(
            beam=None,
            points_mm={"front": (1.0, -2.0), "rear": None},
            status=(Fault(Reason.SPOT_MISSING, "rear"),),
        )
    )
    assert words[0] == 1 << 9
    assert words[2:5] == [0, 0, 1]
    values = floats(words)
    assert values[11:13] == [1.0, -2.0]
    assert all(math.isnan(value) for value in values[:11] + values[13:])
    scaled = integers(words)
    assert scaled[11:13] == [10_000, -20_000]
    assert set(scaled[:11] + scaled[13:]) == {-0x8000_0000}


def test_unknown_time_is_all_ones(measured: Measured) -> None:
    assert read(measured(time=None))[10:13] == [0xFFFF] * 3


def test_a_target_that_the_unit_does_not_have_is_not_known(measured: Measured) -> None:
    assert all(math.isnan(value) for value in floats(read(measured(points_mm={})))[11:])


@pytest.mark.parametrize(
    ("fault", "bit", "codes"),
    [
        (Fault(Reason.STALE), 2, [24, 0, 0]),
        (Fault(Reason.OUT_OF_RANGE), 4, [21, 0, 0]),
        (Fault(Reason.OUT_OF_RANGE, "rear"), 4, [0, 0, 21]),
        (Fault(Reason.EXPOSURES_LOST), 7, [0, 0, 0]),
        (Fault(Reason.SPOT_MISSING, "front"), 8, [0, 1, 0]),
        (Fault(Reason.SATURATED, "rear"), 9, [0, 0, 3]),
        (Fault(Reason.CHECK_FAILED), 15, [25, 0, 0]),
        (Fault(Reason.CAMERA_SILENT, "front"), 10, [0, 7, 0]),
        (Fault(Reason.CAMERA_SILENT, "rear"), 11, [0, 0, 7]),
        (Fault(Reason.PLAYBACK), 12, [0, 0, 0]),
        (Fault(Reason.IMPLAUSIBLE, "front"), 14, [0, 8, 0]),
    ],
)
def test_every_fault_has_its_bit_and_code(
    measured: Measured, fault: Fault, bit: int, codes: list[int]
) -> None:
    words = read(measured(beam=None, status=(fault,)))
    assert words[0] == 1 << bit
    assert words[2:5] == codes


PLANAR = {"leds_missing", "leds_misfit"}
ROW = {
    "beam_lost", "stuck_opaque", "switch_unseen", "beam_lost_behind", "stable_moved", "no_baseline",
    "stable_targets_disagree", "baseline_incomplete", "beam_angle_unknown", "beam_drift_unknown",
    "beam_not_closed", "alarm_displacement", "alarm_rate",
}  # fmt: skip


def test_no_reason_is_without_a_bit_and_none_but_warnings_without_a_code() -> None:
    without = {reason for reason in Reason if reason.group is StatusGroup.NO_BIT}
    assert without == {
        "rehearsal",
        "roll_missing",
        "pitch_diverges",
        *PLANAR,
        *ROW,
    }  # warnings that came when the word was full, and reasons of other instruments than a beam
    assert {reason for row in STATUS_BITS for reason in row.reasons} == set(Reason) - without
    assert set(REASON_CODES) == {reason for reason in Reason if not reason.is_warning}


def test_a_valid_measurement_may_warn(measured: Measured) -> None:
    words = read(measured(status=(Fault(Reason.PLAYBACK), Fault(Reason.EXPOSURES_LOST))))
    assert words[0] == 1 | 1 << 12 | 1 << 7


def test_counters_wrap_without_ever_reading_not_known(measured: Measured) -> None:
    assert [read(None, published=count)[5] for count in (65_534, 65_535, 65_536)] == [65_534, 0, 1]
    sequences = [decode(read(measured(sequence=2**32 - 2 + step)), 8, "I") for step in (0, 1, 2)]
    assert sequences == [2**32 - 2, 0, 1]


@pytest.mark.parametrize(
    ("age_s", "word"), [(-0.1, 0), (0.0004, 0), (65.0, 65_000), (65.6, 65_534), (1e9, 65_534)]
)
def test_age_is_held_at_the_ends_of_its_range(age_s: float, word: int) -> None:
    assert read(None, age_s=age_s)[6] == word


@given(st.floats())
def test_a_packed_number_is_the_nearest_that_its_type_has(value: float) -> None:
    single = decode(list(Type.F32.pack(value)), 0, "f")
    whole = decode(list(Type.S32.pack(value)), 0, "i")
    if not math.isfinite(value):
        assert math.isnan(single)
        assert whole == -0x8000_0000
    elif abs(value) < 2**31 - 1:
        assert single == struct.unpack(">f", struct.pack(">f", value))[0]
        assert abs(whole - value) <= 0.5
    else:
        assert math.isfinite(single)
        assert whole == math.copysign(2**31 - 1, value)


NUMBERS = [kind for kind in Type if not kind.is_text]


@given(st.floats(), st.sampled_from(NUMBERS))
def test_only_what_is_not_known_reads_as_not_known(value: float, kind: Type) -> None:
    assert (kind.pack(value) == kind.unknown) == (not math.isfinite(value))
    assert len(kind.pack(value)) == kind.words


def test_a_scaled_number_that_overflows_is_held_at_the_end_and_not_unknown(measured: Measured) -> None:
    beam = Beam(1e305, -1e305, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    words = image(view_of(measured(beam=beam), 0.5, 1))
    assert words[60:64] == [0x7FFF, 0xFFFF, 0x8000, 0x0001]


def test_every_number_of_a_beam_and_of_a_plate_has_registers() -> None:
    """Each with its sigma; a number that no controller may read would be named here."""
    for quantities in (OF_BEAM, OF_PLATE):
        known = {each.key: Value(1.5 + row, 0.25 + row / 64) for row, each in enumerate(quantities.of_unit)}
        words = image(view_of(replace(MEASURED, quantities=quantities, values=known)))
        shown = {decode(words, address, "f") for address in range(len(words) - 1)}
        for quantity in quantities.of_unit:
            if quantity.is_from_sensor or quantity.is_optional:
                continue
            assert known[quantity.key].value in shown, quantity.key
            assert not quantity.has_sigma or known[quantity.key].sigma in shown, quantity.key
