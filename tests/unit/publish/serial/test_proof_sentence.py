"""The sentences that check and identify, read by plain string handling; the CRC is Python's own."""

import zlib
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta, timezone

import pynmea2
import pytest

from altd.publish.serial.telegram import PROOF, Nameplate, encode, identification, of_now, with_proof
from altd.records import Measurement
from altd.records.spots import Motion
from altd.status.proof import Identity, Stamp

STAMP = Stamp(Identity(0x1E4B2D8E, 0x0000A0A7), 4711, 345_678)


def fields_of(telegram: bytes) -> list[str]:
    return telegram.decode("ascii").split("\r\n")[2].split("*")[0].split(",")


def test_the_telegram_before_it_stays_as_it_was(measured: Measurement) -> None:
    plain = encode(measured)
    checked = with_proof(plain, measured, STAMP, 0.52)
    assert checked.startswith(plain)
    assert fields_of(checked)[:-1] == [
        *("$PALTC", "1E4B2D8E", "0000A0A7", "4711", "345678", "20261120", "520")
    ]


def test_the_crc_is_over_every_byte_before_it(measured: Measurement) -> None:
    checked = with_proof(encode(measured), measured, STAMP, 0.52)
    before, _, crc = checked[: checked.rindex(b"*")].rpartition(b",")
    assert crc == b"%08X" % zlib.crc32(before + b",")
    pynmea2.parse(checked.decode("ascii").split("\r\n")[2], check=True)


def test_what_is_not_known_is_empty() -> None:
    assert fields_of(with_proof(encode(None), None, Stamp(Identity(), 1, 0), None))[1:-1] == [
        *("", "", "1", "0", "", "")
    ]


def test_the_date_is_that_of_the_time_in_utc(measured: Measurement) -> None:
    late = datetime(2026, 12, 31, 23, 30, tzinfo=timezone(timedelta(hours=-2)))
    for time in (late, late.astimezone(UTC)):
        shown = with_proof(b"", replace(measured, time=time), STAMP, 0.5)
        assert b",20270101," in shown


@pytest.mark.parametrize(("age_s", "text"), [(-0.2, "0"), (9999.9994, "9999999"), (1e9, "9999999")])
def test_an_age_is_held_at_the_ends_of_its_field(measured: Measurement, age_s: float, text: str) -> None:
    assert fields_of(with_proof(encode(measured), measured, STAMP, age_s))[6] == text


def test_the_longest_sentence_is_82_characters_at_most(measured: Measurement) -> None:
    stamp = Stamp(Identity(0xFFFF_FFFE, 0xFFFF_FFFE), 0xFFFF_FFFE, 0xFFFF_FFFE)
    longest = with_proof(b"", measured, stamp, 1e9)
    assert len(longest) <= 82
    widest = sum(len(field.form.widest) + 1 for field in PROOF.fields)
    assert len(longest) == len("$PALTC*00\r\n") + widest


def test_sigma_now_follows_age_and_motion_and_is_covered_by_the_crc(measured: Measurement) -> None:
    """2 mm/s beside a sigma of 0.004 mm; 300 mm/s do not fit, and without an age nothing is known."""
    motion = Motion(2.0, 0.01, 0.0, 0.0, 0.475, 0.083, probable_rate=2.0, acceleration=0.0)
    fast = replace(motion, rate=300.0, probable_rate=300.0)
    moving = replace(measured, motions={"x_mm": motion, "y_mm": fast})
    for age_s, sigma_mm in ((0.52, 1.04), (0.92, 1.84)):
        sentence = of_now(moving, age_s)
        assert pynmea2.parse(sentence.decode("ascii"), check=True).data == [
            "N",
            "160",
            f"{sigma_mm:.4f}",
            "",
            "",
            "",
        ]
    assert of_now(moving, None)[:-4] == b"$PALTN,160,,,,*"
    assert of_now(None, None)[:-4] == b"$PALTN,,,,,*"
    checked = with_proof(encode(moving) + sentence, moving, STAMP, 0.92)
    before, _, crc = checked[: checked.rindex(b"*")].rpartition(b",")
    assert crc == b"%08X" % zlib.crc32(before + b",")


NAMEPLATE = Nameplate(unit=0x1E4B2D8E, serial="ALT-0007", firmware="0.1.0", calibrated=date(2026, 11, 2))
LONG = "A" * 64


def test_a_unit_is_identified(measured: Measurement) -> None:
    assert identification(NAMEPLATE, measured) == b"$PALTI,1E4B2D8E,ALT-0007,0.1.0,20261102,20261120*27\r\n"
    assert identification(NAMEPLATE, None).startswith(b"$PALTI,1E4B2D8E,ALT-0007,0.1.0,20261102,*")


@pytest.mark.parametrize(
    ("serial", "text"),
    [
        ("A 1/2-3_4;5", "A 1/2-3_4;5"),
        ("A,B*C$D!E\\F", "A^2CB^2AC^24D^21E^5CF"),
        ("^^~", "^5E^5E^7E"),
        ("Ü1", "^C3^9C1"),
        ("机" * 2, "^E6^9C^BA^E6^9C^BA"),
        ("机" * 3, "^E6^9C^BA^E6^9C^BA~"),
        (LONG[:26], LONG[:26]),
        (LONG[:27], LONG[:25] + "~"),
        (LONG, LONG[:25] + "~"),
        ("A" * 23 + ",B", "A" * 23 + "~"),
    ],
)
def test_any_serial_number_finds_room_and_one_that_was_cut_is_marked(
    measured: Measurement, serial: str, text: str
) -> None:
    sentence = identification(replace(NAMEPLATE, serial=serial), measured)
    assert sentence.split(b",")[2].decode() == text
    assert len(sentence) <= 82
    message = pynmea2.parse(sentence.decode("ascii"), check=True)
    assert message.data == ["I", "1E4B2D8E", text, "0.1.0", "20261102", "20261120"]


def test_the_longest_identification_is_82_characters(measured: Measurement) -> None:
    assert len(identification(replace(NAMEPLATE, serial=LONG, firmware=LONG), measured)) == 82
