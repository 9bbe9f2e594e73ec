"""Feeds frames to video outputs, in step: ``feeding.py FRAMES FPS DEVICE...``, without end.

A device that is gone is opened again until it is back.
"""

import ctypes
import os
import sys
import time
from collections.abc import Callable, Iterable
from mmap import mmap
from pathlib import Path

import numpy as np

from altd.devices.v4l2 import abi
from altd.devices.v4l2.node import VideoNode

V4L2_BUF_TYPE_VIDEO_OUTPUT = 2  # as in <linux/videodev2.h>, what altd itself does not use
V4L2_FIELD_NONE = 1


class Output:
    """One device that frames are shown on."""

    def __init__(self, device: Path, rows: int, columns: int) -> None:
        self._device = device
        self._rows = rows
        self._columns = columns
        self._node: VideoNode | None = None
        self._maps: list[mmap] = []
        self._free: list[int] = []

    def show(self, picture: bytes) -> bool:
        """Returns whether the device took it; it does not while all its buffers wait to be shown."""
        try:
            if self._node is None:
                self._open()
            self._show(picture)
            return True
        except BlockingIOError:
            return False
        except OSError:
            self._close()
            return False

    def _show(self, picture: bytes) -> None:
        assert self._node is not None
        if self._node.driver == "v4l2 loopback":  # numbers only the frames that are simply written
            os.write(self._node.descriptor, picture)
            return
        begins = len(self._free) == len(self._maps)
        index = self._free.pop() if self._free else self._node.call(abi.VIDIOC_DQBUF, _buffer(0)).index
        self._maps[index][: len(picture)] = picture
        filled = _buffer(index)
        filled.bytesused, filled.field = len(picture), V4L2_FIELD_NONE
        self._node.call(abi.VIDIOC_QBUF, filled)
        if begins:
            self._node.call(abi.VIDIOC_STREAMON, ctypes.c_int(V4L2_BUF_TYPE_VIDEO_OUTPUT))

    def _open(self) -> None:
        self._node = node = VideoNode(self._device)
        wanted = abi.v4l2_format(type=V4L2_BUF_TYPE_VIDEO_OUTPUT)
        wanted.fmt.pix.width, wanted.fmt.pix.height = self._columns, self._rows
        wanted.fmt.pix.pixelformat = abi.v4l2_fourcc("GREY")
        node.call(abi.VIDIOC_S_FMT, wanted)
        if node.driver == "v4l2 loopback":
            return
        asked = abi.v4l2_requestbuffers(count=8, type=V4L2_BUF_TYPE_VIDEO_OUTPUT, memory=abi.V4L2_MEMORY_MMAP)
        for index in range(node.call(abi.VIDIOC_REQBUFS, asked).count):
            buffer = node.call(abi.VIDIOC_QUERYBUF, _buffer(index))
            self._maps.append(mmap(node.descriptor, buffer.length, offset=buffer.m.offset))
        self._free = list(range(len(self._maps)))

    def _close(self) -> None:
        while self._maps:
            self._maps.pop().close()
        if self._node is not None:
            self._node.close()
        self._node = None


def _buffer(index: int) -> abi.v4l2_buffer:
    return abi.v4l2_buffer(index=index, type=V4L2_BUF_TYPE_VIDEO_OUTPUT, memory=abi.V4L2_MEMORY_MMAP)


def feed(take: Callable[[int], Iterable[np.ndarray]], fps: float, outputs: list[Output]) -> None:
    """Show what ``take`` gives for each exposure, a picture an output, without end.

    An exposure that no output took is offered again.
    """
    number, rounds, began_s = 0, 0, time.monotonic()
    while True:
        taken = [
            output.show(picture.tobytes()) for output, picture in zip(outputs, take(number), strict=True)
        ]
        if rounds == 0:
            print("feeding", flush=True)
        number += any(taken)
        rounds += 1
        time.sleep(max(0.0, began_s + rounds / fps - time.monotonic()))


def main(frames: Path, fps: float, devices: list[Path]) -> None:
    exposures = np.load(frames)
    outputs = [Output(device, *exposures.shape[2:]) for device in devices]
    feed(lambda number: exposures[number % len(exposures)], fps, outputs)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), [Path(device) for device in sys.argv[3:]])
