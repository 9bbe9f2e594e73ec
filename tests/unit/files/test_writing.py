import errno
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.devices import full_device
from support.foreign import on_small_disk

from altd.errors import BadInputError
from altd.files.reading import UnchangedFile
from altd.files.writing import check_replaceable, replacing, write_file, write_files


@pytest.fixture(params=[0o022, 0o027, 0o077])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def complaint(path: Path) -> str:
    with pytest.raises(BadInputError) as early:
        check_replaceable(path)
    with pytest.raises(BadInputError) as late:
        write_file(path, b"new")
    assert early.value.message == late.value.message
    return late.value.message


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_file_has_the_mode_that_the_umask_leaves(umask: int, tmp_path: Path) -> None:
    write_file(tmp_path / "file", b"new")
    assert mode(tmp_path / "file") == 0o666 & ~umask
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("kept", [0o600, 0o640, 0o666])
def test_an_older_file_keeps_its_mode(kept: int, umask: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    path.chmod(kept)
    write_file(path, b"new")
    assert (path.read_bytes(), mode(path)) == (b"new", kept)


def test_a_device_a_pipe_and_a_folder_are_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    assert complaint(tmp_path / "pipe") == "is a pipe, not a file that can be replaced"
    assert complaint(tmp_path / "folder") == "is a folder, not a file that can be replaced"
    device = full_device(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    assert complaint(device) == "is a device, not a file that can be replaced"
    assert stat.S_ISCHR(device.stat().st_mode)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_symbolic_link_is_not_replaced_and_says_where_it_leads(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "loop").symlink_to("loop")
    assert complaint(tmp_path / "link") == "is a symbolic link: name the file that it points to, file"
    assert complaint(tmp_path / "loop") == "is a symbolic link: name the file that it points to, loop"
    assert (tmp_path / "file").read_bytes() == b"old"
    (tmp_path / "folder").symlink_to(tmp_path)
    write_file(tmp_path / "folder" / "file", b"new")  # a folder behind a link is a folder
    assert (tmp_path / "file").read_bytes() == b"new"


def test_what_names_no_place_is_refused(tmp_path: Path) -> None:
    for path, why in (
        (tmp_path / "none" / "file", "its folder does not exist"),
        (tmp_path / "a\0b", "is not a path"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(BadInputError, match=why):
            check_replaceable(path)


def test_several_files_are_written_all_or_none(tmp_path: Path) -> None:
    first, second, folder = tmp_path / "a", tmp_path / "b", tmp_path / "folder"
    first.write_bytes(b"older")
    first.chmod(0o640)
    write_files({first: b"1", second: b"2"})
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")
    second.unlink()
    folder.mkdir()
    with pytest.raises(BadInputError, match="is a folder"):
        write_files({first: b"new", second: b"new", folder: b"new"})
    assert first.read_bytes() == b"1"
    assert stat.S_IMODE(first.stat().st_mode) == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "folder"]


FILLING = """
import pathlib, sys
from altd.errors import BadInputError
from altd.files.writing import write_file
path = pathlib.Path(sys.argv[1]) / "file"
write_file(path, b"old")
try:
    write_file(path, b"x" * 200_000)
except BadInputError as error:
    print(error.message, path.read_bytes(), [p.name for p in path.parent.iterdir()])
"""


def test_on_a_full_disk_the_old_file_is_untouched_and_nothing_is_left(tmp_path: Path) -> None:
    """A real disk of 64 kB, in a mount namespace of its own."""
    command = on_small_disk(tmp_path, "64k", f"exec {sys.executable} - {tmp_path}")
    done = subprocess.run(command, input=FILLING, capture_output=True, text=True, check=False)
    assert done.stdout == "No space left on device b'old' ['file']\n", done.stderr


def test_what_is_written_in_pieces_takes_its_place_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    path.chmod(0o640)
    with replacing(path) as file:
        file.write(b"ne")
        assert path.read_bytes() == b"old"
        assert len(list(tmp_path.iterdir())) == 2
        file.write(b"w")
    assert (path.read_bytes(), mode(path)) == (b"new", 0o640)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "failure", [KeyboardInterrupt(), BadInputError("frame", "is torn"), OSError(28, "full")]
)
def test_what_was_not_finished_is_not_there(failure: BaseException, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    said = BadInputError if isinstance(failure, OSError) else type(failure)

    def fail() -> None:
        with replacing(path) as file:
            file.write(b"new")
            raise failure

    with pytest.raises(said):
        fail()
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_device_is_not_written_into_in_pieces(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInputError, match="is a pipe"), replacing(tmp_path / "pipe"):
        pytest.fail("it was opened")


def test_what_cannot_take_its_place_leaves_the_older_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def refused(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "replace", refused)
    with pytest.raises(BadInputError, match="Input/output error"), replacing(path) as file:
        file.write(b"new")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("file", b"old")]


PIECE_BYTES = 1 << 20


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Two and a half pieces of numbered lines."""
    table = tmp_path / "table"
    table.write_text("".join(f"{number:015d}\n" for number in range(5 * PIECE_BYTES // 32)))
    return table


def test_it_is_the_same_each_time(table: Path) -> None:
    steady = UnchangedFile(table, 1 << 30)
    for _ in range(2):
        assert b"".join(steady.pieces()) == table.read_bytes()
        assert "".join(steady.lines()) == table.read_text()


def test_what_is_appended_later_is_not_seen(table: Path) -> None:
    before = table.read_bytes()
    steady = UnchangedFile(table, 1 << 30)
    with table.open("ab") as file:
        file.write(b"more\n")
    assert b"".join(steady.pieces()) == before


@pytest.mark.parametrize("at", [0, PIECE_BYTES - 1, PIECE_BYTES, 5 * PIECE_BYTES // 2 - 1])
def test_a_piece_in_which_a_byte_changed_is_not_handed_on(table: Path, at: int) -> None:
    """Although length and time of the file are those that they were."""
    before, times = table.read_bytes(), table.stat()
    steady = UnchangedFile(table, 1 << 30)
    with table.open("r+b") as file:
        file.seek(at)
        file.write(b"x")
    os.utime(table, ns=(times.st_atime_ns, times.st_mtime_ns))
    pieces = steady.pieces()
    for number in range(at // PIECE_BYTES):
        assert next(pieces) == before[number * PIECE_BYTES :][:PIECE_BYTES]
    with pytest.raises(BadInputError, match="table: was changed after it was checked"):
        next(pieces)


@pytest.mark.parametrize("left_bytes", [0, 100, 2 * PIECE_BYTES])
def test_a_file_that_became_shorter_is_refused(table: Path, left_bytes: int) -> None:
    steady = UnchangedFile(table, 1 << 30)
    os.truncate(table, left_bytes)
    with pytest.raises(BadInputError, match="was changed after it was checked"):
        list(steady.pieces())


def test_a_file_that_is_gone_or_no_file_any_more_is_refused(table: Path) -> None:
    steady = UnchangedFile(table, 1 << 30)
    table.unlink()
    with pytest.raises(BadInputError, match="No such file"):
        list(steady.pieces())
    os.mkfifo(table)
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


def test_its_bound_is_that_of_a_file(table: Path) -> None:
    with pytest.raises(BadInputError, match=r"bytes long, more than 1000"):
        UnchangedFile(table, 1000)
