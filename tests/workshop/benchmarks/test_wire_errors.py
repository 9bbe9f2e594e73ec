"""The errors on the wires, a few of each: all are found, and what is no error passes."""

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

import pytest
from support.places import ROOT

from benchmarks.wire_errors import __main__ as wire_errors
from benchmarks.wire_errors import errors
from benchmarks.wire_errors.errors import BLOCK, JSON, TELEGRAM, Payload
from benchmarks.wire_errors.runner import WIRES, Tally

MESSAGES = {
    "block": (BLOCK, bytes(range(160))),
    "telegram": (TELEGRAM, b"$PALTM,1,A,2,3.000,4*00\r\n$PALTQ,1*00\r\n$PALTC,1,FF*00\r\n"),
    "json": (JSON, b'{"x_mm": 10.012, "valid": true, "crc32": "00"}'),
}


@dataclass(frozen=True)
class Row:
    """A line of the table that a run prints."""

    error: str
    wire: str
    injected: int
    found: int
    passed: int
    by: set[str]
    good: int
    refused: dict[str, int]


def _row(line: str) -> Row:
    head, by, good, refused = re.fullmatch(r"(.*\d)  (\D.*); good (\d+), refused (.*)", line).groups()
    counts = dict(re.findall(r"([a-z -]+?) (\d+)(?:, |$)", refused))
    return Row(
        head[:15].strip(),
        head[15:28].strip(),
        *map(int, head[28:].split()),
        {name for name, _ in re.findall(r"([a-z -]+?) (\d+)(?:, |$)", by)},
        int(good),
        {name: int(count) for name, count in counts.items()},
    )


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    command = [sys.executable, "-m", "benchmarks.wire_errors", "--count", "3"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=200, cwd=ROOT)
    assert (ran.returncode, ran.stderr) == (0, "")
    return [_row(line) for line in ran.stdout.splitlines()[1:]]


def test_every_error_on_every_wire_is_found(rows: list[Row]) -> None:
    assert [(row.wire, row.error) for row in rows] == [
        (wire, error) for wire in WIRES for error in errors.ERRORS
    ]
    for row in rows:
        assert (row.injected, row.found, row.passed) == (3, 3, 0), row


def test_each_error_is_found_by_the_check_that_the_page_names(rows: list[Row]) -> None:
    expected = {
        "corruption": {"corrupt"},
        "repetition": {"not newer"},
        "loss": {"time-out", "lost"},
        "insertion": {"not newer"},
        "wrong order": {"not newer"},
        "delay": {"late"},
        "masquerade": {"corrupt"},
        "wrong address": {"foreign"},
    }
    for row in rows:
        assert row.by - {"late", "time-out"} <= expected[row.error], row  # late: on a slow machine
        assert row.by & expected[row.error], row


def test_what_is_no_error_passes(rows: list[Row]) -> None:
    for row in rows:
        assert row.good >= 3
        assert set(row.refused) <= {"late", "time-out"}, row
        assert sum(row.refused.values()) < row.good, row


def test_the_table_counts_what_passed() -> None:
    tally = Tally("telegram", "corruption")
    tally.add(True, "corrupt", 0)
    tally.add(True, "", 3)
    tally.add(False, "late", 0)
    assert (tally.injected, tally.passed, tally.found["corrupt"], tally.good) == (2, 1, 1, 1)
    assert wire_errors.passed([tally]) == 1
    assert any("1" in line.split() and "telegram" in line for line in wire_errors.text([tally]))


@pytest.mark.parametrize("name", MESSAGES)
def test_a_spoilt_or_imitated_message_is_another_one(name: str) -> None:
    payload: Payload
    payload, content = MESSAGES[name]
    chance = Random(1)
    for _ in range(200):
        assert payload.spoil(content, chance) != content
        assert payload.imitate(content, chance) != content


@pytest.mark.parametrize("error", errors.ERRORS)
@pytest.mark.parametrize("is_polled", [True, False])
def test_each_second_delivery_is_spoilt(error: str, is_polled: bool) -> None:
    sent: Iterator[int] = iter(range(10_000))
    unit = lambda: b"%4d" % next(sent)  # noqa: E731
    line = errors.Line(unit, lambda: b"other", Payload(_spoilt, _spoilt), Random(1), is_polled)
    deliveries = errors.ERRORS[error](line)
    assert [next(deliveries).is_spoilt for _ in range(20)] == [False, True] * 10


def _spoilt(content: bytes, _: Random) -> bytes:
    return content + b"!"


def test_the_page_of_the_study_says_that_nothing_passed() -> None:
    page = (ROOT / "docs" / "studies" / "wire-errors.md").read_text()
    assert "; 0 passed." in page.splitlines()[2]
    assert page.count("|1,000/1,000: ") == 32
