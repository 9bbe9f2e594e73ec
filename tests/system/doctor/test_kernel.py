"""The doctor on chips and a link of the kernel."""

import subprocess
import sys
from pathlib import Path

from support.foreign import need, need_namespaces, need_program
from support.guest import run_in_guest
from support.unit_toml import unit_toml


def test_a_real_gpio_chip_by_its_label_its_name_and_its_path(tmp_path: Path) -> None:
    found = run_in_guest(tmp_path, "doctor_gpio.py").results
    for chip in ("lamp-board", "gpiochip0", "/dev/gpiochip0"):
        assert [finding["verdict"] for finding in found[chip]] == ["good"]
    (finding,) = found["other-board"]
    assert finding["verdict"] == "ERROR"
    assert "existing: /dev/gpiochip0" in finding["text"]


CONFIG = unit_toml(
    "ALT-0007",
    "calibration.json",
    'driver = "aravis"\ndevice = "192.168.77.20"\npacket_bytes = 1500',
    'driver = "aravis"\ndevice = "10.9.8.7"',
    '[measuring]\npair_by = "time"\n',
)
A_SMALL_MTU = """
mount -t sysfs sys /sys
ip link add cam type veth peer name far
ip address add 192.168.77.1/24 dev cam
ip link set cam mtu 1400
ip link set far up
ip link set cam up
exec "$@"
"""


def test_on_a_real_link_with_a_small_mtu(tmp_path: Path) -> None:
    unshare = need_namespaces("--net", "--mount")
    need_program("ip", "iproute2")
    possible = subprocess.run(
        [*unshare, "mount", "-t", "sysfs", "sys", "/sys"], capture_output=True, check=False
    )
    need(possible.returncode == 0, "this machine allows no network namespaces")
    (tmp_path / "altd.toml").write_text(CONFIG)
    doctor = [sys.executable, "-m", "altd.cli", "doctor", "--config", str(tmp_path / "altd.toml")]
    done = subprocess.run(
        [*unshare, "sh", "-ec", A_SMALL_MTU, "sh", *doctor], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "good    camera front 192.168.77.20: is in the network of cam" in done.stdout
    assert "ERROR   network cam: its MTU is 1400 but packet_bytes 1500" in done.stdout
    assert (
        "ERROR   camera rear 10.9.8.7: no interface has an address in its network: no route to it"
        in done.stdout
    )
    assert done.stderr == ""
