"""Devices that are missing, forbidden, taken or too slow, each with what mends it."""

import subprocess
from pathlib import Path

import pytest

from altd.devices.gpio import find_chips
from altd.devices.gpio.find_chips import GpioChip, GpioLine
from altd.doctor.checks import found_devices, in_lines
from altd.process.machine import Account, Finding, Verdict, group_name

from .conftest import Tree, configured, driver_findings, says

BY_ID = "/dev/serial/by-id/usb-maker_adapter_1-if00"
UNIT = "/etc/systemd/system/altd.service"


@pytest.fixture
def port(tree: Tree, terminal: Path) -> Path:
    """A serial adapter by its stable name; the device behind it is a terminal of ours."""
    tree.link("/dev/ttyUSB0", terminal)
    tree.link(BY_ID, "../../ttyUSB0")
    tree.write("/proc/devices", "Character devices:\n  4 ttyS\n136 pts\n\nBlock devices:\n136 sd")
    return terminal


def found(tree: Tree, device: str = BY_ID) -> list[Finding]:
    config = configured(serial=[{"device": device, "speaks": "console"}])
    return driver_findings(config, tree)


def test_a_port_that_may_be_opened_is_good(tree: Tree, port: Path) -> None:
    port.chmod(0o666)
    assert says(found(tree), Verdict.GOOD, "somebody may open it")


def test_a_port_of_a_group_that_the_user_is_not_in(tree: Tree, port: Path) -> None:
    port.chmod(0o660)
    group = port.stat().st_gid
    finding = says(found(tree), Verdict.ERROR, "somebody may not open it (crw-rw----")
    assert finding.remedy.startswith(f"sudo usermod -aG {group_name(group)} somebody")
    tree.account = Account("somebody", 4242, frozenset({group}))
    assert says(found(tree), Verdict.GOOD, "somebody may open it")


def test_a_port_that_no_group_may_open_needs_a_rule(tree: Tree, port: Path) -> None:
    port.chmod(0o600)
    assert "udev" in says(found(tree), Verdict.ERROR, "may not open it (crw-------").remedy


class TestTheService:
    def test_it_is_in_no_group_that_may(self, tree: Tree, port: Path) -> None:
        port.chmod(0o660)
        group = group_name(port.stat().st_gid)
        tree.account = Account("root", 0, frozenset())
        tree.write(UNIT, "[Service]\nSupplementaryGroups=nogroup")
        finding = says(found(tree), Verdict.ERROR, "the service may not open it")
        assert finding.remedy == f"sudo systemctl edit altd   # [Service] SupplementaryGroups={group}"
        tree.write(f"{UNIT}.d/override.conf", f"[Service]\nSupplementaryGroups={group}")
        assert says(found(tree), Verdict.GOOD, "root and the service may open it")

    def test_its_unit_does_not_list_the_kind(self, tree: Tree, port: Path) -> None:
        port.chmod(0o666)
        tree.write(UNIT, "[Service]\nDevicePolicy=closed\nDeviceAllow=char-ttyUSB rw")
        finding = says(found(tree), Verdict.ERROR, "does not list its kind, pts")
        assert "DeviceAllow=char-pts rw" in finding.remedy
        tree.write(f"{UNIT}.d/override.conf", "[Service]\nDeviceAllow=char-pts rw")
        assert says(found(tree), Verdict.GOOD, "may open it")
        tree.write(f"{UNIT}.d/zz.conf", "[Service]\nDeviceAllow=\nDeviceAllow=/dev/null rw")  # takes all back
        assert says(found(tree), Verdict.ERROR, "does not list its kind")


def test_a_missing_port_names_those_that_are_there(tree: Tree, port: Path) -> None:
    finding = says(found(tree, "/dev/ttyUSB7"), Verdict.ERROR, f"does not exist; existing: {BY_ID}")
    assert "/dev/serial/by-id" in finding.remedy


def test_a_name_that_leads_nowhere_is_a_missing_port(tree: Tree) -> None:
    tree.link(BY_ID, "../../ttyUSB0")
    assert says(found(tree), Verdict.ERROR, "does not exist")


def test_a_file_is_no_port(tree: Tree) -> None:
    tree.write("/dev/ttyS0", "")
    assert says(found(tree, "/dev/ttyS0"), Verdict.ERROR, "is not a device")


@pytest.mark.parametrize(
    ("name", "verdict", "words", "mend"),
    [
        ("sleep", Verdict.ERROR, "in use by sleep", "sudo kill"),
        ("agetty", Verdict.ERROR, "in use by agetty", "disable --now serial-getty@"),
        ("ModemManager", Verdict.ERROR, "in use by ModemManager", "disable --now ModemManager"),
        ("altd", Verdict.GOOD, "in use by altd", ""),
    ],
)
def test_a_port_that_a_program_has_open(
    tree: Tree, port: Path, tmp_path: Path, name: str, verdict: Verdict, words: str, mend: str
) -> None:
    port.chmod(0o666)
    tree.link("/proc/self", "/proc/self")
    program = tmp_path / name
    program.symlink_to("/bin/sleep")
    with port.open("rb") as opened, subprocess.Popen([program, "60"], stdin=opened) as other:
        tree.link(f"/proc/{other.pid}", f"/proc/{other.pid}")
        try:
            findings = found(tree)
        finally:
            other.kill()
    assert mend in says(findings, verdict, words).remedy
    assert all(finding.verdict is Verdict.GOOD for finding in found(tree))


class TestUsbCameras:
    def cameras(self, tree: Tree, speed_mbit_s: int, buses: tuple[int, int]) -> list[Finding]:
        """Two cameras that need 58 Mbit/s each, on these buses."""
        cameras = {}
        for number, (name, bus) in enumerate(zip(("front", "rear"), buses, strict=True)):
            usb = f"/sys/devices/pci0/usb{bus}/{bus}-{number}"
            tree.write(f"{usb}/busnum", bus)
            tree.write(f"{usb}/speed", speed_mbit_s)
            tree.write(f"{usb}/interface/bInterfaceNumber", "00")
            device = ("/dev/null", "/dev/zero")[number]
            place = f"/sys/dev/char/1:{(3, 5)[number]}"
            tree.link(f"{place}/device", tree.root / f"{usb}/interface".lstrip("/"))
            tree.link(f"/dev/video{number}", device)
            tree.link(f"/dev/v4l/by-path/usb-{number}", f"../../video{number}")
            cameras[name] = {"driver": "v4l2", "device": f"/dev/v4l/by-path/usb-{number}"}
        return driver_findings(configured(cameras=cameras), tree)

    @pytest.mark.parametrize(
        ("speed", "verdict", "said"),
        [(480, Verdict.GOOD, "116 Mbit/s of 480"), (150, Verdict.ERROR, "116 Mbit/s of 150: too much")],
    )
    def test_a_bus_that_is_fast_enough_or_too_slow(
        self, tree: Tree, speed: int, verdict: Verdict, said: str
    ) -> None:
        assert says(self.cameras(tree, speed, (1, 1)), verdict, f"its cameras need {said}")

    def test_a_bus_for_each_would_do(self, tree: Tree) -> None:
        findings = self.cameras(tree, 150, (1, 2))
        assert [f.verdict for f in findings if f.subject.startswith("USB")] == [Verdict.GOOD] * 2

    def test_a_missing_camera_names_those_that_are_there(self, tree: Tree) -> None:
        tree.link("/dev/video0", "/dev/null")
        cameras = {name: {"driver": "v4l2", "device": f"/dev/v4l/{name}"} for name in ("front", "rear")}
        findings = driver_findings(configured(cameras=cameras), tree)
        assert [f.text for f in findings] == ["does not exist; existing: /dev/video0"] * 2


def test_a_gpio_chip_that_is_not_there(tree: Tree) -> None:
    lamps = {"driver": "gpiod", "chip": "lamp-board", "lines": ["LED1"]}
    findings = driver_findings(configured(lamps=lamps), tree)
    assert says(findings, Verdict.ERROR, "no accessible chip has this name; no other exists")


def test_the_gpio_chip_of_the_glasses_is_checked_too(tree: Tree) -> None:
    switches = {"driver": "gpiod", "chip": "glass-board", "lines": ["A", "B"]}
    finding = says(driver_findings(configured(switches=switches), tree), Verdict.ERROR, "no accessible chip")
    assert finding.subject == "gpio glass-board"


def test_a_gpio_chip_that_the_user_may_not_open(tree: Tree, terminal: Path) -> None:
    terminal.chmod(0o600)
    tree.link("/dev/gpiochip0", terminal)
    lamps = {"driver": "gpiod", "chip": "gpiochip0", "lines": ["LED1"]}
    findings = driver_findings(configured(lamps=lamps), tree)
    assert says(findings, Verdict.ERROR, "somebody may not open it")


def test_without_a_config_the_devices_that_are_there_are_tried(tree: Tree, port: Path) -> None:
    port.chmod(0o600)
    findings = list(found_devices(tree.machine))
    assert says(findings, Verdict.ERROR, "somebody may not open it").subject == "serial /dev/ttyUSB0"


def test_without_a_config_on_board_ports_are_tried_that_have_a_uart(tree: Tree, terminal: Path) -> None:
    terminal.chmod(0o600)
    for number, kind in ((0, 4), (1, 0), (2, None)):
        tree.link(f"/dev/ttyS{number}", terminal)
        if kind is not None:  # older kernels show it to root alone
            tree.write(f"/sys/class/tty/ttyS{number}/type", kind)
    findings = list(found_devices(tree.machine))
    tried = [finding.subject for finding in findings if finding.verdict is Verdict.ERROR]
    assert tried == ["serial /dev/ttyS0", "serial /dev/ttyS2"]


def test_where_no_device_is_nothing_is_called_good(tree: Tree) -> None:
    findings = list(found_devices(tree.machine))
    assert [(finding.subject, finding.verdict) for finding in findings] == [
        (what, Verdict.SKIPPED) for what in ("camera", "gpio", "serial")
    ]
    assert in_lines(findings)[-1] == "0 errors, 0 warnings, 0 good, 3 skipped"


def test_one_port_by_two_of_its_names(tree: Tree, port: Path) -> None:
    port.chmod(0o666)
    entries = [{"device": device, "speaks": "console"} for device in (BY_ID, "/dev/ttyUSB0")]
    findings = driver_findings(configured(serial=entries), tree)
    finding = says(findings, Verdict.ERROR, f"is the same device as {BY_ID}")
    assert finding.subject == "serial /dev/ttyUSB0"
    for table, driver in (("stage", "grbl"), ("inclinometer", "balluff_bsi_r11a0")):
        more = {table: {"driver": driver, "device": "/dev/ttyUSB0"}}
        findings = driver_findings(configured(serial=entries[:1], **more), tree)
        assert says(findings, Verdict.ERROR, f"is the same device as {BY_ID}")
    assert all("same device" not in finding.text for finding in found(tree))


def test_one_camera_by_two_of_its_names(tree: Tree, terminal: Path) -> None:
    tree.link("/dev/video0", terminal)
    tree.link("/dev/v4l/by-path/one", "../../video0")
    cameras = {
        name: {"driver": "v4l2", "device": device}
        for name, device in (("front", "/dev/video0"), ("rear", "/dev/v4l/by-path/one"))
    }
    findings = driver_findings(configured(cameras=cameras), tree)
    assert says(findings, Verdict.ERROR, "is the same device as front").subject == "camera rear"
    may_change = says(findings, Verdict.WARNING, "after a restart it may be another camera")
    assert may_change.subject == "camera front /dev/video0", "the other one is named by its port"


class TestGpioLines:
    LABEL = "pinctrl-bcm2711"

    @pytest.fixture(autouse=True)
    def board(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A chip with two named lines, which this computer need not have."""
        lines = tuple(GpioLine(number, name, None) for number, name in enumerate(("LED1", "LED2", "")))
        chip = GpioChip(Path("/dev/gpiochip0"), "gpiochip0", self.LABEL, lines)
        monkeypatch.setattr(find_chips, "chip_paths", lambda: [chip.path])
        monkeypatch.setattr(find_chips, "read_chip", lambda _: chip)

    def findings(self, lines: list[str], ok: str, chip: str) -> list[Finding]:
        lamps = {"driver": "gpiod", "chip": self.LABEL, "lines": lines}
        indicators = {"driver": "gpiod", "chip": chip, "ok": ok}
        (tables,) = configured(lamps=lamps, indicators=indicators).tables_by_driver().values()
        return list(find_chips.check_lines(tables))

    def test_lines_that_are_there(self) -> None:
        assert self.findings(["LED1", "2"], "LED2", self.LABEL) == []

    def test_a_line_that_is_not_there(self) -> None:
        finding = says(self.findings(["LED1"], "LED7", self.LABEL), Verdict.ERROR, "no line 'LED7'")
        assert "indicators.ok" in finding.text

    @pytest.mark.parametrize(("ok", "chip"), [("LED1", "/dev/gpiochip0"), ("0", LABEL), ("0", "gpiochip0")])
    def test_one_line_by_two_of_its_names(self, ok: str, chip: str) -> None:
        findings = self.findings(["LED1"], ok, chip)
        assert says(findings, Verdict.ERROR, "indicators.ok is the same line as lamps, 0 of GPIO chip")
