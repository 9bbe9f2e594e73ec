"""A camera's stream of frames: a thread that receives its packets, and a short queue of blocks."""

from __future__ import annotations

import logging
import select
import threading
import time
from collections import deque
from contextlib import suppress

from altd.devices.aravis.blocks import Assembler, Block
from altd.devices.aravis.gvcp import PORT
from altd.devices.aravis.packets import BATCH, PacketSocket

log = logging.getLogger("altd")

_MAX_READY_BLOCKS = 8
"""Maximum number of blocks in the queue; the oldest is dropped first."""
_IDLE_POLL_INTERVAL_MS = 50
_BUSY_POLL_INTERVAL_MS = 5
_GATHERING_S = 0.0003
"""Time in which packets gather in the socket during a frame; otherwise each one wakes the thread."""
_LOG_REPEAT_S = 60.0
_JOIN_TIMEOUT_S = 1.0


class Stream:
    """Delivers the blocks that an assembler makes of the packets of ``receiving``; closes that at the end."""

    def __init__(self, camera: str, receiving: PacketSocket, assembler: Assembler, address: str) -> None:
        self._camera = camera
        self._receiving = receiving
        self._assembler = assembler
        self._control = address, PORT
        self._ready: deque[Block] = deque(maxlen=_MAX_READY_BLOCKS)
        self._changed = threading.Condition()
        self._closing = False
        self._failure: OSError | None = None
        self._logged_ns = 0
        self._thread = threading.Thread(target=self._run, name=f"gvsp {address}", daemon=True)
        self._thread.start()

    @property
    def quarantined(self) -> bool:
        """Whether frames are withheld because another sender uses the camera's address."""
        return self._assembler.quarantined(time.monotonic_ns())

    @property
    def remark(self) -> str:
        """Last known fault of the received packets; empty if there was none."""
        return self._assembler.last_contradiction if self.quarantined else self._assembler.last_refusal

    def pop(self, timeout_s: float) -> Block | None:
        """Return the oldest block in the queue, or None on timeout. Raises OSError."""
        with self._changed:
            self._changed.wait_for(lambda: self._ready or self._failure, timeout_s)
            if self._ready:
                return self._ready.popleft()
            if self._failure is not None:
                raise self._failure
            return None

    def close(self) -> None:
        """Stop the thread and release the port, within a twentieth of a second."""
        self._closing = True
        self._thread.join(_JOIN_TIMEOUT_S)
        self._receiving.close()

    def _run(self) -> None:
        try:
            poll = select.poll()
            poll.register(self._receiving, select.POLLIN)
            while not self._closing:
                came = poll.poll(_BUSY_POLL_INTERVAL_MS if self._assembler.busy else _IDLE_POLL_INTERVAL_MS)
                count = self._receive() if came else 0
                self._deliver()
                if 0 < count < BATCH and self._assembler.busy:
                    time.sleep(_GATHERING_S)
        except OSError as error:
            with self._changed:
                self._failure = error
                self._changed.notify()

    def _receive(self) -> int:
        assembler, count, before = self._assembler, 0, self._assembler.contradictions
        now_ns = time.monotonic_ns()
        for packet, port in self._receiving.receive():
            assembler.take(packet, port, now_ns)
            count += 1
        if assembler.contradictions != before:
            with self._changed:
                self._ready.clear()  # the sender of these is unknown
            if not self._logged_ns or now_ns - self._logged_ns > _LOG_REPEAT_S * 1e9:
                self._logged_ns = now_ns
                log.warning("camera %s: %s", self._camera, assembler.last_contradiction)
        return count

    def _deliver(self) -> None:
        now_ns = time.monotonic_ns()
        for block in self._assembler.blocks(now_ns):
            with self._changed:
                self._ready.append(block)
                self._changed.notify()
        for command in self._assembler.resend_commands(now_ns):
            with suppress(OSError):  # the camera or the network is gone: the frame is lost
                self._receiving.send(command, self._control)
