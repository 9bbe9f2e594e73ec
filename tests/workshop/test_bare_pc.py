"""docs/install.md and docs/maintain.md on a clean Debian, from a package to its removal.

Under Python 3.11 that is Debian 12, under 3.13 Debian 13: a package is for the Python that makes it.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from support.bare_debian import BareDebian, bare_debian, install_debian
from support.documented import commands_of
from support.foreign import need, need_program
from support.places import DOCS, ROOT

PAGE, MAINTAIN = "install.md", "maintain.md"
SETTINGS_FILE = "etc/altd/altd.toml"
GOOD = "verdict  good"
SETTINGS = {'"ALT-0001"': '"SIM-1"', '"22334455"': '"SIM-1-front"', '"22334456"': '"SIM-1-rear"'}
"""The technician's changes to the settings of the release."""
SUITES = {(3, 11): "bookworm", (3, 13): "trixie"}
MAX_INSTALLED_MIB = 150
ARCHIVE = "dist/altd_0.1.0_amd64.deb"
AS_VERSION = (
    "rm -rf tree && dpkg-deb -R dist/altd_0.1.0_*.deb tree",
    "find tree -type f -path '*DEBIAN/[cp]*' -o -type f -path '*bin/altd' -o -path '*/altd/__init__.py' |"
    " xargs sed -i 's/0\\.1\\.0/VERSION/'",
    "find tree -path '*/altd/__pycache__/__init__*' -delete",
)
"""Make another release of a package, in ``tree``."""
DEFECT = (
    "file=$(find tree -name service_manager.py) && rm $(dirname $file)/__pycache__/service_manager* && "
    "sed -i 's/^        self._log_status(line, now_ns)$/        os._exit(1)/' $file && grep -q _exit $file"
)
"""A daemon that reports that it is ready, and ends then."""
AS_PACKAGE = "dpkg-deb --root-owner-group -Zgzip -z1 --build tree dist"

pytestmark = pytest.mark.timeout(1800)


def run_here(folder: Path, line: str) -> None:
    line = line.replace("make deb", ".venv/bin/python -m tools.deb")
    line = line.replace(".venv/bin/python", sys.executable).replace("~/.ssh", str(folder))
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1795161600"}
    done = subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, (line, done.stderr)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """Of two gigabytes, which are not kept."""
    with tempfile.TemporaryDirectory(prefix="altd-bare-") as name:
        yield Path(name)


@pytest.fixture(scope="module")
def release(folder: Path) -> Path:
    """A clone with the packages of three releases in ``dist``, made and signed as the page says."""
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
    for version, defect in (("0.2.0", "true"), ("0.3.0", DEFECT)):
        for line in (*AS_VERSION, defect, AS_PACKAGE, made[-1]):
            run_here(
                clone, line.replace("VERSION", version).replace(ARCHIVE, ARCHIVE.replace("0.1.0", version))
            )
    return clone


@pytest.fixture(scope="module")
def base(folder: Path) -> Path:
    """A clean Debian. Only root may make one."""
    need(os.geteuid() == 0, "only root may boot a Debian in namespaces")
    need(sys.version_info[:2] in SUITES, "a Debian with this Python is not installed here")
    need_program("ssh-keygen", "openssh-client")
    need_program("arv-fake-gv-camera-0.8", "aravis-tools")
    root = folder / "base"
    root.mkdir()
    install_debian(root, SUITES[sys.version_info[:2]])
    return root


@pytest.fixture(scope="module")
def machine(base: Path, folder: Path) -> Iterator[BareDebian]:
    """The PC of a unit."""
    with booted(base, folder / "root") as debian:
        yield debian


@contextmanager
def booted(base: Path, root: Path) -> Iterator[BareDebian]:
    subprocess.run(["cp", "-a", base, root], check=True)
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
        if re.match("altd (doctor|status)", line):  # both find faults in a simulated unit
            return self._machine.run(line).stdout
        if line.startswith("altd password "):
            line = f"echo 'a new password' | {line}"
        if line.startswith(("apt install ", "apt-get install ")):
            # a package's scripts must not change the host's network
            self._machine.run(f"{line} --download-only", self._folder, online=True)
        done = self._machine.run(line, self._folder, online=line == "apt-get update")
        assert done.returncode == expected_status, (line, done.stdout, done.stderr)
        return done.stdout + done.stderr

    def edit(self, *changes: tuple[str, str]) -> None:
        """Replace words of the settings."""
        text = self.settings.read_text()
        for written, wanted in changes:
            assert written in text
            text = text.replace(written, wanted)
        self.settings.write_text(text)


def test_the_package_is_small_and_of_good_form(release: Path, folder: Path) -> None:
    package = release / ARCHIVE
    lintian = [need_program("lintian"), "--fail-on=error,warning", package]
    judged = subprocess.run(lintian, capture_output=True, text=True, check=False)
    assert judged.returncode == 0, judged.stdout
    field = ["dpkg-deb", "-f", package, "Installed-Size"]  # KiB (Debian policy, 5.6.20)
    size_kib = subprocess.run(field, capture_output=True, text=True, check=True).stdout
    assert int(size_kib) <= MAX_INSTALLED_MIB * 1024
    subprocess.run(["dpkg-deb", "-x", package, folder / "unpacked"], check=True)
    sources = list((folder / "unpacked").rglob("site-packages/altd/**/*.py"))
    assert len(sources) > 100
    lacking = [file for file in sources if not Path(cache_from_source(file)).is_file()]
    assert lacking == [], "the service may write no byte code: each start would compile it again"


def test_equal_sources_give_equal_packages(release: Path) -> None:
    package = release / ARCHIVE
    before = package.read_bytes()
    run_here(release, "make deb")
    assert package.read_bytes() == before


def test_the_steps_lead_to_a_unit_that_measures(release: Path, machine: BareDebian, stage: Path) -> None:
    for file in (*release.glob("dist/altd_*"), release / "altd-release.signers"):
        shutil.copy(file, machine.root / "root")
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
    assert "SIMULATED, not live" in started  # and so no value: a service does not rehearse
    assert GOOD in started
    technician.enter("systemctl is-active altd && systemctl is-enabled altd && systemctl stop altd")

    stage.write_bytes(b"G21 G90 G0 X20 Y-10\n")  # as the page says
    technician.enter(f"systemd-run --quiet --unit=rehearsal altd run --rehearsal --config /{SETTINGS_FILE}")
    x_mm, y_mm, yaw_deg, pitch_deg, *_ = read_by_modbus(machine)
    assert (x_mm, y_mm) == pytest.approx((20.0, -10.0), abs=0.02)
    assert (yaw_deg, pitch_deg) == pytest.approx((0.0, 0.0), abs=0.005)
    technician.enter("systemctl stop rehearsal && systemctl start altd")


def test_a_service_that_fails_comes_back(machine: BareDebian, stage: Path) -> None:
    technician = Technician(machine)
    for ended, result in (("KILL", "signal"), ("STOP", "watchdog")):  # the second one hangs
        pid = main_pid(technician)
        technician.enter(f"kill -{ended} {pid}")
        deadline = time.monotonic() + 60
        while main_pid(technician) == pid:
            assert time.monotonic() < deadline, technician.enter("journalctl -n 20")
            time.sleep(0.2)
        reports(technician)
        assert f"result '{result}'" in technician.enter("journalctl -u altd | grep result | tail -n 1")


def test_two_units_on_one_pc(machine: BareDebian, stage: Path) -> None:
    technician = Technician(machine)
    other = technician.settings.with_name("press.toml")
    own_port = technician.settings.read_text().replace("[modbus_tcp]", "[modbus_tcp]\nport = 503")
    other.write_text(own_port.replace("[http]", ""))
    technician.follow("Several units")
    assert "unit         SIM-1" in reports(technician, "--config /etc/altd/press.toml")
    assert main_pid(technician) != main_pid(technician, "altd@press")
    assert "history.db\n" in technician.enter("ls /var/lib/altd-press")
    technician.enter("systemctl disable --now altd@press")
    other.unlink()


def test_an_update_goes_well_or_back(machine: BareDebian, stage: Path) -> None:
    technician = Technician(machine)
    running, events = main_pid(technician), starts(technician)
    good = technician.settings.read_text()
    technician.settings.write_text(f"{good}\n[no_such_table]\n")
    refused = technician.enter("apt install -y ./altd_0.2.0_amd64.deb", expected_status=100)
    assert "no_such_table" in refused
    assert "altd: 0.2.0 does not accept /etc/altd/altd.toml: 0.1.0 runs on" in refused
    assert main_pid(technician) == running, "it was not even restarted"
    technician.settings.write_text(good)
    technician.enter("dpkg --configure altd")
    assert "altd 0.2.0\n" in technician.enter("altd --version")
    assert main_pid(technician) != running

    refused = technician.enter("apt install -y ./altd_0.3.0_amd64.deb", expected_status=100)
    assert "altd: rolled back to 0.2.0" in refused
    assert "altd 0.2.0, calibration" in reports(technician)
    technician.enter("apt install -y --allow-downgrades ./altd_0.1.0_amd64.deb")
    assert "altd 0.1.0, calibration" in reports(technician)

    assert technician.follow("Update", MAINTAIN).count("altd 0.2.0") == 2  # the last one is of the daemon
    assert "altd 0.1.0\n" in technician.follow("Roll back", MAINTAIN)
    assert "altd 0.1.0, calibration" in reports(technician)
    assert technician.enter("ls -d /usr/lib/altd/[0-9]*").split() == [
        "/usr/lib/altd/0.1.0",
        "/usr/lib/altd/0.2.0",
    ]
    assert starts(technician)[: len(events)] == events, "the history is kept"
    assert len(starts(technician)) > len(events) + 4

    technician.edit(("[http]\n", "[http]\nport = 8081\n"))
    assert "settings reloaded: http.port" in technician.follow("Reload the settings", MAINTAIN)
    technician.edit(("port = 8081\n", "ports = 8081\n"))
    technician.enter("systemctl reload altd", expected_status=1)
    refused = technician.enter("systemctl is-active altd && journalctl -u altd -o cat -n 20")
    assert re.search(
        r"settings refused, the old ones remain in use: /etc/altd/altd.toml: line .*http\.ports", refused
    )
    technician.edit(("ports = 8081\n", ""))
    assert "settings reloaded: http.port" in technician.follow("Reload the settings", MAINTAIN)


def test_a_unit_is_maintained(machine: BareDebian, stage: Path, base: Path, folder: Path) -> None:
    technician = Technician(machine)
    technician.enter("systemctl stop altd")
    technician.follow("Change credentials", MAINTAIN)
    technician.edit(("[http]\n", '[http]\ncredentials = "/etc/altd/credentials"\n'))
    technician.enter("systemctl start altd")
    well = reports(technician).partition("\nok ")[2]
    assert "http 0.0.0.0:8080" in " ".join(well.split())

    technician.follow("Back up", MAINTAIN)
    kept = "sha256sum /etc/altd/*; stat -c '%U %G %a' /etc/altd/*"
    before, events = technician.enter(kept), starts(technician)
    assert "stop it first" in technician.enter("altd restore unit.tar.gz", expected_status=2)
    technician.enter("altd diagnose -o running.zip")
    remove, purge = commands_of(MAINTAIN, "Remove altd")
    technician.enter(remove)
    technician.enter("! systemctl is-active altd")
    assert technician.enter(kept) == before
    technician.enter(purge)
    places = "/etc/altd /var/lib/altd* /usr/lib/altd /usr/bin/altd"
    assert technician.enter(f"ls -d {places} 2>/dev/null; true") == ""

    with booted(base, folder / "second") as second:
        for file in (*machine.root.glob("root/altd*"), machine.root / "root" / "unit.tar.gz"):
            shutil.copy(file, second.root / "root")
        technician = Technician(second)
        technician.follow("2. ")
        for line in commands_of(MAINTAIN, "Restore"):
            if not line.endswith("selfcheck"):  # it has no cameras
                technician.enter(line)
        assert technician.enter(kept) == before
        assert "unit         SIM-1" in reports(technician)
        assert starts(technician)[: len(events)] == events
        technician.edit(('"SIM-1"', '"SIM-2"'))
        refused = technician.enter("altd check-config", expected_status=2)
        assert "calibration.json: is for unit 'SIM-1', this is unit 'SIM-2'" in refused
        technician.enter("systemctl stop altd")
        refused = technician.enter("altd restore unit.tar.gz", expected_status=2)
        assert "is of unit 'SIM-2', the backup is of 'SIM-1'" in refused


def main_pid(technician: Technician, unit: str = "altd") -> str:
    """Process of a service once systemd counts it as started: before, no watchdog waits for its signals."""
    deadline = time.monotonic() + 60
    while True:
        said = technician.enter(f"systemctl show -p ActiveState,MainPID {unit}")
        shown = dict(line.split("=") for line in said.split())
        if shown["ActiveState"] == "active":
            return shown["MainPID"]
        assert time.monotonic() < deadline, technician.enter(f"systemctl status {unit}; true")
        time.sleep(0.2)


def starts(technician: Technician) -> list[str]:
    return technician.enter("altd events --kind started --history /var/lib/altd/history.db").splitlines()


def reports(technician: Technician, options: str = "") -> str:
    """Output of `altd status`, once the daemon has measured or knows why not."""
    deadline = time.monotonic() + 60
    while "state  " not in (said := technician.enter(f"altd status {options}; true")):
        assert time.monotonic() < deadline, said
        time.sleep(0.5)
    return said


ELSEWHERE = {"clock", "camera front", "camera rear", "serial"}
"""The doctor's faults here: no time server, cameras on the loopback interface, a pseudo-terminal."""


def outputs(section: str) -> list[str]:
    (text,) = [part for part in (DOCS / PAGE).read_text().split("\n## ") if part.startswith(section)]
    return text.split("```")[1].strip().splitlines()


def wrong(text: str) -> list[str]:
    return re.findall(r"^ERROR +(.*)$", text, re.MULTILINE)


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
