"""The third sentence of a telegram, by which a reader checks all three: unit, session, number, time, CRC."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, date

from altd.publish.serial.fields import Form, whole
from altd.publish.serial.telegram import Field, Sentence
from altd.records import Measurement
from altd.status.proof import Stamp, crc32

MAX_AGE_MS = 9_999_999
"""A greater age is held there: close to three hours."""

_HEXADECIMAL = Form("FFFFFFFF", re.compile(r"[0-9A-F]{8}", re.ASCII), lambda value: f"{value:08X}")
_COUNT = whole(0xFFFF_FFFE)
_DATE = Form("20991231", re.compile(r"\d{8}", re.ASCII), lambda value: f"{value:%Y%m%d}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """What the sentence says; None is an empty field."""

    unit: int | None = None
    session: int | None = None
    message: int | None = None
    clock_ms: int | None = None
    date: date | None = None
    age_ms: int | None = None
    crc32: int | None = None


PROOF = Sentence(
    "PALTC",
    "what it takes to check the telegram",
    (
        Field("unit", _HEXADECIMAL, "", "which unit: CRC-32 of its serial number"),
        Field("session", _HEXADECIMAL, "", "drawn by chance when the daemon starts"),
        Field("message", _COUNT, "", "counts the telegrams of this port"),
        Field("clock_ms", _COUNT, "ms", "since the daemon started, at sending"),
        Field("date", _DATE, "yyyymmdd", "UTC, goes with `time` of `$PALTM`; empty when not known"),
        Field("age_ms", whole(MAX_AGE_MS), "ms", "since the middle of the exposures, at sending"),
        Field("crc32", _HEXADECIMAL, "", "CRC-32 of every character before it, see below"),
    ),
)


def with_proof(telegram: bytes, measurement: Measurement | None, stamp: Stamp, age_s: float | None) -> bytes:
    """The telegram of a measurement and the sentence that proves it.

    The CRC is over all bytes from the first ``$`` of the telegram to the comma before the CRC, line ends and
    checksums too.
    """
    time = measurement.time if measurement else None
    proof = Proof(
        unit=stamp.identity.unit,
        session=stamp.identity.session,
        message=stamp.message,
        clock_ms=stamp.clock_ms,
        date=None if time is None else time.astimezone(UTC).date(),
        age_ms=None if age_s is None else min(max(round(1000 * age_s), 0), MAX_AGE_MS),
    )
    texts = [field.text(proof) for field in PROOF.fields[:-1]]
    begun = ",".join([f"${PROOF.name}", *texts, ""]).encode("ascii")
    return telegram + PROOF.encode(replace(proof, crc32=crc32(telegram + begun)))
