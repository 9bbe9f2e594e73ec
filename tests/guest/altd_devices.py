"""Leaves what ``altd devices`` prints of a camera, a GPIO chip and a USB serial port that are there."""

import subprocess
import sys
import time
from pathlib import Path

from cameras import nodes, plug_in
from support.gpio_sim import SimulatedChip
from support.guest import leave_results

GADGET = Path("/sys/kernel/config/usb_gadget/adapter")
BY_ID = Path("/dev/serial/by-id")


def plug_in_adapter() -> None:
    """A USB serial port under the name that udev would give it."""
    (GADGET / "configs/c.1").mkdir(parents=True)
    (GADGET / "idVendor").write_text("0x1d6b\n")
    (GADGET / "idProduct").write_text("0x0104\n")
    (GADGET / "strings/0x409").mkdir()
    (GADGET / "strings/0x409/product").write_text("Two wires\n")
    (GADGET / "functions/acm.0").mkdir(parents=True)
    (GADGET / "configs/c.1/acm.0").symlink_to(GADGET / "functions/acm.0")
    (GADGET / "UDC").write_text("dummy_udc.0\n")
    port = Path("/dev/ttyACM0")
    while not port.exists():
        time.sleep(0.01)
    BY_ID.mkdir(parents=True)
    (BY_ID / "usb-wires-if00").symlink_to(port)


plug_in("pci-0000:00:14.0-usb-0:2:1.0-video-index0", nodes("vid-cap")[0])
plug_in_adapter()
chip = SimulatedChip("unit", ["LED_A", "", "DOOR"])
with chip.held("doorbell", "DOOR"):
    done = subprocess.run(
        [sys.executable, "-m", "altd.cli", "devices"], capture_output=True, text=True, check=False
    )
leave_results({"status": done.returncode, "out": done.stdout, "err": done.stderr})
