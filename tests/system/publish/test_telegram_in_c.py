"""The parser in C, by the table of cases, held against the parser in Python."""

from __future__ import annotations

from pathlib import Path

from support.telegram_cases import ReaderInC, check, read_by_python, variants


def test_every_case_gives_what_the_table_says_and_the_same_as_in_python(tmp_path: Path) -> None:
    reader = ReaderInC(tmp_path)
    tried = 0
    for variant in variants():
        result = reader.read(variant)
        check(variant, result)
        assert result == read_by_python(variant, 1000)
        tried += 1
    assert tried > 7000
    reader.end()
