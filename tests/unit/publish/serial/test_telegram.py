"""Writing and reading telegrams, against a foreign parser, a table of cases and random measurements."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, time, timedelta, timezone

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.measurements import beam_of, changed, measured
from support.telegram_reader import parse

from altd.instruments.beam.solver import Beam
from altd.publish.serial.fields import Mode
from altd.publish.serial.telegram import (
    MAX_SENTENCE_BYTES,
    SENTENCES,
    SIGMAS,
    Telegram,
    TelegramError,
    encode,
)
from altd.reasons import Reason
from altd.records import Fault, Measurement

KEYS = (*SIGMAS, *(f"sigma_{key}" for key in SIGMAS))
MEASURED = measured(
    sequence=160,
    t_ns=8_000_000_000,
    time=datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC),
    frames=20,
    beam=Beam(10.012, -4.987, 1.1459, -1.7184, 0.004, 0.0041, 0.0011, 0.0012),
    points_mm={},
)
READ = Telegram(
    time=time(8, 15, 30, 125_000, UTC),
    mode=Mode.LIVE,
    sequence=160,
    x_mm=10.012,
    y_mm=-4.987,
    yaw_deg=1.1459,
    pitch_deg=-1.7184,
    frames=20,
    sigma_x_mm=0.004,
    sigma_y_mm=0.0041,
    sigma_yaw_deg=0.0011,
    sigma_pitch_deg=0.0012,
)
WITHOUT_NUMBERS = {**dict.fromkeys(KEYS), "mode": Mode.INVALID}


def line(body: str) -> str:
    """A sentence framed by the foreign parser's arithmetic."""
    return f"${body}*{pynmea2.NMEASentence.checksum(body):02X}"


CASES = {
    "valid": (
        MEASURED,
        READ,
        "PALTM,081530.125,A,160,10.012,-4.987,1.1459,-1.7184,",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,",
    ),
    "nothing measured so far": (
        None,
        Telegram(reasons=("warming_up",)),
        "PALTM,,V,,,,,,",
        "PALTQ,,,,,,,warming_up",
    ),
    "both spots missing": (
        changed(
            MEASURED,
            None,
            status=(Fault(Reason.SPOT_MISSING, "front"), Fault(Reason.SPOT_MISSING, "rear")),
        ),
        replace(READ, **WITHOUT_NUMBERS, reasons=("front_spot_missing", "rear_spot_missing")),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,20,,,,,front_spot_missing+rear_spot_missing",
    ),
    "a valid playback without a known time, with roll": (
        changed(MEASURED, beam_of(MEASURED), roll_deg=-0.00001, time=None, status=(Fault(Reason.PLAYBACK),)),
        replace(READ, time=None, mode=Mode.PLAYBACK, roll_deg=0.0, reasons=("playback",)),
        "PALTM,,P,160,10.012,-4.987,1.1459,-1.7184,0.0000",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,playback",
    ),
    "a simulated unit": (
        replace(MEASURED, status=(Fault(Reason.SIMULATED),)),
        replace(READ, mode=Mode.SIMULATED, reasons=("simulated",)),
        "PALTM,081530.125,S,160,10.012,-4.987,1.1459,-1.7184,",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,simulated",
    ),
    "an invalid playback": (
        changed(MEASURED, None, status=(Fault(Reason.PLAYBACK), Fault(Reason.STALE))),
        replace(READ, **WITHOUT_NUMBERS, reasons=("stale", "playback")),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,20,,,,,stale+playback",
    ),
    "a number that has no room": (
        changed(MEASURED, replace(beam_of(MEASURED), x_mm=-9999.9996)),
        replace(READ, **WITHOUT_NUMBERS, frames=None, reasons=("does_not_fit",)),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,,,,,,does_not_fit",
    ),
}


@pytest.mark.parametrize(("measurement", "telegram", "first", "second"), CASES.values(), ids=CASES)
def test_a_case_is_written_and_read(
    measurement: Measurement | None, telegram: Telegram, first: str, second: str
) -> None:
    wire = f"{line(first)}\r\n{line(second)}\r\n".encode()
    assert encode(measurement) == wire
    assert parse(wire) == telegram
    assert telegram.encode() == wire


@pytest.mark.parametrize("measurement", [case[0] for case in CASES.values()], ids=CASES)
def test_a_foreign_parser_accepts_framing_and_checksum(measurement: Measurement | None) -> None:
    for line, sentence in zip(encode(measurement).decode().split("\r\n"), SENTENCES, strict=False):
        message = pynmea2.parse(line, check=True)
        assert message.manufacturer == "ALT"
        assert message.data[0] == sentence.name[-1]
        assert len(message.data) == 1 + len(sentence.fields)


WIDEST = measured(
    sequence=(1 << 32) - 1,
    t_ns=0,
    time=datetime(2026, 12, 31, 23, 59, 59, 999_999, UTC),
    frames=1000,
    beam=Beam(-9999.999, -9999.999, -99.9999, -99.9999, 99.9999, 99.9999, 9.9999, 9.9999),
    points_mm={},
    status=(Fault(Reason.EXPOSURES_LOST), Fault(Reason.PLAYBACK)),
    roll_deg=-99.9999,
)


def test_the_widest_values_keep_to_the_length_of_the_standard() -> None:
    lines = encode(WIDEST).splitlines(keepends=True)
    assert [len(line) for line in lines] == [82, 81]
    assert parse(encode(WIDEST)).reasons == ("exposures_lost", "playback")


def test_reasons_that_find_no_room_are_told_as_more() -> None:
    targets = [f"target_{place}" for place in range(10)]
    crowd = changed(
        WIDEST,
        None,
        status=(*(Fault(Reason.SPOT_MISSING, name) for name in targets), Fault(Reason.STALE)),
    )
    telegram = parse(encode(crowd))
    assert telegram.reasons == ("stale", "target_0_spot_missing", "more")
    assert all(len(line) <= MAX_SENTENCE_BYTES for line in encode(crowd).splitlines(keepends=True))


def test_the_sequence_wraps_at_32_bits() -> None:
    assert parse(encode(replace(MEASURED, sequence=(1 << 32) + 7))).sequence == 7


def test_a_local_time_is_sent_as_utc() -> None:
    vienna = MEASURED.time.astimezone(timezone(timedelta(hours=1)))  # type: ignore[union-attr]
    assert encode(replace(MEASURED, time=vienna)) == encode(MEASURED)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e9])
def test_what_is_no_ordinary_number_makes_it_invalid(value: float) -> None:
    telegram = parse(encode(changed(MEASURED, replace(beam_of(MEASURED), sigma_yaw_deg=value))))
    assert telegram.mode is Mode.INVALID
    assert telegram.reasons == ("does_not_fit",)


GOOD = [line(CASES["valid"][2]), line(CASES["valid"][3])]


@pytest.mark.parametrize(
    ("field", "first", "second"),
    [
        ("telegram", GOOD[0], None),
        ("PALTM", GOOD[1], GOOD[0]),
        ("PALTM", GOOD[0].replace("10.012", "10.013"), GOOD[1]),
        ("PALTM", GOOD[0][1:], GOOD[1]),
        ("PALTM", GOOD[0][:-1] + "\xff", GOOD[1]),
        ("PALTM", "", GOOD[1]),
        ("PALTQ", GOOD[0], line("PALTQ,160,20")),
        ("sequence", GOOD[0], line("PALTQ,161,20,,,,,")),
        ("time", line("PALTM,241530.125,V,160,,,,,"), GOOD[1]),
        ("time", line("PALTM,noon,V,160,,,,,"), GOOD[1]),
        ("mode", line("PALTM,,X,160,,,,,"), GOOD[1]),
        ("mode", line("PALTM,,,160,,,,,"), line("PALTQ,160,20,,,,,")),
        ("x_mm", line("PALTM,,A,160,1e3,,,,"), GOOD[1]),
        ("x_mm", line("PALTM,,A,160,,1.000,1.0000,1.0000,"), GOOD[1]),
        ("sigma_x_mm", line("PALTM,,V,160,,,,,"), GOOD[1]),
        ("sigma_yaw_deg", GOOD[0], line("PALTQ,160,20,0.0040,0.0041,-0.0011,0.0012,")),
        ("reasons", line("PALTM,,V,160,,,,,"), line("PALTQ,160,20,,,,,NO!")),
    ],
)
def test_a_bad_telegram_is_refused_and_the_field_named(field: str, first: str, second: str | None) -> None:
    with pytest.raises(TelegramError) as caught:
        parse("".join(f"{text}\r\n" for text in (first, second) if text is not None).encode("latin-1"))
    assert caught.value.field == field


@given(st.binary(max_size=200))
def test_garbage_is_refused_with_the_typed_error(data: bytes) -> None:
    with pytest.raises(TelegramError):
        parse(data)


def within(limit: float) -> st.SearchStrategy[float]:
    return st.floats(-limit, limit)


MEASUREMENTS = st.builds(
    measured,
    sequence=st.integers(0, 1 << 40),
    t_ns=st.just(0),
    time=st.none() | st.datetimes(timezones=st.just(UTC)),
    frames=st.integers(1, 1000),
    beam=st.none()
    | st.builds(
        Beam,
        *[within(20000.0)] * 2,
        *[within(90.0)] * 2,
        *[st.floats(0, 90.0)] * 2,
        *[st.floats(0, 9.0)] * 2,
    ),
    points_mm=st.just({}),
    status=st.lists(
        st.builds(Fault, st.sampled_from(Reason), st.none() | st.sampled_from(["front", "rear", "a" * 32])),
        max_size=6,
    ).map(tuple),
    roll_deg=st.none() | within(90.0),
)


@given(MEASUREMENTS)
def test_any_measurement_survives_the_wire(measurement: Measurement) -> None:
    wire = encode(measurement)
    assert all(len(line) <= MAX_SENTENCE_BYTES for line in wire.splitlines(keepends=True))
    telegram = parse(wire)
    assert telegram.encode() == wire
    if telegram.mode is Mode.INVALID:
        return
    for name in KEYS:
        step = 1e-3 if name in ("x_mm", "y_mm") else 1e-4
        assert getattr(telegram, name) == pytest.approx(
            getattr(beam_of(measurement), name), abs=0.5001 * step
        )
