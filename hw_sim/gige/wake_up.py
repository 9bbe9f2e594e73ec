"""Keeps Aravis' camera to its frame period.

Its loop (0.8.26) computes the wait for the rest of the period as an unsigned difference. In one frame of some
thousand the next instant has just passed, the difference is enormous, and the loop sleeps for its maximum of
100 ms: two frames are skipped, which no real sensor does. A packet on its control port wakes it up.
"""

import socket
import struct
import threading
import time
from collections.abc import Callable

from hw_sim.gige.loopback import GVCP_PORT

DELAY_S = 0.001
"""Delay after the exposure's instant: by then a loop that is awake has begun the exposure."""

_DISCOVERY = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 1)
"""GVCP's discovery request, which changes nothing."""


class WakeUp:
    """Wakes the camera at ``address`` just after each multiple of ``period_us`` on the realtime clock."""

    def __init__(self, address: str, period_us: Callable[[], int]) -> None:
        self._address = address
        self._period_us = period_us
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._wake_up, name=f"wake up {address}")
        self._thread.start()

    def close(self) -> None:
        """Stop waking it."""
        self._ended.set()
        self._thread.join()

    def _wake_up(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.connect((self._address, GVCP_PORT))
            link.setblocking(False)
            while not self._ended.wait(self._until_next_s()):
                try:
                    link.send(_DISCOVERY)
                    link.recv(1024)  # response to the previous request
                except OSError:  # no camera yet, or no longer
                    continue

    def _until_next_s(self) -> float:
        period_s = 1e-6 * max(self._period_us(), 1000)
        return period_s - (time.time() - DELAY_S) % period_s
