"""The process that has a TCP port, as far as this user may read it: /proc/net and /proc/PID/fd (proc(5))."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

_LISTEN_STATE = "0A"


def listening_sockets(host: str, port: int, root: Path = Path("/")) -> Iterator[str]:
    """Yield the inodes of sockets that prevent listening on this host and port."""
    wanted = bytes_of(host)
    for path in ("proc/net/tcp", "proc/net/tcp6"):
        for line in _text(root / path).splitlines()[1:]:
            fields = line.split()
            address, _, number = fields[1].partition(":")
            if fields[3] == _LISTEN_STATE and int(number, 16) == port:
                theirs = from_kernel(address)
                if not any(wanted) or not any(theirs) or wanted == theirs[-len(wanted) :]:
                    yield fields[9]


def owner_of_socket(inode: str, root: Path = Path("/")) -> tuple[int, str] | None:
    """Return number and name of a socket's process; only root can read those of other users."""
    for link in root.glob("proc/[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if str(link.readlink()) == f"socket:[{inode}]":
                return process_at(link.parent.parent)
    return None


def process_at(folder: Path) -> tuple[int, str]:
    """Return number and name of the process of a folder in /proc."""
    return int(folder.name), "altd" if is_altd(words_of(folder)) else _text(folder / "comm").strip() or "?"


def words_of(folder: Path) -> list[str]:
    """Return the command line of the process of a folder in /proc."""
    return _text(folder / "cmdline").strip().split("\0")


def is_altd(words: list[str]) -> bool:
    """Whether a command line is that of altd."""
    return any(Path(word).name in ("altd", "altd.cli", "altd.publish.opcua") for word in words[:4])


def from_kernel(address: str) -> bytes:
    """Return the bytes of an address in /proc/net: words of four bytes, each in reverse order."""
    raw = bytes.fromhex(address)
    return b"".join(raw[i : i + 4][::-1] for i in range(0, len(raw), 4))


def bytes_of(host: str) -> bytes:
    """Return the bytes of an address; of a name, those of 0.0.0.0."""
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            return socket.inet_pton(family, host.partition("%")[0])
        except OSError:
            continue
    return bytes(4)


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
