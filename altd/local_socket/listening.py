"""The daemon's end: a listening socket at a path, for whom the file's permissions let in."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

MODE = 0o660
"""Owner and group may connect, for that needs to write (unix(7)). They are those of the daemon's process."""

BACKLOG = 32

_CONNECT_TIMEOUT_S = 0.2


@contextlib.contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """The listening socket, its file removed at the end.

    A socket that a dead process left at ``path`` is replaced. Raises OSError that names the path: EADDRINUSE
    where somebody listens there or where anything but a socket is.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    with listener:
        try:
            _make_room(path)
            listener.bind(str(path))
        except OSError as error:
            number = error.errno or errno.EINVAL
            raise OSError(number, f"{path}: {error.strerror or os.strerror(number)}") from error
        made = identity_at(path)
        try:
            path.chmod(MODE)  # before it listens: until then nobody can connect, whatever the umask
            listener.listen(BACKLOG)
            listener.setblocking(False)
            yield listener
        finally:
            with contextlib.suppress(OSError):
                if identity_at(path) == made:
                    path.unlink()


def identity_at(path: Path) -> tuple[int, int] | None:
    """What tells the file at a path from any other while it is in use; None: there is none."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _make_room(path: Path) -> None:
    """Remove a socket that nobody listens at; whatever else is there stays, and is an error."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise OSError(errno.EADDRINUSE, "there is a file that is no socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.settimeout(_CONNECT_TIMEOUT_S)
        try:
            trial.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.ETIMEDOUT):  # its queue is full: it lives
                raise
    raise OSError(errno.EADDRINUSE, "another process listens there")
