"""A telegram read as a controller reads it: strictly, both sentences, every field by its form."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, time
from typing import Any

from altd.publish.serial.fields import CODE_SEPARATOR, Mode
from altd.publish.serial.telegram import (
    LINE_END,
    SENTENCES,
    SIGMAS,
    Field,
    Sentence,
    Telegram,
    TelegramError,
    checksum,
)


def _time(text: str) -> time:
    return datetime.strptime(text, "%H%M%S.%f").replace(tzinfo=UTC).timetz()


READ: dict[str, Callable[[str], Any]] = {
    "time": _time,
    "mode": Mode,
    "sequence": int,
    "frames": int,
    "reasons": lambda text: tuple(text.split(CODE_SEPARATOR)),
}
"""By field; all others are decimal numbers."""


def parse(data: bytes) -> Telegram:
    """Read one telegram, both sentences with their line ends; raises TelegramError."""
    *lines, rest = data.split(LINE_END)
    if rest or len(lines) != len(SENTENCES):
        raise TelegramError("telegram", f"not {len(SENTENCES)} whole lines: {data!r}")
    decoded = [_decoded(sentence, line) for sentence, line in zip(SENTENCES, lines, strict=True)]
    if decoded[0]["sequence"] != decoded[1]["sequence"]:
        raise TelegramError("sequence", "differs between the two sentences")
    values = decoded[0] | decoded[1]
    if values["mode"] is None:
        raise TelegramError("mode", "is empty")
    for name in (*SIGMAS, *(f"sigma_{key}" for key in SIGMAS)):
        if (values[name] is None) != (values["mode"] is Mode.INVALID):
            raise TelegramError(name, f"does not go with mode {values['mode']}")
    return Telegram(**values)


def _decoded(sentence: Sentence, line: bytes) -> dict[str, Any]:
    """The values of the sentence by field; the line end is off already."""
    if not line.isascii() or not line.startswith(b"$") or line[-3:-2] != b"*":
        raise TelegramError(sentence.name, f"no sentence: {line!r}")
    body, check = line[1:-3], line[-2:]
    if b"%02X" % checksum(body) != check.upper():
        raise TelegramError(sentence.name, f"checksum is {checksum(body):02X}, not {check.decode()}")
    name, *texts = body.decode("ascii").split(",")
    if name != sentence.name:
        raise TelegramError(sentence.name, f"sentence is named {name!r}")
    if len(texts) != len(sentence.fields):
        raise TelegramError(sentence.name, f"has {len(texts)} fields, not {len(sentence.fields)}")
    return {field.name: _value(field, text) for field, text in zip(sentence.fields, texts, strict=True)}


def _value(field: Field, text: str) -> Any:
    """What the field says; None when it is empty."""
    if not text:
        return None
    if not field.form.pattern.fullmatch(text):
        raise TelegramError(field.name, f"{text!r} is not of the form {field.form.widest}")
    try:
        return READ.get(field.name, float)(text)
    except ValueError as error:
        raise TelegramError(field.name, f"{text!r} is no value") from error
