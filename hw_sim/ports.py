"""Free TCP ports for daemons."""

import random
import socket

_PORTS = 15_000, 32_000
"""Below those that the kernel assigns automatically (32768 on, see ip(7)): none of them goes to another."""
_given: set[int] = set()


def free_port() -> int:
    """A TCP port that is currently free and was not returned before."""
    chance = random.SystemRandom()
    while True:
        port = chance.randrange(*_PORTS)
        if port in _given:
            continue
        try:
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            continue
        _given.add(port)
        return port
