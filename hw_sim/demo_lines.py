"""Serial lines without hardware: each is two pseudo-terminals connected by a cable.

The unit opens one end, a person the other, with any program that opens a device. As on a real line, data sent
while the far end is closed are lost: a program that opens it receives only later data.
"""

import asyncio
import contextlib
import os
import select
import tty
from pathlib import Path
from typing import Self

READ_SIZE = 4096

POLL_INTERVAL_S = 0.05
"""Interval at which a line checks whether its far end is open; data sent meanwhile wait."""


class Line:
    """A cable; ``unit_end`` and ``far_end`` are devices such as ``/dev/pts/4``."""

    def __init__(self) -> None:
        self._unit, self._unit_device = os.openpty()
        self._far, far_device = os.openpty()
        for device in (self._unit_device, far_device):
            tty.setraw(device)
        self.unit_end = Path(os.ttyname(self._unit_device))
        self.far_end = Path(os.ttyname(far_device))
        os.set_blocking(self._unit, False)
        os.set_blocking(self._far, False)
        # The unit's end stays open here, so that it is there before and after the unit opens it. The far
        # end does not: the kernel then reports a hang-up for as long as no program has it open.
        os.close(far_device)
        self._hang_up = select.poll()
        self._hang_up.register(self._far, 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for descriptor in (self._unit, self._unit_device, self._far):
            os.close(descriptor)

    async def forward(self) -> None:
        """Forward bytes both ways until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._unit, self._from_unit)
        try:
            while True:
                if self._is_far_end_open():
                    gone = asyncio.Event()
                    loop.add_reader(self._far, self._from_far, gone)
                    await gone.wait()
                await asyncio.sleep(POLL_INTERVAL_S)
        finally:
            loop.remove_reader(self._unit)
            loop.remove_reader(self._far)

    def _is_far_end_open(self) -> bool:
        return not self._hang_up.poll(0)

    def _from_unit(self) -> None:
        data = os.read(self._unit, READ_SIZE)
        if self._is_far_end_open():
            _send(self._far, data)

    def _from_far(self, gone: asyncio.Event) -> None:
        try:
            data = os.read(self._far, READ_SIZE)
        except OSError:  # its last user has closed it
            asyncio.get_running_loop().remove_reader(self._far)
            tty.setraw(self._far)  # discards unread data and the settings of the terminal program
            gone.set()
        else:
            _send(self._unit, data)


def _send(descriptor: int, data: bytes) -> None:
    """Send as much as the other end has room for; a line does not wait."""
    with contextlib.suppress(BlockingIOError):
        os.write(descriptor, data)
