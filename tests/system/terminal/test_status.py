"""`altd status` and `altd selfcheck` of a real daemon, well, hung, dead and forbidden."""

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.cli import Outcome, altd, altd_here, refusal
from support.foreign import need
from support.local_daemon import LocalDaemon, local_daemon
from support.played_unit import PlayedUnit

from altd.local_socket import NoAnswerError, ask


@pytest.fixture(scope="module")
def unit(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalDaemon]:
    """One for all tests that leave it running."""
    with local_daemon(played_unit, tmp_path_factory.mktemp("unit")) as daemon:
        yield daemon


@pytest.fixture
def ended_unit(played_unit: PlayedUnit, tmp_path: Path) -> Iterator[LocalDaemon]:
    with local_daemon(played_unit, tmp_path) as daemon:
        yield daemon


def said_while_it_measures(unit: LocalDaemon) -> Outcome:
    """On a busy machine the daemon may be without a fresh measurement for a while, and reports it."""
    deadline = time.monotonic() + 60.0
    while not all(
        words in (said := altd_here("status", "--config", unit.config)).out
        for words in ("measuring    PLAYBACK, 0.", "state        CHECK FUNCTION for ")
    ):
        assert time.monotonic() < deadline, said.out
    return said


def test_it_says_what_the_daemon_measures_and_what_to_do(unit: LocalDaemon) -> None:
    said = said_while_it_measures(unit)
    assert (said.status, said.err) == (1, ""), "a recording is played: nothing to steer by"
    lines = said.out.splitlines()
    assert lines[0].startswith("unit         TEST-1, altd ")
    assert lines[1].startswith("state        ")
    assert "  - PLAYBACK of a recording" in said.out
    assert "do not steer by it" in said.out
    assert "\x1b" not in said.out
    assert max(map(len, lines)) < 80
    measured = unit.daemon.measurement()
    (x_line,) = (line for line in lines if line.startswith("  x "))
    assert float(x_line.split()[1]) == pytest.approx(measured["x_mm"], abs=0.1)
    assert "camera front" in said.out.partition("calibration  front")[2]


def test_its_numbers_as_json_are_those_of_http(unit: LocalDaemon) -> None:
    said = altd_here("status", "--socket", unit.socket, "--json")
    (document,) = said.objects
    assert said.status == 1
    measured = unit.daemon.measurement()
    assert document["measurement"].keys() == measured.keys()
    assert document["measurement"]["session"] == measured["session"]
    assert 0 <= measured["sequence"] - document["measurement"]["sequence"] < 200
    assert document["status"]["serial"] == "TEST-1"
    assert document["self_check"]["verdict"] is None


def test_diagnostics_without_an_interface_are_those_of_the_daemon(unit: LocalDaemon, tmp_path: Path) -> None:
    said = altd_here("diagnose", "--config", unit.config, "-o", tmp_path / "d.zip")
    assert (said.status, said.err) == (0, f"altd diagnose: the daemon at {unit.socket} makes the archive\n")
    with zipfile.ZipFile(tmp_path / "d.zip") as archive:
        assert {"status.json", "measurement.json", "metrics.txt", "settings.json"} <= set(archive.namelist())


def test_the_socket_is_for_owner_and_group_and_goes_with_the_daemon(ended_unit: LocalDaemon) -> None:
    unit = ended_unit
    about = unit.socket.lstat()
    assert stat.S_ISSOCK(about.st_mode)
    assert stat.S_IMODE(about.st_mode) == 0o660
    unit.daemon.process.terminate()
    unit.daemon.process.wait(30)
    assert not unit.socket.exists()
    said = altd_here("status", "--config", unit.config)
    assert (said.status, said.out) == (1, "")
    assert said.err.startswith(f"altd status: there is no socket {unit.socket}: the daemon is not running ")


def test_a_second_daemon_is_refused_and_the_first_goes_on(
    unit: LocalDaemon, played_unit: PlayedUnit, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    config = other / "altd.toml"
    config.write_text(unit.config.read_text().split("[http]")[0] + f'[local]\nsocket = "{unit.socket}"\n')
    line = refusal(altd("run", "--config", config))
    assert line == f"altd run: local {unit.socket}: another process listens there"
    assert altd_here("status", "--config", unit.config).out.startswith("unit ")


def test_after_kill_9_the_next_daemon_takes_its_place(
    ended_unit: LocalDaemon, played_unit: PlayedUnit, tmp_path: Path
) -> None:
    unit = ended_unit
    unit.daemon.process.kill()
    unit.daemon.process.wait()
    assert unit.socket.exists(), "nobody removed it"
    said = altd_here("status", "--config", unit.config)
    assert said.err.startswith("altd status: the daemon is not running (start: `sudo systemctl start altd`)")
    assert said.err.endswith(f": nothing listens at {unit.socket}\n")
    with local_daemon(played_unit, tmp_path) as again:
        assert altd_here("status", "--config", again.config).out.startswith("unit ")


@pytest.mark.waits
def test_a_daemon_that_hangs_is_said_so_in_time(unit: LocalDaemon) -> None:
    started = time.monotonic()
    altd("status", "--config", unit.config)
    answered_s = time.monotonic() - started
    unit.daemon.process.send_signal(signal.SIGSTOP)
    begun = time.monotonic()
    said = altd("status", "--config", unit.config)
    took_s = time.monotonic() - begun
    unit.daemon.process.send_signal(signal.SIGCONT)
    assert (said.status, said.err) == (
        1,
        f"altd status: the daemon at {unit.socket} does not answer within 5 s\n",
    )
    assert took_s < 7.0 + 2.0 * answered_s


def test_a_check_is_asked_for_through_the_socket(unit: LocalDaemon) -> None:
    said = altd_here("selfcheck", "--config", unit.config)
    assert (said.status, said.out) == (1, "")
    assert "no [lamps]" in said.err or "LED" in said.err


def test_the_folder_of_the_service_manager_is_where_it_is_without_a_table(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """As systemd starts it: $RUNTIME_DIRECTORY, no [local]; and nowhere else without."""
    for environment, there in (({"RUNTIME_DIRECTORY": str(tmp_path)}, True), ({}, False)):
        process = subprocess.Popen(
            [sys.executable, "-m", "altd.cli", "run", "--config", str(played_unit.config)],
            env={**os.environ, **environment},
            stderr=subprocess.PIPE,
        )
        try:
            assert process.stderr is not None
            line = process.stderr.readline().decode()
            assert (f"local {tmp_path}/altd.sock" in line) == there
            assert (tmp_path / "altd.sock").exists() == there
        finally:
            process.terminate()
            process.communicate()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes somebody else")
class TestSomebodyElse:
    """The message for a user without the right, by the kernel's own refusal."""

    @staticmethod
    def told(path: Path, uid: int = 65534, gid: int = 65534) -> str:
        reading, writing = os.pipe()
        if (child := os.fork()) == 0:
            os.setgroups([])
            os.setgid(gid)
            os.setuid(uid)
            try:
                answer = json.dumps(ask(path, "/", 2.0)[1])
            except NoAnswerError as error:
                answer = str(error)
            os.write(writing, answer.encode())
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as pipe:
            said = pipe.read()
        os.waitpid(child, 0)
        return said

    @pytest.fixture
    def path(self) -> Iterator[Path]:
        """A daemon's socket of root and group dialout, in a folder that lets everybody in."""
        with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX) as server:
            Path(folder).chmod(0o755)
            path = Path(folder, "altd.sock")
            server.bind(str(path))
            os.chown(path, 0, 20)
            path.chmod(0o660)
            yield path

    def test_the_group_is_named(self, path: Path) -> None:
        need(Path("/etc/group").read_text().count("dialout:x:20:") == 1, "no Debian groups here")
        assert self.told(path) == (
            f"{path}: permission denied: it is for user root and group dialout; "
            "join the group, or ask as root"
        )

    def test_the_group_is_let_in(self, path: Path) -> None:
        assert self.told(path, gid=20).endswith(f": nothing listens at {path}")

    def test_a_closed_folder_is_said_so(self, path: Path) -> None:
        path.parent.chmod(0o700)
        assert self.told(path).startswith(f"{path}: permission denied: only the folder's owner")
