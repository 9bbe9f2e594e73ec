"""Telegrams of a plate and of a row, with the framing, fields and rules of ``telegram``.

A place of a row has a sentence with a mode of its own, for each is measured independently.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC
from types import SimpleNamespace
from typing import Any

from altd.publish.serial import telegram
from altd.publish.serial.fields import CODES, MODE, Mode, integer, number
from altd.publish.serial.telegram import (
    DOES_NOT_FIT,
    MAX_SENTENCE_BYTES,
    MEASUREMENT,
    MILLIMETRES,
    MORE,
    QUALITY,
    SEQUENCE,
    SEQUENCE_MODULUS,
    SIGMA_DEGREES,
    SIGMA_MILLIMETRES,
    Field,
    Sentence,
    TelegramError,
    mode_of,
    ordered_codes,
)
from altd.reasons import Reason
from altd.records import Fault, Measurement, Quantities

_HEAD = MEASUREMENT.fields[:3]
"""Time, mode and sequence."""
_FRAMES, _REASONS = QUALITY.fields[1], QUALITY.fields[-1]
POSE = Sentence(
    "PALTP",
    "the pose of a plate",
    (
        *_HEAD,
        Field("a_mm", MILLIMETRES, "mm", "place of the plate's origin along x of the fixed frame"),
        Field("b_mm", MILLIMETRES, "mm", "the same along y"),
        Field("phi_deg", number(3, 4, signed=True), "degree", "turn of the plate, anticlockwise"),
    ),
)
POSE_QUALITY = Sentence(
    "PALTS",
    "its quality",
    (
        Field("sequence", SEQUENCE, "", "that of the `$PALTP` before it"),
        _FRAMES,
        Field("sigma_a_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of a"),
        Field("sigma_b_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of b"),
        Field("sigma_phi_deg", SIGMA_DEGREES, "degree", "standard deviation of phi"),
        _REASONS,
    ),
)
ROUND = Sentence(
    "PALTR",
    "a round of a row",
    (
        *_HEAD,
        Field("places", integer(99), "", "number of `$PALTD` that follow: one for each target"),
        Field("measured", integer(99), "", "number of targets that were measured"),
        Field("reasons", CODES, "", "reasons and warnings of the whole row"),
    ),
)
PLACE = Sentence(
    "PALTD",
    "the displacement of a place",
    (
        Field("sequence", SEQUENCE, "", "that of the `$PALTR` before it"),
        Field("number", integer(99), "", "target, in beam order, from 1"),
        Field("mode", MODE, "", "of this place, as in `$PALTM`"),
        Field(
            "dx_mm", MILLIMETRES, "mm", "displacement to the right since the baseline, seen along the beam"
        ),
        Field("dy_mm", MILLIMETRES, "mm", "the same upwards"),
        Field("sigma_dx_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of dx"),
        Field("sigma_dy_mm", SIGMA_MILLIMETRES, "mm", "standard deviation of dy"),
        Field("reasons", CODES, "", "reasons and warnings of the target"),
    ),
)


def sentences_of(instrument: str, targets: int) -> int:
    """Return the number of sentences of a measurement of this instrument."""
    return 1 + targets if instrument == "chain" else len(telegram.SENTENCES)


def places_of(quantities: Quantities) -> Sequence[str]:
    """Return the names of a row's places in their order; empty for another instrument."""
    return list(dict.fromkeys(each.place for each in quantities.of_unit if each.place))


def encode(measurement: Measurement | None, quantities: Quantities) -> bytes:
    """Return the telegram of a measurement of these quantities; None: nothing has been measured yet."""
    if quantities.has_places:
        return _row(measurement, places_of(quantities))
    return _plate(measurement) if quantities.instrument == "planar" else telegram.encode(measurement)


def _plate(measurement: Measurement | None) -> bytes:
    numbers = _numbers(measurement, ("a_mm", "b_mm", "phi_deg"))
    frames = {"frames": measurement and measurement.frames}
    codes = (str(Reason.WARMING_UP),) if measurement is None else ordered_codes(measurement)
    return _whole((POSE, POSE_QUALITY), _head(measurement), frames | numbers, codes)


def _row(measurement: Measurement | None, places: Sequence[str]) -> bytes:
    head = _head(measurement)
    status = (Fault(Reason.WARMING_UP),) if measurement is None else measurement.status
    faults = sorted(status, key=lambda fault: fault.reason.is_warning)
    measured = None if measurement is None else measurement.number("measured")
    counts = {"places": len(places), "measured": None if measured is None else round(measured)}
    codes = [str(fault) for fault in faults if fault.target not in places]
    written = _whole((ROUND,), head | counts, {}, codes)
    for at, name in enumerate(places, 1):
        numbers = _numbers(measurement, ("dx_mm", "dy_mm"), f"{name}_")
        own = head | {"number": at}
        if None in numbers.values():
            own, numbers = own | {"mode": Mode.INVALID}, dict.fromkeys(numbers)
        codes = [str(fault.reason) for fault in faults if fault.target == name]
        written += _whole((PLACE,), own, numbers, codes)
    return written


def _head(measurement: Measurement | None) -> dict[str, Any]:
    if measurement is None:
        return {"time": None, "mode": Mode.INVALID, "sequence": None}
    time = None if measurement.time is None else measurement.time.astimezone(UTC).timetz()
    return {"time": time, "mode": mode_of(measurement), "sequence": measurement.sequence % SEQUENCE_MODULUS}


def _numbers(measurement: Measurement | None, keys: Sequence[str], prefix: str = "") -> dict[str, Any]:
    """Return the values of ``keys`` and their sigmas by the names of the fields."""
    values = {key: measurement and measurement.number(prefix + key) for key in keys}
    return values | {f"sigma_{key}": measurement and measurement.sigma(prefix + key) for key in keys}


def _whole(
    sentences: Sequence[Sentence], head: dict[str, Any], numbers: dict[str, Any], codes: Sequence[str]
) -> bytes:
    """Return the sentences; invalid and without numbers if one of these does not fit its field."""
    try:
        return _written(sentences, head | numbers, tuple(codes))
    except TelegramError:
        none = dict.fromkeys(numbers) | {"mode": Mode.INVALID}
        return _written(sentences, head | none, (DOES_NOT_FIT, *codes))


def _written(sentences: Sequence[Sentence], content: dict[str, Any], codes: tuple[str, ...]) -> bytes:
    """Return the sentences, the last with as many codes as fit; ``more`` replaces the others."""
    written = b""
    for kept in range(len(codes), -1, -1):
        shown = codes[:kept] + (MORE,) * (kept < len(codes))
        written = sentences[-1].encode(SimpleNamespace(**content, reasons=shown or None))
        if len(written) <= MAX_SENTENCE_BYTES:
            break
    return b"".join(each.encode(SimpleNamespace(**content)) for each in sentences[:-1]) + written
