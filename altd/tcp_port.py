"""TCP ports: accepting connections so that a flood of them costs little; limits for clients by address.

asyncio's own servers accept as many connections in a row as wait, and where descriptors have run out
(EMFILE) they log a traceback for each and try all of them again: 60 connections at 32 descriptors made
18,502 tracebacks.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import logging
import os
import resource
import socket
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import NoReturn

from altd.ports import Clock
from altd.process.port_owner import listening_sockets, owner_of_socket
from altd.status.health import Component

log = logging.getLogger("altd")

BACKLOG = 128
"""Connections that the kernel keeps until they are accepted."""

RETRY_INTERVAL_S = 1.0
_ACCEPT_INTERVAL_S = 0.001
"""Between two connections."""

HANDSHAKE_TIMEOUT_S = 5.0
"""A client that has not done its part of a TLS handshake by then is cut off."""

SHUTDOWN_TIMEOUT_S = 1.0
MAX_HANDSHAKES = 16
"""TLS handshakes of an interface at a time."""

_NO_RESOURCES = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_NO_LISTENER = frozenset({errno.EBADF, errno.EINVAL, errno.ENOTSOCK})


def listen(host: str, port: int) -> socket.socket:
    """The listening socket; raises OSError that names the cause, where it is known, and a remedy."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        number = error.errno or errno.EADDRNOTAVAIL
        sentence = os.strerror(number) if number > 0 else f"no such address: {error.strerror}"
        raise OSError(number, f"{sentence}{_remedy(number, host, port)}") from error
    listener.setblocking(False)
    return listener


def _remedy(number: int, host: str, port: int) -> str:
    """The remedy for an address that cannot be listened on, as the end of a sentence."""
    if number == errno.EACCES:
        right = "the service may use ports from 502 up (sysctl net.ipv4.ip_unprivileged_port_start)"
        return f": {right}; by hand, choose a port from 1024 on"
    if number != errno.EADDRINUSE:
        return ""
    owners = filter(None, map(owner_of_socket, listening_sockets(host, port)))
    process, name = next(owners, (None, ""))
    by = f"`sudo ss -ltnp 'sport = :{port}'` shows by which program" if process is None else ""
    by = by or f"by {name} (process {process})"
    return f"{':' if process is None else ''} {by}; end it, or choose another port"


async def accept(
    listener: socket.socket,
    component: Component,
    admit: Callable[[socket.socket], Awaitable[None]],
) -> NoReturn:
    """Hand one connection after the other to ``admit``, until cancelled.

    A flood of them gets a part of the loop's time, and requests have the rest. Raises OSError when the
    listening socket itself is gone.
    """
    loop = asyncio.get_running_loop()
    while True:
        try:
            connection, _ = await loop.sock_accept(listener)
        except OSError as error:  # any other: that connection was gone already (accept(2))
            if error.errno in _NO_LISTENER:
                raise
            if error.errno in _NO_RESOURCES:
                component.count("accepts_failed")
                log.warning("%s: cannot accept connections: %s", component.name, error.strerror)
                await asyncio.sleep(RETRY_INTERVAL_S)
        else:
            try:
                await admit(connection)
            except OSError:  # it left meanwhile
                connection.close()
        await asyncio.sleep(_ACCEPT_INTERVAL_S)


def is_among_last(connection: socket.socket, kept_descriptors: int) -> bool:
    """Whether the connection has one of the process' last descriptors: cameras and ports need those.

    A new descriptor has the lowest number that is free (POSIX.1-2017, 2.14), so a high one says that few are.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return limit != resource.RLIM_INFINITY and connection.fileno() >= limit - kept_descriptors


Address = ipaddress.IPv4Address | ipaddress.IPv6Address

_V6_GROUP_BITS = 64
"""A host has a whole network of IPv6 addresses for itself (RFC 4291, 2.5.4)."""


def address_of(host: str) -> Address | None:
    """The address that a socket names: an IPv4 one where IPv6 only wraps it, without a zone; None: none."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return (address.ipv4_mapped or address) if isinstance(address, ipaddress.IPv6Address) else address


def is_loopback(address: Address | None) -> bool:
    """Whether it is the computer's own."""
    return address is not None and address.is_loopback


def group_of(address: Address) -> str:
    """The client that limits count it as: the address itself, or its network of IPv6."""
    if isinstance(address, ipaddress.IPv6Address):
        return str(ipaddress.IPv6Network((address, _V6_GROUP_BITS), strict=False))
    return str(address)


class Networks:
    """Networks of IP addresses, as the settings name them."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = tuple(map(ipaddress.ip_network, networks))

    def __bool__(self) -> bool:
        return bool(self._networks)

    def __contains__(self, address: Address | None) -> bool:
        return address is not None and any(address in network for network in self._networks)


MAX_KEYS = 1024
"""Of so many the last asking is remembered; who was longest silent is forgotten, which is to be forgiven."""


@dataclass(frozen=True, slots=True)
class Rate:
    """So many at once, and so many a second from then on."""

    burst: int
    per_s: float


CONNECTIONS = Rate(burst=200, per_s=100.0)
"""Of one address, where a connection costs a TLS handshake, before a byte of it is read."""


class Buckets:
    """A bucket of tokens for each key, filled by the monotonic clock."""

    def __init__(self, rate: Rate, clock: Clock) -> None:
        self._rate = rate
        self._clock = clock
        self._full_ns: OrderedDict[str, int] = OrderedDict()
        """When each bucket will be full again; the one that was used last comes last."""

    def wait_s(self, key: str) -> float:
        """Seconds until there is a token again; 0: there is one."""
        lacking_ns = self._full_ns.get(key, 0) - self._clock.monotonic_ns()
        room_ns = round((self._rate.burst - 1) / self._rate.per_s * 1e9)
        return max(lacking_ns - room_ns, 0) * 1e-9

    def take(self, key: str) -> float:
        """Take a token; returns the seconds until there is one again, where there is none: 0, it is taken."""
        if wait_s := self.wait_s(key):
            return wait_s
        now_ns = self._clock.monotonic_ns()
        self._full_ns[key] = max(self._full_ns.get(key, 0), now_ns) + round(1e9 / self._rate.per_s)
        self._full_ns.move_to_end(key)
        if len(self._full_ns) > MAX_KEYS:
            self._full_ns.popitem(last=False)
        return 0.0

    def give_back(self, key: str) -> None:
        """Release a port that was taken and is not used."""
        if key in self._full_ns:
            self._full_ns[key] -= round(1e9 / self._rate.per_s)
