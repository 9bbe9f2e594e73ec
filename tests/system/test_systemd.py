"""The unit file before systemd's own judge, and the daemon's words to systemd on a real socket."""

import ipaddress
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.cli import altd_here, refusal
from support.foreign import need
from support.places import ROOT
from support.played_unit import PlayedUnit
from support.recordings import write_beams
from support.unit_toml import write_config

from altd.app.settings import service_name
from tools.deb import units

UNIT = ROOT / "systemd" / "altd.service"
WIDEST_PAUSE_S = 2.0
"""Between two words of a daemon that is well: ten times what it aims at, for a busy machine."""


def settings(unit: str) -> dict[str, str]:
    lines = (line.partition("=") for line in unit.splitlines() if not line.startswith(("#", "[")))
    return {key: value for key, _, value in lines if key}


@pytest.fixture(scope="module", params=["altd.service", "altd@press.service"])
def unit_copy(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unit as it is, but for a program that exists here: a missing one is a complaint too."""
    name: str = request.param
    text = units()[name.replace("press", "")]
    program = settings(text)["ExecStart"].split()[0]
    copy = tmp_path_factory.mktemp("unit") / name
    copy.write_text(text.replace(program, sys.executable))
    return copy


class TestUnitFile:
    def test_systemd_has_nothing_to_say_about_it(self, unit_copy: Path) -> None:
        judged = subprocess.run(
            [systemd_analyze(), "verify", unit_copy], capture_output=True, text=True, check=False
        )
        assert (judged.stdout, judged.stderr, judged.returncode) == ("", "", 0)

    def test_its_exposure_is_low(self, unit_copy: Path) -> None:
        judge = [systemd_analyze(), "security", "--offline=true", "--threshold=15", "--no-pager", unit_copy]
        judged = subprocess.run(judge, capture_output=True, text=True, check=False)
        assert judged.returncode == 0, judged.stdout.splitlines()[-1:] + judged.stderr.splitlines()

    def test_an_instance_shares_no_folder_with_another_one(self) -> None:
        one, other = (settings(units()[name]) for name in ("altd.service", "altd@.service"))
        names = ("StateDirectory", "RuntimeDirectory", "ExecStart", "ExecReload", "ExecStopPost")
        assert {key for key in one if one[key] != other.get(key)} == {"Description", *names}
        assert all("%i" in other[key] for key in names)
        place = Path(other["ExecStart"].split()[-1].replace("%i", "press"))
        assert service_name(place) == other["RuntimeDirectory"].replace("%i", "press")

    def test_it_talks_to_no_public_network(self) -> None:
        unit = settings(UNIT.read_text())
        names = {"localhost": "127.0.0.0/8", "link-local": "169.254.0.0/16"}
        allowed = [ipaddress.ip_network(names.get(word, word)) for word in unit["IPAddressAllow"].split()]
        assert unit["IPAddressDeny"] == "any"
        assert all(network.is_private for network in allowed)
        assert any(ipaddress.ip_address("255.255.255.255") in network for network in allowed)  # discovery

    def test_a_bad_config_is_not_tried_again(self, tmp_path: Path) -> None:
        unit = settings(UNIT.read_text())
        program, *arguments, config = unit["ExecStart"].split()
        refused = altd_here(*arguments, tmp_path / Path(config).name)
        assert Path(program).name == "altd"
        assert "altd.toml: No such file" in refusal(refused)
        assert unit["Restart"] == "on-failure"
        assert unit["RestartPreventExitStatus"] == str(refused.status)

    def test_the_lamps_are_left_in_a_way_that_altd_knows(self, config: Path) -> None:
        unit = settings(UNIT.read_text())
        program, *arguments, _ = unit["ExecStopPost"].removeprefix("-").split()
        assert program == unit["ExecStart"].split()[0]
        after = altd_here(*arguments, config)
        assert (after.status, after.out, after.err) == (0, "", "")

    def test_every_group_that_it_asks_for_is_debians_or_made(self, tmp_path: Path) -> None:
        program = shutil.which("systemd-sysusers") or ""
        need(bool(program), "systemd-sysusers is not installed (Debian package systemd)")
        debians = Path("/usr/share/base-passwd/group.master")
        need(debians.exists(), "this is no Debian: base-passwd is not there")
        (tmp_path / "etc").mkdir()
        make = [program, f"--root={tmp_path}", "-"]
        subprocess.run(
            make, input=UNIT.with_suffix(".sysusers").read_bytes(), check=True, capture_output=True
        )
        made = tmp_path / "etc" / "group"
        there = {line.split(":")[0] for file in (debians, made) for line in file.read_text().splitlines()}
        assert set(settings(UNIT.read_text())["SupplementaryGroups"].split()) <= there


def systemd_analyze() -> str:
    program = shutil.which("systemd-analyze") or ""
    need(bool(program), "systemd-analyze is not installed (Debian package systemd)")
    version = subprocess.run(
        [program, "--version"], capture_output=True, text=True, check=True
    ).stdout.split()[1]
    need(int(version) >= 252, f"systemd-analyze {version} cannot judge a file; 252 can")
    return program


class Daemon:
    """``altd run`` with this test in systemd's place."""

    def __init__(self, process: subprocess.Popen[str], link: socket.socket) -> None:
        self.process = process
        self._link = link

    def word(self) -> list[str]:
        """The assignments of the next datagram."""
        return self._link.recv(4096).decode().splitlines()

    def is_quiet(self, seconds: float) -> bool:
        """Whether nothing comes for so long."""
        self._link.settimeout(seconds)
        try:
            self._link.recv(4096)
        except TimeoutError:
            return True
        finally:
            self._link.settimeout(20)
        return False

    def drain(self) -> None:
        while not self.is_quiet(0.05):
            pass

    def end(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20)


@contextmanager
def running(config: Path, folder: Path) -> Iterator[Daemon]:
    address = folder / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(address))
        link.settimeout(20)
        with subprocess.Popen(
            [sys.executable, "-m", "altd.cli", "run", "--config", config],
            env=os.environ | {"NOTIFY_SOCKET": str(address)},
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                yield Daemon(process, link)
            finally:
                process.kill()


@pytest.fixture(scope="module")
def folder(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration and a recording of a beam, a second long."""
    folder = tmp_path_factory.mktemp("unit")
    shutil.copy(played_unit.calibration, folder / "cal.json")
    write_beams(folder / "beam", [(2.0, -3.0, 0.01, 0.02)], exposures=20)
    return folder


@pytest.fixture
def config(folder: Path, tmp_path: Path) -> Path:
    return write_config(tmp_path / "altd.toml", folder / "cal.json", folder / "beam")


@pytest.mark.waits
class TestDaemonToSystemd:
    def test_is_ready_with_the_first_word_on_the_board_and_then_alive(
        self, config: Path, tmp_path: Path
    ) -> None:
        warming_up = "not measuring: not_live, warming_up, playback"
        measuring = "not measuring: not_live, playback"
        with running(config, tmp_path) as daemon:
            assert daemon.word() == ["READY=1", f"STATUS={warming_up}", "WATCHDOG=1"]
            last_s = time.monotonic()
            for _ in range(8):
                word = daemon.word()
                now_s = time.monotonic()
                assert word in ([f"STATUS={warming_up}", "WATCHDOG=1"], [f"STATUS={measuring}", "WATCHDOG=1"])
                assert now_s - last_s < WIDEST_PAUSE_S
                last_s = now_s
            assert word[0] == f"STATUS={measuring}"
            assert daemon.end() == 0
            assert daemon.process.stderr is not None
            assert "Traceback" not in daemon.process.stderr.read()

    def test_cameras_that_fell_silent_are_said_by_a_daemon_that_is_alive(
        self, config: Path, tmp_path: Path
    ) -> None:
        config.write_text(config.read_text().replace("repeat = true", "repeat = false"))
        silent = "STATUS=not measuring: not_live, front_camera_silent, rear_camera_silent, playback"
        with running(config, tmp_path) as daemon:
            assert daemon.word()[0] == "READY=1"
            while daemon.word() != [silent, "WATCHDOG=1"]:
                pass
            assert daemon.word() == [silent, "WATCHDOG=1"]
            assert daemon.end() == 0

    def test_a_daemon_that_stands_still_is_not_alive(self, config: Path, tmp_path: Path) -> None:
        with running(config, tmp_path) as daemon:
            assert daemon.word()[0] == "READY=1"
            daemon.process.send_signal(signal.SIGSTOP)
            daemon.drain()
            assert daemon.is_quiet(1.0)
            daemon.process.send_signal(signal.SIGCONT)
            assert "WATCHDOG=1" in daemon.word()
            assert daemon.end() == 0
