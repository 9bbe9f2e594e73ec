"""The two ends of a serial line: a pseudo terminal of which the unit opens one."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from altd.config import SerialPortSettings


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

    async def receive(self, enough: Callable[[bytes], bool], timeout_s: float = 20.0) -> bytes:
        """What the unit sent, up to when it is enough."""
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
