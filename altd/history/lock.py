"""One daemon writes a history: while it does, it holds the lock of a file beside it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from altd.history.schema import UnusableFileError

_MODE = 0o600


class WriteLock:
    """Held until it is released or its process ends.

    Raises OSError, and UnusableFileError while another holds it.

    SQLite would let two write by turns: their measurements would be mixed, and each would take the other
    for one that crashed.
    """

    def __init__(self, history: Path) -> None:
        path = history.with_name(f"{history.name}.lock")
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, _MODE)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise UnusableFileError("another daemon writes it") from None
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Let others write."""
        os.close(self._descriptor)
