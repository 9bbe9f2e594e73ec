"""Ports for programs that are told theirs before they open it, also while other tests look for some."""

from __future__ import annotations

import random
import socket

_PORTS = range(15_000, 32_000)
"""Below those that the kernel gives out by itself (32768 on, see ip(7)): it gives none of them to another."""


def free_port() -> int:
    """One that nobody listens on at any address of this machine; by chance, so that two at once differ."""
    chance = random.SystemRandom()
    while True:
        port = chance.choice(_PORTS)
        try:
            socket.create_server(("", port), reuse_port=False).close()
        except OSError:
            continue
        return port
