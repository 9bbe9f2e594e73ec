"""Let the kernel drop what comes from anywhere but one address, before a socket ever sees it."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_SO_ATTACH_FILTER, _SO_LOCK_FILTER = 26, 44
"""socket(7); asm-generic, as on x86 and ARM."""
_LOAD_WORD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_SOURCE_ADDRESS = 0x100000000 - 0x100000 + 12
"""SKF_NET_OFF and the offset of the source address in an IPv4 header (RFC 791)."""
_ALL, _NOTHING = 0xFFFFFFFF, 0
_INSTRUCTION = struct.Struct("=HBBI")


def accept_only_from(receiving: socket.socket, address: str) -> None:
    """From now on ``receiving``, an IPv4 socket, gets no packet whose source is not ``address``.

    A classic BPF program (linux/filter.h), which cannot be taken off again. Unlike ``connect`` it needs no
    port, and brings no errors of the other side's into the socket. Raises OSError.
    """
    wanted = int.from_bytes(socket.inet_aton(address), "big")
    program = b"".join(
        _INSTRUCTION.pack(*instruction)
        for instruction in (
            (_LOAD_WORD, 0, 0, _SOURCE_ADDRESS),
            (_JUMP_IF_EQUAL, 0, 1, wanted),
            (_RETURN, 0, 0, _ALL),
            (_RETURN, 0, 0, _NOTHING),
        )
    )
    held = ctypes.create_string_buffer(program, len(program))
    count = len(program) // _INSTRUCTION.size
    receiving.setsockopt(
        socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", count, ctypes.addressof(held))
    )
    receiving.setsockopt(socket.SOL_SOCKET, _SO_LOCK_FILTER, 1)


def open_sockets() -> frozenset[int]:
    """The inodes of this process's sockets."""
    return frozenset(inode for inode, _ in _sockets())


def filter_new_sockets(before: frozenset[int], own_address: str, address: str) -> None:
    """The same for the UDP sockets that a library has bound to ``own_address`` since, unseen.

    Those that broadcast or are connected are our own questions to cameras and have a filter or need none.
    """
    for inode, number in _sockets():
        if inode not in before:
            with suppress(OSError), socket.socket(fileno=os.dup(number)) as theirs:
                if (
                    theirs.family == socket.AF_INET
                    and theirs.type == socket.SOCK_DGRAM
                    and _is_open_to_all(theirs, own_address)
                ):
                    accept_only_from(theirs, address)


def _is_open_to_all(theirs: socket.socket, own_address: str) -> bool:
    if theirs.getsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST):
        return False
    try:
        theirs.getpeername()
    except OSError:
        return bool(theirs.getsockname()[0] == own_address)
    return False


def _sockets() -> Iterator[tuple[int, int]]:
    """Inode and file descriptor of each."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            link = str(entry.readlink())
            if link.startswith("socket:["):
                yield int(link[8:-1]), int(entry.name)
