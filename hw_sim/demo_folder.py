"""The demo's folder: the data that its daemon keeps, and the commands that read them."""

import contextlib
import os
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from altd.config import HistorySettings, KeptFrames, LocalSettings
from altd.config.interfaces import MAX_SOCKET_BYTES
from altd.errors import BadInputError

_DISK_MB = 500
_AGAIN_AFTER_S = 60.0
"""Shorter than the default: people who try the demo block the beam more than once in ten minutes."""

_PROGRAM = "altd"


@dataclass(frozen=True, slots=True)
class DemoFolder:
    """Folders of a demo's daemon for history and frames, and its local socket."""

    path: Path

    @property
    def calibration(self) -> Path:
        """Path of the unit's calibration, which the demo makes."""
        return self.path / "calibration.json"

    @property
    def history(self) -> HistorySettings:
        """Settings of the history in this folder."""
        return HistorySettings(file=self.path / "history.db")

    @property
    def kept_frames(self) -> KeptFrames:
        """Settings of the recordings in this folder."""
        return KeptFrames(folder=self.path / "recordings", disk_mb=_DISK_MB, again_after_s=_AGAIN_AFTER_S)

    @property
    def local(self) -> LocalSettings | None:
        """Settings of the local socket in this folder; None if its path would be too long for a socket."""
        socket = self.path / "altd.sock"
        fits = str(socket).isprintable() and len(os.fsencode(socket)) <= MAX_SOCKET_BYTES
        return LocalSettings(socket=socket) if fits else None

    def commands(self) -> list[tuple[str, str]]:
        """Command that shows the stored data, from any folder, with its name."""
        altd = f"cd {shlex.quote(str(self.path))} && ./{_PROGRAM}"
        watch = f"{altd} watch --socket altd.sock"
        return [
            ("terminal", "(no altd watch: the folder's path is too long)" if self.local is None else watch),
            ("", f"{altd} events --history history.db"),
        ]


@contextlib.contextmanager
def demo_folder(keep: Path | None) -> Iterator[DemoFolder]:
    """Yield the folder ``keep``, which stays, or a temporary one; raises BadInputError if unavailable.

    While in use it contains a link to the program: the demo's commands are then the same wherever altd is
    installed, and short enough for a terminal of 80 columns.
    """
    with contextlib.ExitStack() as parts:
        if keep is None:
            path = Path(parts.enter_context(tempfile.TemporaryDirectory(prefix="altd-")))
        else:
            path = keep.absolute()
            if path.exists() and not path.is_dir():
                raise BadInputError(str(path), "is not a folder")
        link = path / _PROGRAM
        try:
            path.mkdir(parents=True, exist_ok=True)
            if link.is_symlink():  # left by a demo that was killed
                link.unlink()
            link.symlink_to(Path(sys.executable).with_name(_PROGRAM))
        except OSError as error:
            raise BadInputError(str(link), error.strerror or str(error)) from error
        parts.callback(link.unlink, missing_ok=True)
        yield DemoFolder(path)
