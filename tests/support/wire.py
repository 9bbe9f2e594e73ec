"""The two ends of a serial line: a pseudo terminal of which the unit opens one."""

import asyncio
import fcntl
import os
import struct
import subprocess
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from altd.config import SerialPortSettings
from support.foreign import need_program


@dataclass
class Wire:
    """The far end of a pseudo terminal, and the device that the unit opens."""

    far: int
    near: int
    device: Path

    @classmethod
    def laid(cls) -> Self:
        far, near = os.openpty()
        os.set_blocking(far, False)
        tty.setraw(near)
        return cls(far, near, Path(os.ttyname(near)))

    def settings(self, **changes: object) -> SerialPortSettings:
        return SerialPortSettings.model_validate({"device": self.device, **changes})

    def send(self, data: bytes) -> None:
        os.write(self.far, data)

    async def taken(self) -> None:
        """The unit has read all that was sent."""
        async with asyncio.timeout(60):
            while struct.unpack("i", fcntl.ioctl(self.near, termios.FIONREAD, b"\0" * 4))[0]:  # noqa: ASYNC110
                await asyncio.sleep(0.002)
            await asyncio.sleep(0.05)  # and looked at it

    async def receive(self, enough: Callable[[bytes], bool], timeout_s: float = 60.0) -> bytes:
        """The unit's bytes, up to when they are enough."""
        data = b""
        async with asyncio.timeout(timeout_s):
            while not enough(data):
                try:
                    data += os.read(self.far, 4096)
                except BlockingIOError:
                    await asyncio.sleep(0.002)
        return data

    def hang_up(self) -> None:
        for descriptor in (self.near, self.far):
            if descriptor >= 0:
                os.close(descriptor)
        self.near = self.far = -1


@contextmanager
def socat_line(folder: Path) -> Iterator[tuple[Path, Path, subprocess.Popen[bytes]]]:
    """A serial line between two devices, for a client that opens one itself; socat's end cuts it."""
    near, far = folder / "near", folder / "far"
    ends = (f"pty,raw,echo=0,link={end}" for end in (near, far))
    with subprocess.Popen([need_program("socat"), *ends]) as socat:
        try:
            while not (near.exists() and far.exists()):
                assert socat.poll() is None, "socat ended before it made both devices"
                time.sleep(0.005)
            yield near, far, socat
        finally:
            socat.kill()  # after SIGTERM it once ran on for 240 s (CI, socat 1.7.4.4)
