"""Leaves what the inventory finds, and what v4l2-ctl says of the same cameras."""

import os
import re

from cameras import nodes, plug_in, v4l2_ctl
from support.guest import leave_results

from altd.devices.v4l2.find_cameras import FoundCamera, find_cameras

CAPTURE = nodes("vid-cap")[0]
plug_in("pci-0000:00:14.0-usb-0:2:1.0-video-index0", CAPTURE)
found = [
    {
        "path": str(camera.path),
        "card": camera.card,
        "driver": camera.driver,
        "formats": {name: list(map(str, sizes)) for name, sizes in camera.formats.items()},
        "controls": {control.name: [control.minimum, control.maximum] for control in camera.controls},
    }
    for camera in find_cameras()
    if isinstance(camera, FoundCamera)
]
SHOWN = re.compile(r"^ *(\w+) 0x[0-9a-f]+ \(int\) +: min=(-?\d+) max=(-?\d+)", re.MULTILINE)
shown = {name: [int(low), int(high)] for name, low, high in SHOWN.findall(v4l2_ctl(CAPTURE, "-l"))}
CAPTURE.chmod(0)
os.seteuid(65534)
unreadable = [
    [str(camera.path), camera.why] for camera in find_cameras() if not isinstance(camera, FoundCamera)
]
os.seteuid(0)
leave_results({"found": found, "v4l2_ctl": shown, "unreadable": unreadable})
