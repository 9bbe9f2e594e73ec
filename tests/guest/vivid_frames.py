"""Frames of a vivid camera as the driver delivers them: pixels to files, the rest as results."""

import contextlib
import os
import time
from pathlib import Path

import numpy as np
from cameras import camera, nodes, outcome, v4l2_ctl
from feeding import V4L2_BUF_TYPE_VIDEO_OUTPUT
from support.guest import leave_results
from support.jpegs import HEIGHT, SENT, WIDTH

from altd.devices.v4l2 import abi
from altd.devices.v4l2.camera import V4l2Camera
from altd.devices.v4l2.image import code
from altd.devices.v4l2.node import VideoNode
from altd.ports import CameraTimeoutError

DEVICE, PLANES = nodes("vid-cap")
LOOPBACK = nodes("Dummy video device")[0]
GRAY_RAMP = 20


def main() -> None:
    for device in (DEVICE, PLANES):
        v4l2_ctl(device, "-c", f"test_pattern={GRAY_RAMP},osd_text_mode=2")
    leave_results(
        {
            "formats": {
                name: of_format(name) for name in ("GREY", "Y10", "Y12", "Y16", "YUYV", "UYVY", "NV12")
            },
            "planes": {name: of_format(name, PLANES, "planes-") for name in ("GREY", "Y16", "YUYV", "NV12")},
            "jpegs": through_loopback(),
            "dropped": dropped(),
            "damaged": damaged(),
            "wrapped": wrapped(),
            "silent": silent(),
            "stamps": {source: stamps(source) for source in ("end_of_frame", "start_of_exposure")},
            "reopened": reopened(),
            "automatic": automatic(),
        }
    )


def of_format(name: str, device: Path = DEVICE, prefix: str = "") -> dict[str, object]:
    one = camera(device, pixel_format=name)
    one.open()
    frames = [one.next_frame(1.0) for _ in range(3)]
    one.close()
    np.save(f"{prefix}{name}.npy", frames[-1].pixels)
    return {
        "bits": frames[-1].bits,
        "writeable": frames[-1].pixels.flags.writeable,
        "owns": frames[-1].pixels.flags.owndata,
        "origin": one.origin,
        "exposure_range": one.exposure_range,
        "exposure_ms": frames[-1].exposure_ms,
    }


def through_loopback() -> list[int]:
    """JPEGs, with damaged ones between them."""
    feeding = VideoNode(LOOPBACK)
    wanted = abi.v4l2_format(type=V4L2_BUF_TYPE_VIDEO_OUTPUT)
    wanted.fmt.pix.width, wanted.fmt.pix.height = WIDTH, HEIGHT
    wanted.fmt.pix.pixelformat = code("MJPG")
    feeding.call(abi.VIDIOC_S_FMT, wanted)
    os.write(feeding.descriptor, SENT[0])
    one = camera(LOOPBACK, width=WIDTH, height=HEIGHT, pixel_format="MJPG")
    one.open()
    frames = []
    for picture in SENT:
        os.write(feeding.descriptor, picture)
        with contextlib.suppress(CameraTimeoutError):
            while True:
                frames.append(one.next_frame(0.5))
    one.close()
    feeding.close()
    np.save("MJPG.npy", np.array([frame.pixels for frame in frames]))
    return [frame.sequence for frame in frames]


def sequences(one: V4l2Camera, count: int) -> list[int]:
    return [one.next_frame(1.0).sequence for _ in range(count)]


def dropped() -> list[int]:
    one = camera(DEVICE, width=320, height=180, fps=25, controls={"percentage_of_dropped_buffers": 20})
    one.open()
    found = sequences(one, 120)
    one.close()
    v4l2_ctl(DEVICE, "-c", "percentage_of_dropped_buffers=0")
    return found


def damaged() -> list[int]:
    one = camera(DEVICE, width=320, height=180, fps=10)  # few pixels: a busy computer loses none
    one.open()
    found = sequences(one, 5)
    v4l2_ctl(DEVICE, "-c", "inject_v4l2_buf_flag_error=1")
    found += sequences(one, 10)
    one.close()
    return found


def wrapped() -> list[int]:
    """Over 2³² − 1: with this control vivid begins 128 before it."""
    one = camera(DEVICE, width=320, height=180, fps=50, controls={"wrap_sequence_number": 1})
    one.open()
    found = sequences(one, 140)
    one.close()
    v4l2_ctl(DEVICE, "-c", "wrap_sequence_number=0")
    return found


def silent() -> dict[str, object]:
    one = camera(DEVICE)
    one.open()
    one.next_frame(1.0)
    v4l2_ctl(DEVICE, "-c", "percentage_of_dropped_buffers=100")
    for _ in range(4):  # those on their way
        outcome(lambda: one.next_frame(0.05))
    timed_out = outcome(lambda: one.next_frame(0.3))
    v4l2_ctl(DEVICE, "-c", "percentage_of_dropped_buffers=0")
    one.next_frame(1.0)
    one.close()
    return timed_out


def stamps(source: str) -> dict[str, list[int]]:
    v4l2_ctl(DEVICE, "-c", f"timestamp_source={0 if source == 'end_of_frame' else 1}")
    one = camera(DEVICE)
    one.open()
    times = [(one.next_frame(1.0).t_ns, time.monotonic_ns()) for _ in range(30)]
    one.close()
    return {"t_ns": [t for t, _ in times], "taken_ns": [taken for _, taken in times]}


def reopened() -> list[int]:
    one = camera(DEVICE)
    one.open()
    found = sequences(one, 4)
    one.close()
    one.open()
    found += sequences(one, 4)
    one.close()
    return found


def automatic() -> list[object]:
    """The gain of a camera that altd controls, and of one whose own control is accepted."""
    found: list[object] = []
    for control in ("auto", "camera"):
        v4l2_ctl(DEVICE, "-c", "gain_automatic=1")
        one = camera(DEVICE, exposure={"control": control})
        one.open()
        found += [list(one.automatic), v4l2_ctl(DEVICE, "-C", "gain_automatic").strip()]
        one.close()
    return found


main()
