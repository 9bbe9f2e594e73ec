"""docs/install.md and docs/maintain.md on a clean Debian, from a release to its removal."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.bare_debian import BareDebian, bare_debian
from support.documented import commands_of
from support.foreign import need, need_program
from support.places import DOCS, ROOT

PAGE, MAINTAIN = "install.md", "maintain.md"
SETTINGS_FILE = "etc/altd/altd.toml"
GOOD = "verdict  good"
SETTINGS = {'"ALT-0001"': '"SIM-1"', '"22334455"': '"SIM-1-front"', '"22334456"': '"SIM-1-rear"'}
"""The technician's changes to the settings of the release."""
NOT_HERE = ("udevadm ", "sysctl ")
"""Commands for a kernel of one's own."""

pytestmark = pytest.mark.timeout(1800)


def run_here(folder: Path, line: str) -> None:
    line = line.replace(".venv/bin/python", sys.executable).replace("~/.ssh", str(folder))
    done = subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (line, done.stderr)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """Of two gigabytes, which are not kept."""
    with tempfile.TemporaryDirectory(prefix="altd-bare-") as name:
        yield Path(name)


@pytest.fixture(scope="module")
def release(folder: Path) -> Path:
    """Archives of two releases, their signatures and the signers' key, made as the page says."""
    need(sys.version_info[:2] == (3, 11), "Debian 12 has Python 3.11: a release for it is made by that")
    clone = folder / "clone"
    clone.mkdir()
    copy = (
        f"git -C {ROOT} ls-files -z | tar -C {ROOT} --null --ignore-failed-read -T - -c | tar -x -C {clone}"
    )
    run_here(folder, copy)
    made, key = [], []
    for line in commands_of(PAGE, "Make a release"):
        (key if line.startswith(("ssh-keygen -t", "echo ")) else made).append(line)
    for line in key:
        run_here(clone, f"{line} -N '' -q" if line.startswith("ssh-keygen") else line)
    made.remove("make test-all")
    for line in made:
        run_here(clone, line)
    run_here(
        clone,
        "sed -i 's/0.1.0/0.2.0/' altd/__init__.py && mkdir altd-0.2.0 && ln altd-0.1.0/*.whl altd-0.2.0",
    )
    run_here(clone, "rm altd-0.2.0/altd-0.1.0*")
    for line in made:
        if " pip download " not in line:
            run_here(clone, line.replace("0.1.0", "0.2.0"))
    return clone


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[BareDebian]:
    """A clean Debian. Only root may make one."""
    need(os.geteuid() == 0, "only root may boot a Debian in namespaces")
    need_program("ssh-keygen", "openssh-client")
    need_program("arv-fake-gv-camera-0.8", "aravis-tools")
    root = folder / "root"
    root.mkdir()
    with bare_debian(root) as debian:
        yield debian


@pytest.fixture(scope="module")
def stage(machine: BareDebian) -> Iterator[Path]:
    """The port of the stage, while it and the cameras have power."""
    with machine.beside([sys.executable, "-m", "hw_sim", "gige", "--seed", "1", "--stage"]) as hardware:
        assert hardware.stdout is not None
        port = Path(hardware.stdout.readline().removeprefix("stage: ").strip())
        assert "Ctrl-C ends it" in hardware.stdout.readline()
        device = re.search(r'"(/dev/serial/.*)"', (ROOT / "config" / "live.toml").read_text())
        assert device is not None
        assert machine.run(f"ln -s {port} {device[1]}").returncode == 0
        yield port


class Technician:
    """Types the lines of the pages."""

    def __init__(self, machine: BareDebian) -> None:
        self._machine = machine
        self._folder = "/root"
        self.settings = machine.root / SETTINGS_FILE

    def follow(self, section: str, page: str = PAGE) -> str:
        """All commands of a section; what they print."""
        return "".join(map(self.enter, commands_of(page, section)))

    def enter(self, line: str, expected_status: int = 0) -> str:
        """One command, which must end so; what it prints."""
        if line.startswith(NOT_HERE):
            return ""
        if line.startswith("cd "):
            self._folder = str(Path(self._folder) / line[3:])
            return ""
        if line.startswith("editor "):
            self.edit(*SETTINGS.items())
            return ""
        if line.startswith("altd record -o flat"):
            flat = self._machine.root / self._folder.lstrip("/") / "flat"
            run_here(ROOT, f".venv/bin/python -m hw_sim flat --seed 1 -o {flat}")
            return ""
        if line.endswith(("altd doctor", "altd status")):  # both find faults in a simulated unit
            return self._machine.run(line).stdout
        if line.startswith("altd password "):
            line = f"echo 'a new password' | {line}"
        online = line.startswith("apt-get ")
        done = self._machine.run(line, self._folder, online=online)
        assert done.returncode == expected_status, (line, done.stdout, done.stderr)
        return done.stdout + done.stderr

    def edit(self, *changes: tuple[str, str]) -> None:
        """Replace words of the settings."""
        text = self.settings.read_text()
        for written, wanted in changes:
            assert written in text
            text = text.replace(written, wanted)
        self.settings.write_text(text)


def test_the_steps_lead_to_a_unit_that_measures(release: Path, machine: BareDebian, stage: Path) -> None:
    for pattern in ("altd-*.tar.gz*", "altd-release.signers"):
        for file in release.glob(pattern):
            file.rename(machine.root / "root" / file.name)
    technician = Technician(machine)

    installed = technician.follow("2. ")
    assert installed.count('Good "altd-release" signature') == 1
    assert "\naltd 0.1.0\n" in installed

    found = technician.follow("3. ")
    assert all(f"device = {serial}" in found for serial in ('"SIM-1-front"', '"SIM-1-rear"'))
    checked = technician.follow("4. ")
    for line in outputs("4. "):
        assert line.replace("ALT-0001", "SIM-1") in checked
    assert {subject(line) for line in wrong(checked)} == {"calibration", *ELSEWHERE}

    assert max(peaks(technician.follow("5. "))) > 200  # the page says what to do
    for camera in ("front", "rear"):
        device = f'device = "SIM-1-{camera}"'
        technician.edit((device, f"exposure.exposure_ms = 1.4\n{device}"))
    technician.enter("rm -r try")
    assert all(90 < peak < 200 for peak in peaks(technician.follow("5. ")))

    calibrated = technician.follow("6. ")
    assert outputs("6. ")[0] in calibrated
    rows = re.findall(r"^(front|rear) +\w+ +(\S+).* (\d+) +tensor", calibrated, re.MULTILINE)
    assert [(name, float(left_out) < 0.05, leds) for name, left_out, leds in rows] == [
        ("front", True, "6"),
        ("rear", True, "6"),
    ]
    assert {subject(line) for line in wrong(calibrated)} == ELSEWHERE

    verified = technician.follow("7. ")
    assert "altd scan: self-check: good\n" in verified
    judged = re.search(r"20 of 20 measurements valid; .* rms x (\S+) mm, y (\S+) mm", verified)
    assert judged is not None
    assert all(float(rms_mm) < 0.02 for rms_mm in judged.groups())

    started = technician.follow("8. ")
    assert "SIMULATED frames or calibration" in started  # and so no value: a service does not rehearse
    assert GOOD in started
    technician.enter("systemctl is-active altd && systemctl is-enabled altd && systemctl stop altd")

    stage.write_bytes(b"G21 G90 G0 X20 Y-10\n")  # as the page says
    technician.enter(f"systemd-run --quiet --unit=rehearsal altd run --rehearsal --config /{SETTINGS_FILE}")
    x_mm, y_mm, yaw_deg, pitch_deg, *_ = read_by_modbus(machine)
    assert (x_mm, y_mm) == pytest.approx((20.0, -10.0), abs=0.02)
    assert (yaw_deg, pitch_deg) == pytest.approx((0.0, 0.0), abs=0.005)
    technician.enter("systemctl stop rehearsal && systemctl start altd")


def test_a_unit_is_maintained(machine: BareDebian, stage: Path) -> None:
    technician = Technician(machine)
    assert technician.follow("Update", MAINTAIN).count("altd 0.2.0") == 2  # the last one is of the daemon
    assert "altd 0.1.0\n" in technician.follow("Roll back", MAINTAIN)
    assert "altd 0.1.0, calibration" in technician.enter("sleep 2; altd status")

    technician.edit(("[http]\n", "[http]\nport = 8081\n"))
    assert "settings reloaded: http.port" in technician.follow("Reload the settings", MAINTAIN)
    technician.edit(("port = 8081\n", "ports = 8081\n"))
    technician.enter("systemctl reload altd", expected_status=1)
    refused = technician.enter("systemctl is-active altd && journalctl -u altd -o cat -n 20")
    assert re.search(r"settings refused, the old ones stay: /etc/altd/altd.toml: line .*http\.ports", refused)
    technician.edit(("ports = 8081\n", ""))
    assert "settings reloaded: http.port" in technician.follow("Reload the settings", MAINTAIN)

    technician.enter("systemctl stop altd")
    technician.follow("Change credentials", MAINTAIN)
    technician.edit(("[http]\n", '[http]\ncredentials = "/etc/altd/credentials"\n'))
    technician.enter("systemctl start altd")
    well = technician.enter("sleep 2; altd status").partition("\nok ")[2]
    assert "http 0.0.0.0:8080" in " ".join(well.split())

    technician.follow("Back up", MAINTAIN)
    kept = "sha256sum /etc/altd/*; altd events --history /var/lib/altd/history.db | head -n 5"
    before = technician.enter(kept)
    technician.follow("Remove altd", MAINTAIN)
    technician.enter("systemctl is-active altd", expected_status=3)
    technician.enter("command -v altd || ls /etc/altd || ls /var/lib/altd || id altd", expected_status=1)

    technician = Technician(machine)
    technician.enter("rm -r altd-0.1.0")
    technician.follow("2. ")
    assert GOOD in technician.follow("Restore", MAINTAIN)
    assert technician.enter(kept) == before
    technician.edit(('"SIM-1"', '"SIM-2"'))
    refused = technician.enter("altd check-config", expected_status=2)
    assert "calibration.json: is for unit 'SIM-1', this is unit 'SIM-2'" in refused


ELSEWHERE = {"clock", "camera front", "camera rear", "serial"}
"""The doctor's faults here: no time server, cameras on the loopback interface, a pseudo-terminal."""


def outputs(section: str) -> list[str]:
    (text,) = [part for part in (DOCS / PAGE).read_text().split("\n## ") if part.startswith(section)]
    return text.split("```")[1].strip().splitlines()


def wrong(text: str) -> list[str]:
    return re.findall(r"^WRONG +(.*)$", text, re.MULTILINE)


def subject(line: str) -> str:
    return re.split(r": | /", line)[0]


def peaks(text: str) -> list[float]:
    return [float(peak) for peak in re.findall(r'"peak": ([0-9.]+)', text)]


def read_by_modbus(machine: BareDebian) -> list[float]:
    """Seven values by the page's command, once they are valid."""
    (line,) = [line for line in commands_of(PAGE, "9. ") if line.startswith("mbpoll ")]
    command = [need_program("mbpoll"), *line.replace("ADDRESS", "127.0.0.1").split()[1:]]
    values: list[float] = []
    for _ in range(120):
        time.sleep(0.5)
        with machine.beside(command) as reader:
            assert reader.stdout is not None
            values = [
                float(value) for value in re.findall(r"^\[\d+\]:\s+(\S+)", reader.stdout.read(), re.MULTILINE)
            ]
        if values and values[0] == values[0]:
            return values
    pytest.fail(f"no valid measurement: {values}; {machine.run('journalctl -n 20').stdout}")
