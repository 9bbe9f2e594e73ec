"""Ports for programs that receive theirs before they open it, also while other tests look for some."""

import os
import random
import socket

_PORTS = range(15_000, 32_000)
"""Below those that the kernel assigns automatically (32768 on, see ip(7)): none of them goes to another."""
_WORKERS = 16
_given: set[int] = set()


def free_port() -> int:
    """One without a listener at any address of this machine, and that no test was given before.

    Each of pytest's processes has ports of its own to choose from; by chance, for two runs at once.
    """
    chance = random.SystemRandom()
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    while True:
        port = chance.choice(_PORTS[worker % _WORKERS :: _WORKERS])
        if port in _given:
            continue
        try:
            socket.create_server(("", port), reuse_port=False).close()
        except OSError:
            continue
        _given.add(port)
        return port


def has_ipv6() -> bool:
    """Whether the loopback interface has its IPv6 address."""
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True
