"""Datagrams of one camera, many per system call; the kernel drops those of other senders.

Python's socket receives one at a time and requests the interpreter's lock for each; while the measuring
thread computes, that is one packet in 5 ms. recvmmsg(2) receives all pending datagrams, at most a batch, for
one such wait.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from altd.devices.aravis.gvsp import UDP_BYTES

_SO_ATTACH_FILTER, _SO_LOCK_FILTER = 26, 44
"""Socket options (socket(7)); values of asm-generic, as on x86 and ARM."""
_LOAD_WORD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_SOURCE_ADDRESS = 0x100000000 - 0x100000 + 12
"""SKF_NET_OFF plus the offset of the source address in an IPv4 header (RFC 791)."""
_ALL, _NOTHING = 0xFFFFFFFF, 0
_INSTRUCTION = struct.Struct("=HBBI")


def accept_only_from(receiving: socket.socket, address: str) -> None:
    """Drop all further packets to ``receiving``, an IPv4 socket, whose source is not ``address``.

    This attaches a classic BPF program (linux/filter.h), which cannot be removed. Unlike ``connect`` it needs
    no port, and does not report the other side's errors in the socket. Raises OSError.
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
    """Inodes of this process's sockets."""
    return frozenset(inode for inode, _ in _sockets())


def filter_new_sockets(before: frozenset[int], own_address: str, address: str) -> None:
    """Apply the same filter to UDP sockets that a library has since bound to ``own_address`` internally.

    Sockets that broadcast or are connected are our own requests to cameras and have a filter or need none.
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
    """Inode and file descriptor of each socket of this process."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            link = str(entry.readlink())
            if link.startswith("socket:["):
                yield int(link[8:-1]), int(entry.name)


BATCH = 64
_SOCKADDR_BYTES = 16  # sockaddr_in: family, port (big-endian), address, zeros


class _Iovec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Msghdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.POINTER(_Iovec)),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Mmsghdr(ctypes.Structure):
    _fields_ = (("header", _Msghdr), ("received_bytes", ctypes.c_uint))


_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)


class PacketSocket:
    """UDP socket at ``own_address`` that receives only from ``camera_address``, from the first datagram on.

    ``packet_bytes`` is the largest packet's size, IP and UDP headers included; a larger one is dropped.
    ``buffer_bytes`` is the buffer size requested from the kernel. Raises OSError.
    """

    def __init__(self, own_address: str, camera_address: str, packet_bytes: int, buffer_bytes: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            accept_only_from(self._socket, camera_address)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
            self._socket.bind((own_address, 0))
        except BaseException:
            self._socket.close()
            raise
        self.port: int = self._socket.getsockname()[1]
        self._largest = packet_bytes - UDP_BYTES
        slot = self._largest + 1  # a packet that fills it was larger
        self._packets = bytearray(BATCH * slot)
        self._names = bytearray(BATCH * _SOCKADDR_BYTES)
        packets, names = _address_of(self._packets), _address_of(self._names)
        self._vectors = (_Iovec * BATCH)(*(_Iovec(packets + n * slot, slot) for n in range(BATCH)))
        self._messages = (_Mmsghdr * BATCH)()
        for n, message in enumerate(self._messages):
            message.header.name = names + n * _SOCKADDR_BYTES
            message.header.name_length = _SOCKADDR_BYTES
            message.header.vectors = ctypes.pointer(self._vectors[n])
            message.header.vector_count = 1
        view = memoryview(self._packets)
        self._slots = [view[n * slot : (n + 1) * slot] for n in range(BATCH)]

    def fileno(self) -> int:
        """File descriptor for poll; -1 once it is closed."""
        return self._socket.fileno()

    def receive(self) -> Iterator[tuple[memoryview, int]]:
        """Yield the pending datagrams, at most BATCH, each with its source port; valid until the next call.

        Never waits; raises OSError.
        """
        count = _LIBC.recvmmsg(self.fileno(), self._messages, BATCH, socket.MSG_DONTWAIT, None)
        if count < 0:
            error = ctypes.get_errno()
            if error in (errno.EAGAIN, errno.EINTR):
                return
            raise OSError(error, os.strerror(error))
        for n in range(count):
            size = self._messages[n].received_bytes
            if size <= self._largest:
                at = n * _SOCKADDR_BYTES + 2
                yield self._slots[n][:size], int.from_bytes(self._names[at : at + 2], "big")

    def send(self, packet: bytes, address: tuple[str, int]) -> None:
        """Send one datagram; raises OSError."""
        self._socket.sendto(packet, address)

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


def _address_of(memory: bytearray) -> int:
    return ctypes.addressof((ctypes.c_char * len(memory)).from_buffer(memory))
