"""A serial port that can be unplugged: a pseudo-terminal with its own path."""

import os
import shutil
import tempfile
import tty
from pathlib import Path


class PluggedPort:
    """``terminal`` is the far end; the program under test opens ``device``, which vanishes with the port.

    The kernel assigns the number of a closed pseudo-terminal to the next one, of any program: a path in
    /dev/pts would soon lead there.
    """

    def __init__(self) -> None:
        self.terminal, self._line = os.openpty()
        tty.setraw(self._line)
        self.device = Path(tempfile.mkdtemp(prefix="altd-port-")) / "ttyUSB0"
        self.device.symlink_to(os.ttyname(self._line))

    def unplug(self) -> None:
        """Unplug the cable: the port disappears, and ``terminal`` is -1."""
        if self.terminal < 0:
            return
        shutil.rmtree(self.device.parent)
        os.close(self.terminal)
        os.close(self._line)
        self.terminal = -1
