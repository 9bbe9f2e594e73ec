"""Both ends of a local socket: listening at a file, and requests to the daemon there."""

from __future__ import annotations

import contextlib
import errno
import grp
import http.client
import os
import pwd
import socket
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from altd.errors import one_line
from altd.files.documents import parse_json

MAX_ANSWER_BYTES = 1 << 20
"""Maximum size of a response, which normally has a few thousand bytes."""

_MIN_TIMEOUT_S = 1e-3
_NOT_RUNNING = "the daemon is not running (start: `sudo systemctl start altd`)"


class NoAnswerError(Exception):
    """The daemon does not respond, or not correctly; the message, one line, has the reason."""

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))


def ask(
    path: Path, target: str, timeout_s: float, method: str = "GET", headers: Mapping[str, str] | None = None
) -> tuple[int, Any]:
    """Return status and JSON document of the response; the whole request takes at most ``timeout_s``.

    Raises NoAnswerError.
    """
    status, content = ask_content(path, target, timeout_s, method, headers)
    try:
        return status, parse_json(content)
    except ValueError as error:
        raise NoAnswerError(f"the server at {path} is not an altd daemon: {error}") from error


def ask_content(
    path: Path,
    target: str,
    timeout_s: float,
    method: str = "GET",
    headers: Mapping[str, str] | None = None,
    max_bytes: int = MAX_ANSWER_BYTES,
) -> tuple[int, bytes]:
    """Like ``ask``, but return the raw content, of which at most ``max_bytes`` are read."""
    connection = _LocalConnection(path, timeout_s)
    try:
        connection.request(method, target, headers=dict(headers or {}))
        with connection.getresponse() as answer:  # it owns the socket if the server closes the connection
            return answer.status, answer.read(max_bytes)
    except TimeoutError as error:
        raise NoAnswerError(f"the daemon at {path} does not answer within {timeout_s:g} s") from error
    except PermissionError as error:
        raise NoAnswerError(_who_may(path)) from error
    except FileNotFoundError as error:
        raise NoAnswerError(f"there is no socket {path}: {_NOT_RUNNING}, or has no [local]") from error
    except ConnectionRefusedError as error:
        raise NoAnswerError(f"{_NOT_RUNNING}: nothing listens at {path}") from error
    except http.client.HTTPException as error:
        raise NoAnswerError(f"the server at {path} is not an altd daemon: {error}") from error
    except OSError as error:
        raise NoAnswerError(f"no daemon answers at {path}: {error.strerror or error}") from error
    finally:
        connection.close()


class _LocalConnection(http.client.HTTPConnection):
    """HTTP connection on a Unix socket."""

    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__("localhost")
        self._path = path
        self._deadline_s = time.monotonic() + timeout_s

    def connect(self) -> None:
        """Connect to the socket; raises TimeoutError also for a daemon with a full queue."""
        self.sock = _PunctualSocket(self._deadline_s)
        try:
            self.sock.connect(str(self._path))
        except BlockingIOError as error:
            raise TimeoutError from error


class _PunctualSocket(socket.socket):
    """A socket with a deadline for all operations together, however slowly the other end sends."""

    def __init__(self, deadline_s: float) -> None:
        super().__init__(socket.AF_UNIX, socket.SOCK_STREAM)
        self._deadline_s = deadline_s
        self._limit_time()

    def recv_into(self, *arguments: Any) -> int:
        """Receive, for ``makefile``, within the deadline."""
        self._limit_time()
        return super().recv_into(*arguments)

    def sendall(self, *arguments: Any) -> None:
        """Send within the deadline."""
        self._limit_time()
        super().sendall(*arguments)

    def _limit_time(self) -> None:
        left_s = self._deadline_s - time.monotonic()
        if left_s <= 0:
            raise TimeoutError
        self.settimeout(max(left_s, _MIN_TIMEOUT_S))


def _who_may(path: Path) -> str:
    try:
        about = path.stat()
    except OSError:
        return f"{path}: permission denied: only the folder's owner and group have access; use sudo"
    user = _name(lambda: pwd.getpwuid(about.st_uid).pw_name, about.st_uid)
    group = _name(lambda: grp.getgrgid(about.st_gid).gr_name, about.st_gid)
    return (
        f"{path}: permission denied: it is for user {user} and group {group}; join the group, or ask as root"
    )


def _name(find: Callable[[], str], number: int) -> str:
    try:
        return find()
    except KeyError:
        return str(number)


MODE = 0o660
"""Mode of the socket: owner and group of the daemon may connect, which needs write access (unix(7))."""

BACKLOG = 32

_CONNECT_TIMEOUT_S = 0.2


@contextlib.contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """Open the listening socket for the context; its file is removed at the end.

    A socket left at ``path`` by a dead process is replaced. Raises OSError that names the path: EADDRINUSE if
    a process listens there or the file is not a socket.
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
            path.chmod(MODE)  # before listening: with any umask, no client can connect earlier
            listener.listen(BACKLOG)
            listener.setblocking(False)
            yield listener
        finally:
            with contextlib.suppress(OSError):
                if identity_at(path) == made:
                    path.unlink()


def identity_at(path: Path) -> tuple[int, int] | None:
    """Return (device, inode) of the file at a path, unique while the file is in use; None: no file."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _make_room(path: Path) -> None:
    """Remove a socket without a listener; raises OSError for any other file."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise OSError(errno.EADDRINUSE, "the file is not a socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.settimeout(_CONNECT_TIMEOUT_S)
        try:
            trial.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.ETIMEDOUT):  # its queue is full: the process is alive
                raise
    raise OSError(errno.EADDRINUSE, "another process listens there")
