"""The simulated inclinometer as a neighbour: it reads from no file but its own."""

from __future__ import annotations

import socket

from hw_sim.inclinometer import Inclinometer


def test_unplugged_it_takes_nothing_from_a_socket_that_gets_its_files_number() -> None:
    """It did: 256 bytes of an answer over HTTP were missing, once in some hundred runs."""
    for _ in range(10):
        with Inclinometer.balluff() as sensor:
            sensor.unplug()
            near, far = socket.socketpair()
            with near, far:
                for end in (near, far):
                    end.sendall(bytes(1024))
                    end.settimeout(0.2)
                assert [len(end.recv(4096)) for end in (near, far)] == [1024, 1024]
