"""Recordings on the disk: whole or not at all, within their space, marked ones without limit."""

import json
import math
import os
import shutil
import socket
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from altd.acquisition.kept_frames.store import RecordingStore, Written
from altd.errors import BadInputError
from altd.status.services import KeptRecording, NotKeptError

START = datetime(2026, 11, 20, 1, 23, 45, tzinfo=UTC)
KIB = 1024


def content(size: int) -> object:
    def write(folder: Path) -> Written:
        folder.mkdir(exist_ok=True)
        (folder / "frame").write_bytes(b"x" * size)
        return Written(exposures=3, seconds=0.15)

    return write


class Shelf:
    """A store, and recordings a second apart."""

    def __init__(self, folder: Path, max_bytes: int = 1 << 20) -> None:
        self.folder = folder
        self.store = RecordingStore(folder, max_bytes)
        self.store.open()
        self._number = 0

    def add(self, size: int = 10 * KIB, why: str = "front_spot_missing front") -> KeptRecording:
        self._number += 1
        return self.store.add(why, START + timedelta(seconds=self._number), size, content(size))  # type: ignore[arg-type]

    def names(self) -> list[str]:
        return [kept.name for kept in RecordingStore(self.folder, 0).open()]


def test_a_recording_is_found_by_its_time_and_its_cause(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "new" / "recordings")
    kept = shelf.add()
    assert kept.name == "20261120T012346Z-front_spot_missing-front"
    assert kept.start == "2026-11-20T01:23:46.000Z"
    assert (kept.exposures, kept.seconds, kept.marked) == (3, 0.15, False)
    assert 10 * KIB <= kept.bytes <= 24 * KIB
    assert shelf.store.recordings() == (kept,)
    folder = shelf.store.folder_of(kept.name)
    assert (folder / "frame").stat().st_size == 10 * KIB
    assert json.loads((folder / "kept.json").read_text()) == {**kept.as_object(), "number": 1}


class Elsewhere:
    """The targets of links; nothing of them may be read, counted or removed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "front").mkdir(parents=True)
        for name in ("secret", "front/secret"):
            (folder / name).write_bytes(b"s" * 100 * KIB)
        self._before = self.content()

    def content(self) -> dict[str, bytes]:
        return {str(path): path.read_bytes() for path in self.folder.rglob("*") if path.is_file()}

    def is_untouched(self) -> bool:
        return self.content() == self._before


@pytest.mark.parametrize("kind", ["a file", "a folder", "nothing", "a pipe", "a socket"])
def test_what_is_no_file_of_a_recording_is_neither_read_nor_counted_nor_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    elsewhere, shelf = Elsewhere(tmp_path / "elsewhere"), Shelf(tmp_path / "recordings", 50 * KIB)
    kept = shelf.add()
    odd = shelf.folder / kept.name / "odd"
    with socket.socket(socket.AF_UNIX) as bound:
        if kind == "a pipe":
            os.mkfifo(odd)
        elif kind == "a socket":
            monkeypatch.chdir(odd.parent)  # the name of a socket is short
            bound.bind(odd.name)
        else:
            names = {"a file": "secret", "a folder": "front", "nothing": "none"}
            odd.symlink_to(elsewhere.folder / names[kind])
    (listed,) = shelf.store.recordings()
    assert listed.bytes <= kept.bytes + 4 * KIB
    assert shelf.store.files(kept.name) == ["frame", "kept.json"]
    for file in ("odd", "odd/secret"):
        assert shelf.store.content(kept.name, file) is None
    shelf.add(20 * KIB)
    shelf.add(20 * KIB)
    assert kept.name not in shelf.names()
    assert elsewhere.is_untouched()


@pytest.mark.parametrize("file", ["/etc/passwd", "../frame", "..", ".", "", "a/b/c", "frame/", "fr\0me"])
def test_no_file_s_name_leads_out_of_its_recording(tmp_path: Path, file: str) -> None:
    shelf = Shelf(tmp_path)
    kept = shelf.add()
    assert shelf.store.content(kept.name, "frame") == b"x" * 10 * KIB
    assert shelf.store.content(kept.name, file) is None
    assert shelf.store.content(kept.name, "gone") is None


def test_a_link_to_a_recording_is_none(tmp_path: Path) -> None:
    elsewhere, shelf = Elsewhere(tmp_path / "elsewhere"), Shelf(tmp_path / "recordings", 60 * KIB)
    there = Shelf(elsewhere.folder).add()
    untouched = elsewhere.content()
    (shelf.folder / "linked").symlink_to(elsewhere.folder / there.name)
    assert shelf.store.recordings() == ()
    for call in (shelf.store.files, lambda name: shelf.store.mark(name, is_marked=True)):
        with pytest.raises(NotKeptError, match="there is no such recording"):
            call("linked")
    assert shelf.store.content("linked", "frame") is None
    for _ in range(5):
        shelf.add(20 * KIB)
    assert elsewhere.content() == untouched


def test_two_of_one_second_have_two_names(tmp_path: Path) -> None:
    store = RecordingStore(tmp_path, 1 << 20)
    names = [store.add("asked", START, KIB, content(KIB)).name for _ in range(3)]  # type: ignore[arg-type]
    assert names == ["20261120T012345Z-asked", "20261120T012345Z-asked-2", "20261120T012345Z-asked-3"]


def test_a_clock_that_knows_no_time_gives_no_invented_one(tmp_path: Path) -> None:
    kept = RecordingStore(tmp_path, 1 << 20).add("asked", None, KIB, content(KIB))  # type: ignore[arg-type]
    assert (kept.name, kept.start) == ("unknown-time-asked", None)


def test_the_oldest_make_room(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path, max_bytes=100 * KIB)
    kept = [shelf.add(20 * KIB) for _ in range(8)]
    there = shelf.names()
    assert there == [each.name for each in reversed(kept[-len(there) :])]
    assert 3 <= len(there) <= 5
    assert sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file()) <= 100 * KIB


def test_the_oldest_is_told_by_what_came_first_and_not_by_the_clock(tmp_path: Path) -> None:
    """A unit without a battery begins each day in 1970, and one without a clock knows no day at all."""
    store = RecordingStore(tmp_path, max_bytes=100 * KIB)
    starts = [START, datetime(1970, 1, 1, 0, 9, tzinfo=UTC), None, datetime(1970, 1, 1, tzinfo=UTC)]
    names = [store.add("asked", start, 20 * KIB, content(20 * KIB)).name for start in starts]  # type: ignore[arg-type]
    store.mark(names[2], True)
    last = store.add("asked", datetime(1970, 1, 1, 0, 1, tzinfo=UTC), 20 * KIB, content(20 * KIB)).name  # type: ignore[arg-type]
    assert [kept.name for kept in store.recordings()] == [last, *reversed(names[1:])]


def test_those_of_before_there_were_numbers_are_the_oldest(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path)
    before = [shelf.add() for _ in range(2)]
    for kept in before:
        about = tmp_path / kept.name / "kept.json"
        facts = json.loads(about.read_text())
        del facts["number"]
        about.write_text(json.dumps(facts))
    new = shelf.store.add("asked", datetime(1970, 1, 1, tzinfo=UTC), KIB, content(KIB))  # type: ignore[arg-type]
    assert shelf.names() == [new.name, before[1].name, before[0].name]


def test_a_marked_one_stays(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path, max_bytes=100 * KIB)
    marked = shelf.add(20 * KIB)
    assert shelf.store.mark(marked.name, is_marked=True).marked
    for _ in range(6):
        last = shelf.add(20 * KIB)
    assert marked.name in shelf.names()
    assert last.name in shelf.names()


def test_where_marked_ones_take_all_the_room_nothing_is_removed_and_it_is_said(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path, max_bytes=60 * KIB)
    for _ in range(2):
        shelf.store.mark(shelf.add(20 * KIB).name, is_marked=True)
    before = shelf.names()
    with pytest.raises(NotKeptError, match="no space for up to 0 MB: marked recordings take 0 of 0 MB"):
        shelf.add(30 * KIB)
    assert shelf.names() == before
    with pytest.raises(NotKeptError, match=r"that is more than all of 0 MB \(kept_frames.disk_mb\)"):
        Shelf(tmp_path / "smaller", max_bytes=20 * KIB).add(30 * KIB)
    shelf.store.mark(before[0], is_marked=False)
    shelf.add(15 * KIB)
    assert before[0] not in shelf.names()


def test_a_disk_that_is_nearly_full_keeps_room_for_the_history(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf = Shelf(tmp_path)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=201 << 20))
    with pytest.raises(NotKeptError, match="the disk is nearly full"):
        shelf.add(2 << 20)
    kept = shelf.add(KIB)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=0))
    with pytest.raises(NotKeptError, match="the disk is nearly full"):
        shelf.add(KIB)
    assert shelf.names() == [kept.name], "nothing is removed where that makes no room"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), BadInputError("rec", "is odd")])
def test_what_fails_while_it_is_written_leaves_nothing(tmp_path: Path, error: Exception) -> None:
    def write(folder: Path) -> Written:
        folder.mkdir(exist_ok=True)
        (folder / "half").write_bytes(b"x")
        raise error

    store = RecordingStore(tmp_path, 1 << 20)
    with pytest.raises(NotKeptError, match=r"No space left on device|rec: is odd"):
        store.add("asked", START, KIB, write)
    assert list(tmp_path.iterdir()) == []


def test_one_without_an_exposure_is_none(tmp_path: Path) -> None:
    store = RecordingStore(tmp_path, 1 << 20)
    with pytest.raises(NotKeptError, match="no exposure of all cameras"):
        store.add("asked", START, KIB, lambda _: Written(0, 0.0))
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_daemon_left_half_done_is_removed_at_the_next_start(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path)
    kept = shelf.add()
    (tmp_path / ".under-way-99").mkdir()
    (tmp_path / ".under-way-99" / "half").write_bytes(b"x")
    assert RecordingStore(tmp_path, 1 << 20).open() == (kept,)
    assert [path.name for path in tmp_path.iterdir()] == [kept.name]


def test_what_another_daemon_is_writing_stays(tmp_path: Path) -> None:
    """Another process, because a process that ends releases its lock."""
    script = f"""
import sys, time
from pathlib import Path
from altd.acquisition.kept_frames.store import RecordingStore, Written

def write(folder):
    folder.mkdir(exist_ok=True)
    (folder / "frame").write_bytes(b"x")
    print("writes", flush=True)
    sys.stdin.readline()
    return Written(3, 0.15)

print(RecordingStore(Path({str(tmp_path)!r}), 1 << 20).add("theirs", None, 1, write).name)
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdin is not None
        assert other.stdout is not None
        assert other.stdout.readline() == "writes\n"
        shelf = Shelf(tmp_path)
        ours = shelf.add()
        other.stdin.write("go on\n")
        other.stdin.flush()
        assert other.stdout.read() == "unknown-time-theirs\n"
    assert shelf.names() == ["unknown-time-theirs", ours.name]
    assert shelf.store.content("unknown-time-theirs", "frame") == b"x"


def test_the_header_is_the_last_of_the_files_whatever_the_cameras_are_called(tmp_path: Path) -> None:
    """An archive that ends before it is no recording."""
    shelf = Shelf(tmp_path)
    kept = shelf.add()
    for name in ("recording.json", "frames.csv", "front/0.png", "top/0.png"):
        (tmp_path / kept.name / name).parent.mkdir(exist_ok=True)
        (tmp_path / kept.name / name).write_bytes(b"")
    assert shelf.store.files(kept.name)[-2:] == ["top/0.png", "recording.json"]


@pytest.mark.parametrize("name", ["", ".", "..", "../x", "a/b", "a\x00b", "x" * 200, "ä", ".under-way-1"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    shelf = Shelf(tmp_path / "recordings")
    (tmp_path / "kept.json").write_text("{}")
    for call in (shelf.store.folder_of, lambda name: shelf.store.mark(name, is_marked=True)):
        with pytest.raises(NotKeptError, match="there is no such recording"):
            call(name)


ABOUT = {"why": "a", "start": None, "seconds": 1.5, "exposures": 3, "bytes": 1, "marked": False, "number": 7}


@pytest.mark.parametrize(
    "about",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b"\xff",
        b"[" * 4000,
        *(
            json.dumps({**ABOUT, **facts}).encode()
            for facts in (
                {"why": 1},
                {"why": "a" * 1000},
                {"why": "a\x1b[2J"},
                {"why": "\ud800"},
                {"start": "yesterday"},
                {"start": 5},
                {"start": "2026-11-20T01:23:46+01:00"},
                {"seconds": "x"},
                {"seconds": math.nan},
                {"seconds": math.inf},
                {"seconds": -1},
                {"seconds": True},
                {"exposures": -1},
                {"exposures": 1.5},
                {"exposures": 10**30},
                {"number": -1},
                {"number": 10**30},
                {"number": math.nan},
            )
        ),
    ],
)
def test_one_that_cannot_be_believed_is_listed_and_counted_and_goes_first(
    tmp_path: Path, about: bytes
) -> None:
    shelf = Shelf(tmp_path, max_bytes=70 * KIB)
    older, damaged = shelf.add(), shelf.add()
    (tmp_path / damaged.name / "kept.json").write_bytes(about)
    kept = shelf.store.recordings()[-1]
    facts = {"name": damaged.name, "why": "unknown: kept.json is damaged", "start": None, "seconds": 0.0}
    assert kept.as_object() == {**facts, "exposures": 0, "bytes": kept.bytes, "marked": False}
    assert 12 * KIB <= kept.bytes <= damaged.bytes
    assert shelf.store.content(kept.name, "frame") == b"x" * 10 * KIB
    shelf.add(20 * KIB)
    last = shelf.add(20 * KIB)
    assert damaged.name not in shelf.names()
    assert {older.name, last.name} <= set(shelf.names())


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_a_description_that_is_no_file_is_not_read(tmp_path: Path, kind: str) -> None:
    shelf = Shelf(tmp_path / "recordings")
    kept = shelf.add()
    about = shelf.folder / kept.name / "kept.json"
    shutil.move(about, tmp_path / "about.json")
    {"link": lambda: about.symlink_to(tmp_path / "about.json"), "folder": about.mkdir}.get(
        kind, lambda: os.mkfifo(about)
    )()
    (listed,) = shelf.store.recordings()
    assert listed.why == "unknown: kept.json is damaged"
    with pytest.raises(NotKeptError, match=r"kept.json: is a"):
        shelf.store.mark(kept.name, is_marked=True)


@pytest.mark.parametrize("said", [-1e15, math.nan, 10**15, "x", None])
def test_what_a_recording_takes_is_counted_and_not_believed(tmp_path: Path, said: object) -> None:
    shelf = Shelf(tmp_path, max_bytes=100 * KIB)
    kept = shelf.add(60 * KIB)
    about = tmp_path / kept.name / "kept.json"
    about.write_text(json.dumps({**json.loads(about.read_text()), "bytes": said}))
    assert shelf.store.recordings() == (kept,)
    last = shelf.add(60 * KIB)
    assert shelf.names() == [last.name]


def test_the_mark_of_one_that_is_damaged_counts_and_can_be_taken_away(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path, max_bytes=100 * KIB)
    marked = shelf.add(60 * KIB)
    (tmp_path / marked.name / "kept.json").write_text('{"seconds": NaN, "marked": true}')
    with pytest.raises(NotKeptError, match="marked recordings take"):
        shelf.add(60 * KIB)
    assert not shelf.store.mark(marked.name, is_marked=False).marked
    assert shelf.names() == [marked.name]
    last = shelf.add(60 * KIB)
    assert shelf.names() == [last.name]


def test_what_a_power_cut_left_of_one_that_was_removed_does_not_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(left: Path, ignore_errors: bool = False) -> None:
        if not ignore_errors:
            (left / "kept.json").unlink()
            raise OSError(5, "the power is cut")

    shelf = Shelf(tmp_path, max_bytes=100 * KIB)
    shelf.add(60 * KIB)
    with monkeypatch.context() as broken:
        broken.setattr(shutil, "rmtree", cut)
        with pytest.raises(NotKeptError, match="the power is cut"):
            shelf.add(60 * KIB)
    assert shelf.names() == []
    assert list(tmp_path.iterdir()) == []
