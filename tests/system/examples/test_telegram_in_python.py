"""The parser for users, by the table of cases that the parser in C is tested on, too."""

import itertools
import json
import shutil
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Self

import pytest
from support import telegram_cases
from support.measurements import measurement
from support.telegram_cases import Variant, check, read_by_python, sentence, wire

from altd.publish.serial.telegram import Nameplate, identification
from altd.status.proof import unit_number
from examples.python import altd_telegram
from examples.python.altd_telegram import Identity, Reader
from tools.pages.telegram import PYTHON

PIECES_BYTES = (1, 7, 1000)
VARIANTS: dict[str, list[Variant]] = defaultdict(list)
for variant in telegram_cases.variants():
    VARIANTS[variant.name].append(variant)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_case_gives_what_the_table_says_in_pieces_of_any_size(name: str) -> None:
    for number, variant in enumerate(VARIANTS[name]):
        for pieces in PIECES_BYTES if len(VARIANTS[name]) == 1 else [PIECES_BYTES[number % 3]]:
            check(variant, read_by_python(variant, pieces))


def test_it_imports_nothing_but_the_standard_library_and_runs_alone(tmp_path: Path) -> None:
    shutil.copy(altd_telegram.__file__, tmp_path / "copied.py")
    code = (
        "import sys; before = set(sys.modules); import copied; "
        "new = {name.split('.')[0] for name in set(sys.modules) - before}; import json; "
        "print(json.dumps([sorted(new - sys.stdlib_module_names), [n for n in sys.modules if 'altd' in n]]))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert json.loads(ran.stdout) == [["copied"], []]


@pytest.mark.parametrize(
    ("serial", "read", "is_whole"),
    [
        ("ALT-0007", "ALT-0007", True),
        ("A,B*C$D!E\\F^G", "A,B*C$D!E\\F^G", True),
        ("~~", "~~", True),
        ("Ü 机", "Ü 机", True),
        ("A" * 26, "A" * 26, True),
        ("A" * 27, "A" * 25, False),
    ],
)
def test_a_unit_that_identifies_itself_is_known_by_its_whole_serial_number(
    serial: str, read: str, is_whole: bool
) -> None:
    number, calibrated = unit_number(serial), date(2026, 11, 2)
    nameplate = Nameplate(unit=number, serial=serial, firmware="0.1.0+dev^1", calibrated=calibrated)
    reader = Reader()
    assert reader.feed(identification(nameplate, measurement())) == []
    assert reader.damaged == 0
    assert reader.identity == Identity(
        unit=unit_number(serial),
        serial=read,
        firmware="0.1.0+dev^1",
        calibrated=date(2026, 11, 2),
        date=None,
    )
    assert reader.identity.is_whole is is_whole
    assert not replace(reader.identity, unit=1).is_whole


@pytest.mark.parametrize(
    "body", ["PALTI,,A,,,", "PALTI,1E4B2D8E,^C3,,,", "PALTI,1E4B2D8E,^c3^9c,,,", "PALTI,1E4B2D8E"]
)
def test_a_bad_identification_is_damage(body: str) -> None:
    reader = Reader()
    reader.feed(sentence(body))
    assert (reader.identity, reader.damaged) == (None, 1)


def test_a_reader_keeps_no_more_than_a_sentence_of_what_never_ends() -> None:
    reader = Reader()
    for _ in range(100):
        reader.feed(b"$PALTM," * 1000)
    assert max(len(kept) for kept in vars(reader).values() if isinstance(kept, bytes)) <= 82


class _Port:
    """A stand-in for pyserial's port: three telegrams, then silence."""

    def __init__(self, *_: object, **named: object) -> None:
        assert named == {"timeout": 0.1}
        self.waiting = [wire("live 160"), wire("blocked 180"), wire("restarted 5"), *[b""] * 10]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def reset_input_buffer(self) -> None:
        self.waiting.insert(0, wire("live 161")[:100])

    def read(self, size: int) -> bytes:
        return self.waiting.pop(0)


def test_the_program_on_the_page_uses_what_is_valid_and_else_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[tuple[object, ...]] = []
    ticks = itertools.count(0.0, 0.5)
    monkeypatch.setitem(sys.modules, "altd_telegram", altd_telegram)
    monkeypatch.setattr("serial.Serial", _Port)
    monkeypatch.setattr("time.monotonic", lambda: next(ticks))
    names = {"use": lambda *values: done.append(values), "stop": lambda why: done.append((why,))}
    with pytest.raises(IndexError):  # the port has no more
        exec(PYTHON, names)
    first = (10.012, 4.987, 1.1459, -1.7184)
    assert done[:3] == [first, ("front_spot_missing rear_spot_missing",), ("restarted",)]
    assert {why for why, *_ in done[3:]} == {"no valid telegram"}
