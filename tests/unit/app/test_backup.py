"""A backup of a unit whose daemon writes; its restoration; damaged, forged and foreign archives."""

import fcntl
import gzip
import io
import itertools
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import tarfile
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd_here, refusal
from support.history import START_S, event, store, write_seconds
from support.history import batch as batch_of
from support.played_unit import PlayedUnit
from support.unit_toml import write_config

from altd.app import operating_time
from altd.app.backup import back_up
from altd.app.operating_time import file_in, read_seconds
from altd.app.restore import BEFORE_RESTORE, restore
from altd.app.settings import restore_marker
from altd.credentials import hashes
from altd.credentials.file import change
from altd.credentials.hashes import PasswordHash
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from altd.history.opening import WriteLock
from altd.history.reader import Reader
from altd.history.schema import MINUTES
from altd.status.proof import unit_number

Members = list[tuple[tarfile.TarInfo, bytes]]
CHECKS = f"self-checks-{unit_number('TEST-1'):08X}.json"


@pytest.fixture
def settings(played_unit: PlayedUnit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Of a unit with credentials, self-checks and a minute of history."""
    etc, data = tmp_path / "etc", tmp_path / "data"
    etc.mkdir()
    data.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(data))
    shutil.copy(played_unit.calibration, etc / "cal.json")
    monkeypatch.setattr(hashes, "SCRYPT_N", 2)
    change(etc / "credentials", "ana", lambda known: known.with_password("ana", PasswordHash.of("a" * 12)))
    (etc / "credentials").chmod(0o640)
    (data / CHECKS).write_text("{}")
    more = f'[http]\ncredentials = "{etc}/credentials"\n[local]\nsocket = "{tmp_path}/altd.sock"\n'
    kept = store(data)
    write_seconds(kept, START_S, [1.0] * 60, rate=2)
    kept.end(None)
    return write_config(etc / "altd.toml", Path("cal.json"), played_unit.beams, more)


@pytest.fixture
def archive(settings: Path, tmp_path: Path) -> Path:
    """The backup of that unit."""
    assert back_up(settings, tmp_path / "unit.tar.gz") == []
    return tmp_path / "unit.tar.gz"


def state(settings: Path) -> Mapping[str, tuple[bytes, int]]:
    """Content and mode of every file of the unit."""
    folders = settings.parent, settings.parent.parent / "data"
    return {
        str(path): (path.read_bytes(), path.stat().st_mode)
        for folder in folders
        for path in folder.rglob("*")
        if path.is_file() and not path.name.endswith((".lock", "-wal", "-shm"))
    }


@pytest.mark.parametrize(("own_s", "after_s"), [(None, 7200.0), (60.0, 7200.0), (9000.0, 9000.0)])
def test_a_restore_does_not_turn_the_operating_time_back(
    settings: Path, tmp_path: Path, own_s: float | None, after_s: float
) -> None:
    """A new PC has none, or that since its installation; the same PC has more than its backup."""
    path = file_in(tmp_path / "data", "TEST-1")
    operating_time.write_seconds(path, 7200.0)
    assert back_up(settings, tmp_path / "unit.tar.gz") == []
    path.unlink()
    if own_s is not None:
        operating_time.write_seconds(path, own_s)
    restore(tmp_path / "unit.tar.gz", settings)
    assert read_seconds(path) == after_s


def test_a_lost_unit_is_as_it_was(settings: Path, archive: Path) -> None:
    before = state(settings)
    shutil.rmtree(settings.parent)
    shutil.rmtree(settings.parent.parent / "data")
    assert restore(archive, settings) == "TEST-1"
    after = state(settings)
    assert {Path(of).name for of in after} == {"altd.toml", "cal.json", "credentials", CHECKS, "history.db"}
    history = str(settings.parent.parent / "data" / "history.db")
    assert {name: after[name] for name in after if name != history} == {
        name: before[name] for name in before if name != history
    }
    with Reader(Path(history)) as reader:
        assert sum(point.n for point in reader.summaries(MINUTES, 0, 2**62)) == 120
    assert archive.stat().st_mode & 0o777 == 0o600


def test_a_history_that_is_written_is_copied_as_it_is_at_one_moment(settings: Path, tmp_path: Path) -> None:
    data = settings.parent.parent / "data"
    writing = store(data)
    writing.write(batch_of(START_S + 100, (), [event(7, START_S + 100, text="in the log beside the file")]))
    back_up(settings, tmp_path / "unit.tar.gz")
    writing.write(batch_of(START_S + 101, (), [event(8, START_S + 101, text="later")]))
    writing.end(None)
    restore(tmp_path / "unit.tar.gz", settings)
    with Reader(data / "history.db") as reader:
        texts = [each.text for each in reader.events(0, 2**62)]
    assert "in the log beside the file" in texts
    assert "later" not in texts
    with Reader(data / f"history.db{BEFORE_RESTORE}") as reader:
        assert "later" in [each.text for each in reader.events(0, 2**62)]


def test_a_file_elsewhere_is_named_and_not_in_it(settings: Path, tmp_path: Path) -> None:
    outside = tmp_path / "cal.json"
    (settings.parent / "cal.json").rename(outside)
    settings.write_text(settings.read_text().replace('"cal.json"', f'"{outside}"'))
    (line,) = back_up(settings, tmp_path / "unit.tar.gz")
    assert line.startswith(f"{outside}: not in the backup")


def refused(archive: Path, settings: Path) -> str:
    """Why an archive is refused; nothing may have changed."""
    before = state(settings)
    with pytest.raises(BadInputError) as caught:
        restore(archive, settings)
    assert state(settings) == before
    assert len(caught.value.lines) == 1
    return str(caught.value)


def test_every_damage_is_seen(settings: Path, archive: Path, tmp_path: Path) -> None:
    whole, good = archive.read_bytes(), state(settings)
    chance = random.Random(1)
    damaged = [whole[: round(part * len(whole))] for part in (0, 0.001, 0.1, 0.5, 0.9, 0.999)]
    damaged += [whole[:-9], whole[:-1]]  # the files are whole, the sum of the archive is not
    for _ in range(60):
        at = chance.randrange(len(whole))
        damaged.append(whole[:at] + bytes([whole[at] ^ 1 << chance.randrange(8)]) + whole[at + 1 :])
    seen = 0
    for content in damaged:
        (tmp_path / "damaged").write_bytes(content)
        try:
            restore(tmp_path / "damaged", settings)
        except BadInputError:
            seen += 1
            assert state(settings) == good
        else:  # in the time or the name that gzip's header has, which nothing reads
            assert gzip.decompress(content) == gzip.decompress(whole)
            good = state(settings)
    assert seen > 62


def rewritten(archive: Path, edit: Callable[[Members], Members]) -> Path:
    with tarfile.open(archive) as read:
        members = [(each, (read.extractfile(each) or io.BytesIO()).read()) for each in read]
    with tarfile.open(archive, "w:gz", format=tarfile.PAX_FORMAT) as written:
        for member, content in edit(members):
            written.addfile(member, io.BytesIO(content))
    return archive


def with_index(members: Members, change_index: Callable[[dict[str, object]], object]) -> Members:
    """An index that an attacker has changed, with its checksum."""
    index = json.loads(members[0][1])
    del index["checksum"]
    change_index(index)
    index["checksum"] = checksum_of(index)
    content = json.dumps(index).encode()
    members[0][0].size = len(content)
    return [(members[0][0], content), *members[1:]]


def with_file(members: Members, name: str, content: bytes) -> Members:
    """A file that an attacker has changed, with its sums."""
    changed = [(member, content if member.name == name else old) for member, old in members]
    for member, new in changed:
        member.size = len(new)

    def enter(index: dict[str, Any]) -> None:
        index["files"][name] |= {"size": len(content), "sha256": sha256(content).hexdigest()}

    return with_index(changed, enter)


def of_kind(kind: bytes) -> Callable[[Members], Members]:
    def edit(members: Members) -> Members:
        for member, _ in members[1:2]:
            member.type, member.linkname, member.size = kind, "/etc/passwd", 0
        return members

    return edit


def renamed(name: str) -> Callable[[Members], Members]:
    """A file with such a name, listed like all others."""

    def edit(members: Members) -> Members:
        old, members[1][0].name = members[1][0].name, name

        def enter(index: dict[str, Any]) -> None:
            files = index["files"]
            files[name] = files.pop(old)

        return with_index(members, enter)

    return edit


def long_header(members: Members) -> Members:
    members[1][0].pax_headers = {"comment": "x" * (1 << 20)}
    return members


@pytest.mark.parametrize(
    "edit",
    [
        of_kind(tarfile.SYMTYPE),
        of_kind(tarfile.LNKTYPE),
        of_kind(tarfile.CHRTYPE),
        of_kind(tarfile.BLKTYPE),
        of_kind(tarfile.FIFOTYPE),
        of_kind(tarfile.DIRTYPE),
        renamed("settings/../../evil"),
        renamed("/etc/evil"),
        renamed("data/.hidden"),
        renamed("elsewhere/evil"),
        long_header,
        lambda members: members[1:],
        lambda members: [*members, members[-1]],
        lambda members: members[:-1],
        lambda members: with_index(members, lambda index: index.update(format="altd-backup/2")),
        lambda members: with_index(members, lambda index: index.update(format=7)),
        lambda members: with_index(members, lambda index: index.update(settings="settings/none")),
        lambda members: with_index(members, lambda index: index.update(more=1)),
        lambda members: with_index(members, lambda index: index.update(serial="TEST-2")),
        lambda members: with_file(members, "settings/altd.toml", b"[unit]\nserial = 'TEST-1'\n"),
        lambda members: with_file(members, "settings/cal.json", b"{}"),
        lambda members: with_file(members, "settings/credentials", b"no credentials"),
    ],
)
def test_a_forged_archive_changes_nothing(
    edit: Callable[[Members], Members], settings: Path, archive: Path, tmp_path: Path
) -> None:
    outside = set(tmp_path.iterdir())
    why = refused(rewritten(archive, edit), settings)
    assert str(tmp_path / "etc" / ".restore") not in why
    assert set(tmp_path.iterdir()) == outside


def test_an_archive_of_another_kind_is_named(settings: Path, tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "other.tar.gz", "w:gz") as other:
        other.add(settings, "altd.toml")
    assert "not an altd backup" in refused(tmp_path / "other.tar.gz", settings)
    (tmp_path / "other.zip").write_bytes(b"PK\x03\x04")
    assert "not an altd backup" in refused(tmp_path / "other.zip", settings)


@pytest.mark.parametrize("now", ["TEST-2", "TEST-1\n["])
def test_a_unit_does_not_become_another_one(now: str, settings: Path, archive: Path) -> None:
    settings.write_text(settings.read_text().replace("TEST-1", now))
    assert "move it away first" in refused(archive, settings)


def test_faulty_settings_of_the_same_unit_are_replaced(settings: Path, archive: Path) -> None:
    good = settings.read_text()
    settings.write_text(f"{good}\n[no_such_table]\n")
    restore(archive, settings)
    assert settings.read_text() == good


KILLED = """
import os, signal, sys
from pathlib import Path
from altd.app import restore
left = int(sys.argv[3])
def killed(call):
    def wrapped(*arguments):
        global left
        returned = call(*arguments)
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return returned
    return wrapped
restore._check_content = killed(restore._check_content)
Path.replace, Path.unlink = killed(Path.replace), killed(Path.unlink)
restore.restore(Path(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.long
def test_a_restore_that_is_killed_is_repeated_and_nothing_is_lost(
    settings: Path, archive: Path, tmp_path: Path
) -> None:
    data = tmp_path / "data"
    files = settings.parent / "cal.json", data / "history.db"
    restored = state(settings)
    restored |= {str(data / "history.db"): (copy_in(archive, "data/history.db"), 0o100644)}
    settings.write_text(f"# of before\n{settings.read_text()}")
    (settings.parent / "cal.json").write_text("{}")
    (data / "history.db-wal").write_bytes(b"the log of before")
    (data / "history.db-shm").write_bytes(b"its index")
    for folder in (settings.parent, data):
        shutil.copytree(folder, tmp_path / "before" / folder.name)
    before = [content for path, (content, _) in state(settings).items() if path in restored]
    old = {path.name: path.read_bytes() for path in (settings, files[0], files[1])}
    for steps in itertools.count():
        for folder in (settings.parent, data):
            shutil.rmtree(folder)
            shutil.copytree(tmp_path / "before" / folder.name, folder)
        (settings.parent / f"altd.toml{BEFORE_RESTORE}").write_text("of an earlier restore")
        command = [sys.executable, "-c", KILLED, archive, settings, steps]
        done = subprocess.run([*map(str, command)], check=False)
        contents = [content for path, (content, _) in state(settings).items() if path in restored]
        if restore_marker(settings).exists():
            for arguments in (("run", "--config", settings), ("check-config", settings)):
                assert "altd restore was interrupted: repeat it" in refusal(altd_here(*arguments)), steps
        else:
            assert contents in (before, [content for content, _ in restored.values()]), steps
        assert restore(archive, settings) == "TEST-1"
        now = state(settings)
        kept = {path: now.pop(path)[0] for path in list(now) if BEFORE_RESTORE in path}
        assert {path: now[path][0] for path in now} == {path: restored[path][0] for path in restored}, steps
        assert kept == {
            f"{settings}{BEFORE_RESTORE}": b"of an earlier restore",
            f"{settings}{BEFORE_RESTORE}.2": old["altd.toml"],
            f"{files[0]}{BEFORE_RESTORE}.2": old["cal.json"],
            f"{files[1]}{BEFORE_RESTORE}.2": old["history.db"],
        }, steps
        log = files[1].with_name(f"history.db{BEFORE_RESTORE}.2-wal")
        assert log.read_bytes() == b"the log of before"
        assert not [path for folder in (settings.parent, data) for path in folder.glob(".*")], steps
        if done.returncode == 0:
            break
    assert steps > 8


def copy_in(archive: Path, member: str) -> bytes:
    with tarfile.open(archive) as opened:
        content = opened.extractfile(member)
        assert content is not None
        return content.read()


def test_a_second_restore_overwrites_nothing_that_the_first_one_kept(settings: Path, archive: Path) -> None:
    places = [settings.with_name(f"altd.toml{BEFORE_RESTORE}{end}") for end in ("", ".2", ".3")]
    for number in range(3):
        settings.write_text(f"# {number}\n{settings.read_text()}")
        restore(archive, settings)
        kept = [place.read_text()[:3] for place in places[: number + 1]]
        assert kept == ["# 0", "# 1", "# 2"][: number + 1]
    restore(archive, settings)  # nothing differs
    assert len(list(settings.parent.glob(f"altd.toml{BEFORE_RESTORE}*"))) == 3


def test_no_file_gets_more_rights_than_a_unit_needs(settings: Path, archive: Path) -> None:
    def enter(index: dict[str, Any]) -> None:
        index["files"]["settings/cal.json"]["mode"] = 0o104777

    restore(rewritten(archive, lambda members: with_index(members, enter)), settings)
    assert (settings.parent / "cal.json").stat().st_mode == 0o100664


def test_it_waits_for_no_other_restore(settings: Path, archive: Path) -> None:
    folder = os.open(settings.parent, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    assert "another restore runs" in refused(archive, settings)
    os.close(folder)


def test_it_waits_for_no_running_daemon(settings: Path, archive: Path, tmp_path: Path) -> None:
    lock = WriteLock(tmp_path / "data" / "history.db")
    assert "stop it first" in refused(archive, settings)
    lock.release()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "altd.sock"))
        listener.listen()  # of a daemon that hangs
        assert "stop it first" in refused(archive, settings)
