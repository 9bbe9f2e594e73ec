"""Leaves which drivers' devices this guest has, and which arguments it was given."""

import random
import sys
from pathlib import Path

from support.guest import leave_results

print("looking around")
video = Path("/sys/class/video4linux")
leave_results(
    {
        "arguments": sys.argv[1:],
        "cameras": sorted((node / "name").read_text().strip() for node in video.iterdir()),
        "usb_controllers": [udc.name for udc in Path("/sys/class/udc").iterdir()],
        "gpio_sim": Path("/sys/kernel/config/gpio-sim").is_dir(),
        "usb_gadgets": Path("/sys/kernel/config/usb_gadget").is_dir(),
        "loopback": Path("/sys/class/net/lo/operstate").read_text().strip(),
        "random": random.SystemRandom().random(),  # without a source of it this would not return
    }
)
