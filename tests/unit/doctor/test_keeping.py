"""The daemon's stores and its socket: folders, room, a damaged file, a socket in the way."""

import os
import shutil
import socket
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import pytest
from support.history import START_S, record_seconds
from support.places import ROOT

from altd.doctor import keeping
from altd.process.machine import Account, Finding, Verdict, own_account

from .conftest import Tree, configured, says

SERVICE = "/etc/systemd/system/altd.service"
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def installed(tree: Tree) -> Tree:
    """A computer with the service as it is shipped."""
    tree.write(SERVICE, (ROOT / "systemd/altd.service").read_text())
    return tree


def history(tree: Tree, config: object) -> list[Finding]:
    return list(keeping.history(config, tree.machine))  # type: ignore[arg-type]


class TestFolders:
    @pytest.mark.parametrize("check", [keeping.history, keeping.recordings])
    def test_the_services_own_folder_is_good(self, installed: Tree, check: object) -> None:
        assert callable(check)
        (finding,) = check(configured(), installed.machine)
        assert finding.verdict is Verdict.GOOD
        assert "/var/lib/altd" in finding.text

    def test_one_that_the_service_may_not_write_to(self, installed: Tree) -> None:
        config = configured(history={"file": "/data/history.db"}, kept_frames={"folder": "/data/frames"})
        for findings, folder in (
            (history(installed, config), "/data"),
            (list(keeping.recordings(config, installed.machine)), "/data/frames"),
        ):
            finding = says(findings, Verdict.ERROR, "the service may not write")
            assert f"ReadWritePaths={folder};" in finding.remedy

    def test_one_that_was_given_to_the_service(self, installed: Tree) -> None:
        installed.write(f"{SERVICE}.d/data.conf", "[Service]\nReadWritePaths=-/data")
        config = configured(history={"file": "/data/altd/history.db"})
        assert says(history(installed, config), Verdict.GOOD, "MB free")

    def test_without_a_service_the_folder_must_be_there_and_ours(self, tree: Tree) -> None:
        config = configured(history={"file": "/data/history.db"})
        assert says(history(tree, config), Verdict.ERROR, "no folder /data").remedy == "mkdir -p /data"
        (tree.root / "data").mkdir(mode=0o755)
        stranger = replace(tree, account=Account("somebody", 4242, frozenset()))
        assert says(history(stranger, config), Verdict.ERROR, "somebody may not write to /data")
        assert says(history(replace(tree, account=own_account()), config), Verdict.GOOD, "MB free")

    def test_recordings_make_their_own_folder(self, tree: Tree) -> None:
        config = configured(kept_frames={"folder": "/data/frames"})
        findings = list(keeping.recordings(config, replace(tree, account=own_account()).machine))
        assert says(findings, Verdict.GOOD, "/data/frames")

    def test_without_a_folder_it_is_said_that_nothing_is_kept(self, tree: Tree) -> None:
        config = configured()
        for check in (keeping.history, keeping.recordings, keeping.local_socket):
            assert says(list(check(config, tree.machine)), Verdict.WARNING, "no service is installed").remedy
            unit = {"serial": "D-1", "calibration": "/nowhere/calibration.json", "kind": "desk"}
            findings = list(check(configured(unit=unit), tree.machine))
            assert says(findings, Verdict.SKIPPED, "not required of a desk unit; possible: [")

    def test_what_is_off_is_no_fault(self, tree: Tree) -> None:
        config = configured(history={"enabled": False}, kept_frames={"memory_mb": 0})
        assert says(history(tree, config), Verdict.SKIPPED, "off")
        assert says(list(keeping.recordings(config, tree.machine)), Verdict.SKIPPED, "off")


class TestRoom:
    def test_less_than_it_may_take(self, installed: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, 350 * 10**6))
        config = configured(kept_frames={"disk_mb": 100})
        assert "max_mb" in says(history(installed, config), Verdict.WARNING, "350 MB free").remedy
        findings = list(keeping.recordings(config, installed.machine))
        assert says(findings, Verdict.GOOD, "350 MB free"), "100 MiB, and 200 MiB that stay free"

    def test_what_is_there_is_not_needed_again(
        self, installed: Tree, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, 250 * 10**6))
        config = configured(kept_frames={"disk_mb": 100})
        assert says(list(keeping.recordings(config, installed.machine)), Verdict.WARNING, "250 MB free")
        frame = installed.root / "var/lib/altd/recordings/20261120T080000Z-asked/frame.png"
        frame.parent.mkdir(parents=True)
        with frame.open("wb") as file:
            file.truncate(80 * 10**6)
        assert says(list(keeping.recordings(config, installed.machine)), Verdict.GOOD, "250 MB free")


class TestFile:
    @pytest.fixture
    def path(self, installed: Tree) -> Path:
        folder = installed.root / "var/lib/altd"
        folder.mkdir(parents=True)
        record_seconds(folder, START_S, [10.0] * 200, rate=2)
        return folder / "history.db"

    def test_a_whole_one(self, installed: Tree, path: Path) -> None:
        before = path.read_bytes()
        assert says(history(installed, configured()), Verdict.GOOD, "the file is intact")
        assert path.read_bytes() == before

    def test_a_damaged_one(self, installed: Tree, path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[4096 * 3 : 4096 * 12] = b"\xa5" * 4096 * 9
        path.write_bytes(content)
        finding = says(history(installed, configured()), Verdict.WARNING, "damaged")
        assert finding.remedy.startswith("the daemon")

    def test_one_of_a_newer_program(self, installed: Tree, path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[60:64] = (999).to_bytes(4, "big")  # user_version (sqlite.org/fileformat.html, 1.3)
        path.write_bytes(content)
        assert "sudo mv" in says(history(installed, configured()), Verdict.ERROR, "version 999").remedy


class TestLocalSocket:
    PATH = "/s/altd.sock"

    @pytest.fixture
    def there(self, tree: Tree, monkeypatch: pytest.MonkeyPatch) -> Tree:
        """A computer whose root is the working folder: the path of a socket is short."""
        (tree.root / "s").mkdir()
        monkeypatch.chdir(tree.root)
        return replace(tree, root=Path(), account=own_account())

    def check(self, tree: Tree) -> list[Finding]:
        return list(keeping.local_socket(configured(local={"socket": self.PATH}), tree.machine))

    def test_none_yet(self, there: Tree) -> None:
        assert says(self.check(there), Verdict.GOOD, "the daemon creates it at its start")

    def test_no_folder(self, there: Tree) -> None:
        Path("s").rmdir()
        assert says(self.check(there), Verdict.ERROR, "no folder /s")

    def test_that_of_a_daemon_that_answers_and_of_one_that_was_killed(self, there: Tree) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as daemon:
            daemon.bind("s/altd.sock")
            daemon.listen()
            assert says(self.check(there), Verdict.GOOD, "the daemon answers")
        assert says(self.check(there), Verdict.GOOD, "killed daemon")

    def test_a_file_in_its_place(self, there: Tree) -> None:
        Path("s/altd.sock").touch()
        assert "sudo rm" in says(self.check(there), Verdict.ERROR, "not a socket").remedy

    @pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
    def test_one_that_is_for_others(self, there: Tree) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as daemon:
            daemon.bind("s/altd.sock")
            daemon.listen()
            Path("s/altd.sock").chmod(0o600)
            os.seteuid(4242)
            try:
                findings = self.check(there)
            finally:
                os.seteuid(0)
        assert "sudo altd status" in says(findings, Verdict.WARNING, "may not open it").remedy
