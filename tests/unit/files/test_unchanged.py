from __future__ import annotations

import os
from pathlib import Path

import pytest

from altd.errors import BadInputError
from altd.files.reading import UnchangedFile

PIECE_BYTES = 1 << 20


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Two and a half pieces of numbered lines."""
    path = tmp_path / "table"
    path.write_text("".join(f"{number:015d}\n" for number in range(5 * PIECE_BYTES // 32)))
    return path


def test_it_is_the_same_each_time(path: Path) -> None:
    steady = UnchangedFile(path, 1 << 30)
    for _ in range(2):
        assert b"".join(steady.pieces()) == path.read_bytes()
        assert "".join(steady.lines()) == path.read_text()


def test_what_is_appended_later_is_not_seen(path: Path) -> None:
    before = path.read_bytes()
    steady = UnchangedFile(path, 1 << 30)
    with path.open("ab") as file:
        file.write(b"more\n")
    assert b"".join(steady.pieces()) == before


@pytest.mark.parametrize("at", [0, PIECE_BYTES - 1, PIECE_BYTES, 5 * PIECE_BYTES // 2 - 1])
def test_a_piece_in_which_a_byte_changed_is_not_handed_on(path: Path, at: int) -> None:
    """Although length and time of the file are those that they were."""
    before, times = path.read_bytes(), path.stat()
    steady = UnchangedFile(path, 1 << 30)
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"x")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    pieces = steady.pieces()
    for number in range(at // PIECE_BYTES):
        assert next(pieces) == before[number * PIECE_BYTES :][:PIECE_BYTES]
    with pytest.raises(BadInputError, match="table: was changed after it was checked"):
        next(pieces)


@pytest.mark.parametrize("left_bytes", [0, 100, 2 * PIECE_BYTES])
def test_a_file_that_became_shorter_is_refused(path: Path, left_bytes: int) -> None:
    steady = UnchangedFile(path, 1 << 30)
    os.truncate(path, left_bytes)
    with pytest.raises(BadInputError, match="was changed after it was checked"):
        list(steady.pieces())


def test_a_file_that_is_gone_or_no_file_any_more_is_refused(path: Path) -> None:
    steady = UnchangedFile(path, 1 << 30)
    path.unlink()
    with pytest.raises(BadInputError, match="No such file"):
        list(steady.pieces())
    os.mkfifo(path)
    with pytest.raises(BadInputError, match="is a pipe, not a file"):
        list(steady.pieces())


def test_an_empty_file_has_no_line(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    steady = UnchangedFile(tmp_path / "empty", 10)
    assert list(steady.pieces()) == list(steady.lines()) == []


def test_lines_end_as_a_csv_reader_wants_them_and_have_no_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "table").write_bytes(b"\xef\xbb\xbfone\r\ntwo\nthree")
    assert list(UnchangedFile(tmp_path / "table", 100).lines()) == ["one\r\n", "two\n", "three"]


def test_a_line_without_end_is_not_collected(tmp_path: Path) -> None:
    with (tmp_path / "table").open("wb") as file:
        file.write(b"one\n")
        file.truncate(200 << 20)  # of zeros, on no disk
    lines = UnchangedFile(tmp_path / "table", 1 << 30).lines()
    assert next(lines) == "one\n"
    with pytest.raises(BadInputError, match=r"row 2: is longer than 4194304 characters"):
        next(lines)


def test_its_bound_is_that_of_a_file(path: Path) -> None:
    with pytest.raises(BadInputError, match=r"bytes long, more than 1000"):
        UnchangedFile(path, 1000)
