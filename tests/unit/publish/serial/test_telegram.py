"""Writing telegrams: a table of cases, a foreign parser, the parser for users, and random measurements."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import pynmea2
import pytest
from support.measurements import beam_of, changed, measured

from altd.instruments.beam.solver import Beam
from altd.publish.serial.telegram import MAX_SENTENCE_BYTES, SENTENCES, encode
from altd.reasons import Reason
from altd.records import Fault, Measurement
from examples.python.altd_telegram import Reader

MEASURED = measured(
    Beam(10.012, -4.987, 1.1459, -1.7184, 0.004, 0.0041, 0.0011, 0.0012),
    points_mm={},
    time=datetime(2026, 11, 20, 8, 15, 30, 125_999, UTC),
)


def line(body: str) -> str:
    """A sentence framed by the foreign parser's arithmetic."""
    return f"${body}*{pynmea2.NMEASentence.checksum(body):02X}"


CASES = {
    "valid": (
        MEASURED,
        "PALTM,081530.125,A,160,10.012,-4.987,1.1459,-1.7184,",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,",
    ),
    "nothing measured so far": (
        None,
        "PALTM,,V,,,,,,",
        "PALTQ,,,,,,,warming_up",
    ),
    "both spots missing": (
        changed(
            MEASURED,
            None,
            status=(Fault(Reason.SPOT_MISSING, "front"), Fault(Reason.SPOT_MISSING, "rear")),
        ),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,20,,,,,front_spot_missing+rear_spot_missing",
    ),
    "a valid playback without a known time, with roll": (
        changed(MEASURED, beam_of(MEASURED), roll_deg=-0.00001, time=None, status=(Fault(Reason.PLAYBACK),)),
        "PALTM,,P,160,10.012,-4.987,1.1459,-1.7184,0.0000",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,playback",
    ),
    "a simulated unit": (
        replace(MEASURED, status=(Fault(Reason.SIMULATED),)),
        "PALTM,081530.125,S,160,10.012,-4.987,1.1459,-1.7184,",
        "PALTQ,160,20,0.0040,0.0041,0.0011,0.0012,simulated",
    ),
    "an invalid playback": (
        changed(MEASURED, None, status=(Fault(Reason.PLAYBACK), Fault(Reason.STALE))),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,20,,,,,stale+playback",
    ),
    "a number that has no room": (
        changed(MEASURED, replace(beam_of(MEASURED), x_mm=-9999.9996)),
        "PALTM,081530.125,V,160,,,,,",
        "PALTQ,160,,,,,,does_not_fit",
    ),
}


@pytest.mark.parametrize(("measurement", "first", "second"), CASES.values(), ids=CASES)
def test_a_case_is_written(measurement: Measurement | None, first: str, second: str) -> None:
    assert encode(measurement) == f"{line(first)}\r\n{line(second)}\r\n".encode()
    assert len(Reader().feed(encode(measurement))) == 1


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
    assert lines[1].split(b"*")[0].endswith(b",exposures_lost+playback")


def test_reasons_that_find_no_room_are_told_as_more() -> None:
    targets = [f"target_{place}" for place in range(10)]
    crowd = changed(
        WIDEST, None, status=(*(Fault(Reason.SPOT_MISSING, name) for name in targets), Fault(Reason.STALE))
    )
    [reading] = Reader().feed(encode(crowd))
    assert reading.reasons == ("stale", "target_0_spot_missing", "more")
    assert all(len(line) <= MAX_SENTENCE_BYTES for line in encode(crowd).splitlines(keepends=True))


def test_the_sequence_wraps_at_32_bits() -> None:
    assert encode(replace(MEASURED, sequence=(1 << 32) + 7)).split(b",")[3] == b"7"


def test_a_local_time_is_sent_as_utc() -> None:
    vienna = MEASURED.time.astimezone(timezone(timedelta(hours=1)))  # type: ignore[union-attr]
    assert encode(replace(MEASURED, time=vienna)) == encode(MEASURED)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e9])
def test_what_is_no_ordinary_number_makes_it_invalid(value: float) -> None:
    [reading] = Reader().feed(encode(changed(MEASURED, replace(beam_of(MEASURED), sigma_yaw_deg=value))))
    assert (reading.mode, reading.reasons) == ("V", ("does_not_fit",))
