"""Where an interface listens."""

from __future__ import annotations

import socket

Address = tuple[str, int] | str
"""Host and port, or the path of a socket in the file system."""

_TIMEOUT_S = 5.0


def connected(address: Address) -> socket.socket:
    """A connection; raises OSError."""
    if isinstance(address, tuple):
        return socket.create_connection(address, timeout=_TIMEOUT_S)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(
            address
        )  # without a timeout: with one it fails where others are waiting (connect(2))
    except OSError:
        connection.close()
        raise
    connection.settimeout(_TIMEOUT_S)
    return connection
