"""The cases of ``telegram_cases.json``, which the parsers in Python and in C both run.

``telegrams``: by name, the sentences without their framing (``wire``) and what their fields mean (``reads``).
The framing is computed here, with the arithmetic of pynmea2 and zlib. ``cases``: what is sent when, in ms
(``say``), and which readings it gives (``gives``: a telegram and the fault). Items of ``say``:

- ``"live 160"``: a telegram; ``"live 160:MC"``: these of its sentences, in this order
- ``{"raw": text}``: bytes, as characters of Latin-1; ``{"sentence": body}``: any other sentence
- ``{"restart": true}``: the program calls ``restart``
- ``{"each": change, "of": telegram}``: one variant of the case for each place of the change, see ``CHANGES``;
  of such a case ``gives`` names the valid readings only
"""

import json
import subprocess
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pynmea2

from examples.python.altd_telegram import Reader, Reading
from support.foreign import need_program
from support.places import EXAMPLES

C = EXAMPLES / "c"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
TABLE: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
COUNTS = ("sequence", "frames", "session", "message", "clock_ms", "date", "age_ms")
NUMBERS = (
    *("x_mm", "y_mm", "yaw_deg", "pitch_deg", "roll_deg"),
    *("sigma_x_mm", "sigma_y_mm", "sigma_yaw_deg", "sigma_pitch_deg"),
    *("sigma_now_x_mm", "sigma_now_y_mm", "sigma_now_yaw_deg", "sigma_now_pitch_deg"),
)
FAULTS = ("", "foreign", "restarted", "not newer", "late", "unchecked")
"""As ``enum altd_fault`` numbers them."""
Record = dict[str, Any]
CHANGES: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "bit": lambda data: (
        data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :]
        for bit in range(8 * len(data))
    ),
    "end": lambda data: (data[:place] for place in range(len(data))),
    "end and empty line": lambda data: (data[:place] + b"\r\n" for place in range(len(data) - 2)),
    "beginning": lambda data: (data[place:] for place in range(1, len(data))),
    "middle": lambda data: (data[:place] + data[place + 7 :] for place in range(1, len(data) - 7)),
    "other byte": lambda data: (
        data[:place] + byte + data[place + 1 :]
        for place in range(len(data))
        for byte in (b"\x00", b"\xff", b"$")
    ),
    "further byte": lambda data: (
        data[:place] + byte + data[place:]
        for place in range(1, len(data))
        for byte in (b"\x00", b"\xff", b"7")
    ),
}


@dataclass(frozen=True)
class Variant:
    """One run of a parser: when it gets which bytes, None is a restart, and the expected result."""

    name: str
    unit: str | None
    fed: list[tuple[int, bytes | None]]
    gives: list[Record]
    counters: dict[str, int]
    valid_only: bool


@dataclass(frozen=True)
class Result:
    """A parser's result for a variant."""

    readings: list[Record]
    damaged: int
    lost: int


def sentence(body: str) -> bytes:
    return f"${body}*{pynmea2.NMEASentence.checksum(body):02X}\r\n".encode("latin-1")


@cache
def wire(telegram: str) -> bytes:
    """The bytes of ``live 160`` or, of some of its sentences, ``live 160:MC``."""
    name, _, order = telegram.partition(":")
    *bodies, proof = TABLE["telegrams"][name]["wire"]
    sentences = dict(zip("MQN", map(sentence, bodies), strict=False))
    covered = b"".join(sentences.values()) + f"${proof},".encode()
    sentences["C"] = sentence(f"{proof},{zlib.crc32(covered):08X}")
    return b"".join(sentences[letter] for letter in order or sentences)


def variants() -> Iterator[Variant]:
    """Every case, and each variant of one that is corrupted in each place."""
    for case in TABLE["cases"]:
        fed: list[list[tuple[int, bytes | None]]] = [[]]
        changed = False
        for at_ms, item in case["say"]:
            if isinstance(item, dict) and "each" in item:
                ways = [way for way in CHANGES[item["each"]](wire(item["of"])) if way != wire(item["of"])]
                fed, changed = [[*one, (at_ms, way)] for one in fed for way in ways], True
            else:
                fed = [[*one, (at_ms, _bytes_of(item))] for one in fed]
        gives = [_expected(*given, is_checked=case["unit"] is not None) for given in case["gives"]]
        counters = {key: case[key] for key in ("damaged", "lost") if key in case}
        for one in fed:
            yield Variant(case["name"], case["unit"], one, gives, counters, changed)


def _bytes_of(item: Any) -> bytes | None:
    if isinstance(item, str):
        return wire(item)
    if "sentence" in item:
        return sentence(item["sentence"])
    return item["raw"].encode("latin-1") if "raw" in item else None


def _expected(telegram: str, fault: str, *, is_checked: bool) -> Record:
    reads: Record = dict.fromkeys((*COUNTS, *NUMBERS, "time"))
    reads |= {"reasons": [], **TABLE["telegrams"][telegram]["reads"]}
    if not is_checked or fault == "unchecked":
        reads |= dict.fromkeys(("session", "message", "clock_ms", "date", "age_ms"))
        reads |= dict.fromkeys(NUMBERS[-4:])  # the telegram ends before it
    if fault:
        reads |= dict.fromkeys(NUMBERS)
    return reads | {"fault": fault, "valid": reads["mode"] == "A" and not fault}


def check(variant: Variant, result: Result) -> None:
    """Whether a parser did with this variant what the table says."""
    readings = [each for each in result.readings if each["valid"] or not variant.valid_only]
    assert readings == variant.gives, (variant, result)
    for counter, expected in variant.counters.items():
        assert getattr(result, counter) == expected, (variant, result)


def read_by_python(variant: Variant, piece_bytes: int) -> Result:
    now_ms = [0]
    reader = Reader(variant.unit, 1.0, lambda: now_ms[0] / 1000)
    readings = []
    for now_ms[0], data in variant.fed:
        if data is None:
            reader.restart()
        for place in range(0, len(data or b""), piece_bytes):
            readings += reader.feed((data or b"")[place : place + piece_bytes])
    return Result([record_of(reading) for reading in readings], reader.damaged, reader.lost)


def record_of(reading: Reading) -> Record:
    record = {key: getattr(reading, key) for key in (*COUNTS, *NUMBERS, "mode", "fault", "valid")}
    time = reading.time and f"{reading.time:%H%M%S}.{reading.time.microsecond // 1000:03d}"
    date = reading.date and int(f"{reading.date:%Y%m%d}")
    return record | {"time": time, "date": date, "reasons": list(reading.reasons)}


class ReaderInC:
    """A process of ``telegram_driver.c`` and the parser in C, compiled with sanitizers."""

    def __init__(self, folder: Path) -> None:
        sources = (Path(__file__).with_name("telegram_driver.c"), C / "altd_telegram.c")
        sanitizers = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
        compile_c(*sanitizers, *sources, "-o", folder / "driver")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = subprocess.Popen([folder / "driver"], **pipes, text=True)

    def end(self) -> None:
        self._process.communicate(timeout=60)
        assert self._process.returncode == 0

    def read(self, variant: Variant) -> Result:
        """Its result for a variant."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        said = [f"N 1000 {variant.unit or ''}"]
        said += ["R" if data is None else f"F {now_ms} {data.hex()}" for now_ms, data in variant.fed]
        self._process.stdin.write("\n".join([*said, "E", ""]))
        self._process.stdin.flush()
        readings = []
        while not (line := self._process.stdout.readline()).startswith("="):
            assert line, "the program in C has ended, see its standard error"
            readings.append(_record_of_line(line))
        damaged, lost = line.split()[1:]
        return Result(readings, int(damaged), int(lost))


def compile_c(*arguments: str | Path) -> None:
    """Compile with all warnings as errors; examples/c is where headers are looked for."""
    command = [need_program("gcc"), *WARNINGS, f"-I{C}", *arguments]
    subprocess.run(command, check=True, timeout=120)


def _record_of_line(line: str) -> Record:
    valid, *words = line.split()
    fault, mode, time, reasons, *values = [None if word == "-" else word for word in words]
    numbers = [value and float(value) for value in values[: len(NUMBERS)]]
    counts = [value and int(value) for value in values[len(NUMBERS) :]]
    record: Record = dict(zip((*NUMBERS, *COUNTS), (*numbers, *counts), strict=True))
    record |= {"mode": mode, "time": time, "reasons": reasons.split("+") if reasons else []}
    return record | {"valid": valid == "1", "fault": FAULTS[int(fault or "")]}
