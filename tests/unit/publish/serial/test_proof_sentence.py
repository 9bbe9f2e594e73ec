"""The third sentence, read by plain string handling; the CRC is Python's own."""

from __future__ import annotations

import zlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import pynmea2
import pytest

from altd.publish.serial.telegram import PROOF, encode, with_proof
from altd.records import Measurement
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
