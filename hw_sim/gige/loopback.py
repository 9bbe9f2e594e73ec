"""An address for a camera: one of this machine, with GigE Vision's port free on it.

All of 127.0.0.0/8 is this machine, but Aravis serves only where an interface has that exact address.
"""

import contextlib
import errno
import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

from altd.errors import BadInputError

GVCP_PORT = 3956
"""GigE Vision's control port; cameras use no other."""


@contextlib.contextmanager
def camera_address(address: str) -> Iterator[None]:
    """Make sure that a camera can be served at ``address``.

    An address of 127.0.0.0/8 that ``lo`` lacks is added while it is needed, if permitted. Raises
    BadInputError.
    """
    _check_port_free(address)
    if _is_of_an_interface(address):
        yield
        return
    add = ["ip", "address", "add", f"{address}/32", "dev", "lo"]
    if _run(add).returncode:
        raise BadInputError(address, f"lo needs this address first:  sudo {' '.join(add)}")
    try:
        yield
    finally:
        _run(["ip", "address", "del", f"{address}/32", "dev", "lo"])


def keep_discovery_on_loopback() -> None:
    """Let this process's cameras answer only clients that look for cameras on ``lo``.

    Aravis listens to broadcasts on every network. A client that has found a camera on a network card waits
    there for frames, which arrive on ``lo``; and other computers of the network need not find it.
    """
    for entry in Path("/proc/self/fd").iterdir():
        if not entry.is_socket():
            continue
        with socket.socket(fileno=os.dup(int(entry.name))) as listener:
            if listener.family == socket.AF_INET and listener.getsockname() == ("255.255.255.255", GVCP_PORT):
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")


def _is_of_an_interface(address: str) -> bool:
    return address == "127.0.0.1" or bool(_run(["ip", "-o", "address", "show", "to", address]).stdout)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    except FileNotFoundError as error:
        raise BadInputError(command[0], "is not installed: Debian package iproute2") from error


def _check_port_free(address: str) -> None:
    """Check that the port is free; Aravis does not report another process at the port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, GVCP_PORT))
        except OSError as error:
            reasons = {
                errno.EADDRINUSE: "another camera is served there",
                errno.EADDRNOTAVAIL: "no network interface of this machine has this address",
            }
            reason = reasons.get(error.errno or 0, error.strerror or "cannot be had")
            raise BadInputError(f"{address}:{GVCP_PORT}", reason) from error
