"""TCP ports: accept connections so that a flood of them costs little; limit clients by address.

asyncio's own servers accept all waiting connections in a row. When descriptors run out (EMFILE), they log a
traceback for each connection and retry all of them: 60 connections at 32 descriptors caused 18,502
tracebacks.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import errno
import ipaddress
import logging
import os
import resource
import socket
import struct
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NoReturn

from altd.ports import Clock
from altd.process.port_owner import listening_sockets, owner_of_socket
from altd.status.health import Component

log = logging.getLogger("altd")

BACKLOG = 128
"""Maximum number of connections that the kernel keeps until they are accepted."""

RETRY_INTERVAL_S = 1.0
_ACCEPT_INTERVAL_S = 0.001
"""Time between two accepted connections."""

HANDSHAKE_TIMEOUT_S = 5.0
"""Maximum time of a TLS handshake; then the client is disconnected."""

SHUTDOWN_TIMEOUT_S = 1.0
MAX_HANDSHAKES = 16
"""Maximum number of simultaneous TLS handshakes of an interface."""

_NO_RESOURCES = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_NO_LISTENER = frozenset({errno.EBADF, errno.EINVAL, errno.ENOTSOCK})


def listen(host: str, port: int) -> socket.socket:
    """Open the listening socket; raises OSError that names the cause, if known, and a remedy.

    ``::`` serves IPv4 too.
    """
    try:
        listener = _server(host, port)
    except OSError as error:
        number = error.errno or errno.EADDRNOTAVAIL
        sentence = os.strerror(number) if number > 0 else f"no such address: {error.strerror}"
        raise OSError(number, f"{sentence}{_remedy(number, host, port)}") from error
    listener.setblocking(False)
    return listener


def _server(host: str, port: int, *, reuse_port: bool = False) -> socket.socket:
    return socket.create_server(
        (host, port),
        family=socket.AF_INET6 if ":" in host else socket.AF_INET,
        backlog=BACKLOG,
        reuse_port=reuse_port,
        dualstack_ipv6=host == "::" and socket.has_dualstack_ipv6(),
    )


_SO_ATTACH_REUSEPORT_CBPF = 51
_FROM_NETWORK_HEADER = 0xFFF00000
"""``SKF_NET_OFF`` of linux/filter.h: an offset counts from the header of the network's protocol."""
_LOAD_WORD, _LOAD_BYTE, _AND, _SKIP_UNLESS_EQUAL, _RETURN = 0x20, 0x30, 0x54, 0x15, 0x06
_INSTRUCTION = struct.Struct("HBBI")
"""``struct sock_filter`` of linux/filter.h: code, instructions to skip if true, if false, operand."""


def listen_with_reserved(host: str, port: int, reserved: Iterable[str]) -> list[socket.socket]:
    """Open the listening sockets of a port: one, and a second for clients in ``reserved`` networks.

    Each has its own queue in the kernel, so that these clients connect while others flood the first one.
    Raises OSError as ``listen`` does.
    """
    listener = listen(host, port)
    versions = {4, 6} if host == "::" else {6 if ":" in host else 4}
    networks = map(ipaddress.ip_network, reserved)
    program = b"".join(_matches(network for network in networks if network.version in versions))
    if not program:
        return [listener]
    # Sockets that share a port would share it with another daemon of this user too. `listen` does not share:
    # it has just shown that the port is free.
    port = listener.getsockname()[1]
    listener.close()
    program += _INSTRUCTION.pack(_RETURN, 0, 0, 0)
    memory = ctypes.create_string_buffer(program, len(program))
    fprog = struct.pack("HP", len(program) // _INSTRUCTION.size, ctypes.addressof(memory))
    with contextlib.ExitStack() as opened:
        listeners = [opened.enter_context(_server(host, port, reuse_port=True)) for _ in range(2)]
        listeners[0].setsockopt(socket.SOL_SOCKET, _SO_ATTACH_REUSEPORT_CBPF, fprog)
        for one in listeners:
            one.setblocking(False)
        opened.pop_all()
    return listeners


def _matches(networks: Iterable[ipaddress.IPv4Network | ipaddress.IPv6Network]) -> Iterator[bytes]:
    """Yield a filter program for each network: it returns 1, the second socket, on a match.

    The first four bits of a packet are its IP version.
    """
    for network in networks:
        source_offset = 12 if network.version == 4 else 8
        length = network.max_prefixlen // 8
        words = struct.Struct(f">{length // 4}I")
        wanted = words.unpack(network.network_address.packed)
        masks = words.unpack(network.netmask.packed)
        yield _INSTRUCTION.pack(_LOAD_BYTE, 0, 0, _FROM_NETWORK_HEADER)
        yield _INSTRUCTION.pack(_AND, 0, 0, 0xF0)
        yield _INSTRUCTION.pack(_SKIP_UNLESS_EQUAL, 0, 3 * len(masks) + 1, network.version << 4)
        for n, (word, mask) in enumerate(zip(wanted, masks, strict=True)):
            to_next_network = 3 * (len(masks) - n - 1) + 1
            yield _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _FROM_NETWORK_HEADER + source_offset + 4 * n)
            yield _INSTRUCTION.pack(_AND, 0, 0, mask)
            yield _INSTRUCTION.pack(_SKIP_UNLESS_EQUAL, 0, to_next_network, word)
        yield _INSTRUCTION.pack(_RETURN, 0, 0, 1)


def _remedy(number: int, host: str, port: int) -> str:
    """Return the remedy for an address that cannot be listened on, as the end of a sentence."""
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
    """Pass one connection after the other to ``admit``, until cancelled.

    A flood of connections gets only a part of the loop's time; requests get the rest. Raises OSError if the
    listening socket itself is gone.
    """
    while True:
        try:
            await _readable(listener)
            connection, _ = listener.accept()
            connection.setblocking(False)
        except OSError as error:  # any other error: that connection was gone already (accept(2))
            if error.errno in _NO_LISTENER:
                raise
            if error.errno in _NO_RESOURCES:
                component.count("accepts_failed")
                log.warning("%s: cannot accept connections: %s", component.name, error.strerror)
                await asyncio.sleep(RETRY_INTERVAL_S)
        else:
            try:
                await admit(connection)
            except OSError:  # the client has disconnected meanwhile
                connection.close()
        await asyncio.sleep(_ACCEPT_INTERVAL_S)


async def _readable(listener: socket.socket) -> None:
    """Wait for a connection. ``loop.sock_accept`` loses one that it has accepted when it is cancelled."""
    loop = asyncio.get_running_loop()
    ready = asyncio.Event()
    loop.add_reader(listener, ready.set)
    try:
        await ready.wait()
    finally:
        loop.remove_reader(listener)


def is_among_last(connection: socket.socket, kept_descriptors: int) -> bool:
    """Whether the connection has one of the process's last descriptors, which cameras and ports need.

    A new descriptor gets the lowest free number (POSIX.1-2017, 2.14): a high number means that few are free.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return limit != resource.RLIM_INFINITY and connection.fileno() >= limit - kept_descriptors


Address = ipaddress.IPv4Address | ipaddress.IPv6Address

_V6_GROUP_BITS = 64
"""Prefix length of one IPv6 client: a host has a whole network of addresses (RFC 4291, 2.5.4)."""


def address_of(host: str) -> Address | None:
    """Return a host's IP address, without zone and with mapped IPv4 unwrapped; None: not an address."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return (address.ipv4_mapped or address) if isinstance(address, ipaddress.IPv6Address) else address


def is_loopback(address: Address | None) -> bool:
    """Whether ``address`` is a loopback address of this computer."""
    return address is not None and address.is_loopback


def group_of(address: Address) -> str:
    """Return the client to which limits apply: the address itself, or its IPv6 network."""
    if isinstance(address, ipaddress.IPv6Address):
        return str(ipaddress.IPv6Network((address, _V6_GROUP_BITS), strict=False))
    return str(address)


class Networks:
    """IP networks given in the settings."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = tuple(map(ipaddress.ip_network, networks))

    def __bool__(self) -> bool:
        return bool(self._networks)

    def __contains__(self, address: Address | None) -> bool:
        return address is not None and any(address in network for network in self._networks)


MAX_KEYS = 1024
"""Maximum number of remembered keys; beyond it, the key unused for longest gets a full bucket again."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Maximum number at once, and rate per second after that."""

    burst: int
    per_s: float


CONNECTIONS = Rate(burst=200, per_s=100.0)
"""Limit of connections per address, before a byte is read, if each costs a TLS handshake."""


class Buckets:
    """A token bucket for each key, filled by the monotonic clock."""

    def __init__(self, rate: Rate, clock: Clock) -> None:
        self._rate = rate
        self._clock = clock
        self._full_ns: OrderedDict[str, int] = OrderedDict()
        """Time at which each bucket will be full again, in the order of last use."""

    def wait_s(self, key: str) -> float:
        """Return the time until a token is available, s; 0: now."""
        lacking_ns = self._full_ns.get(key, 0) - self._clock.monotonic_ns()
        room_ns = round((self._rate.burst - 1) / self._rate.per_s * 1e9)
        return max(lacking_ns - room_ns, 0) * 1e-9

    def take(self, key: str) -> float:
        """Take a token and return 0; if there is none, return the time until the next one, s."""
        if wait_s := self.wait_s(key):
            return wait_s
        now_ns = self._clock.monotonic_ns()
        self._full_ns[key] = max(self._full_ns.get(key, 0), now_ns) + round(1e9 / self._rate.per_s)
        self._full_ns.move_to_end(key)
        if len(self._full_ns) > MAX_KEYS:
            self._full_ns.popitem(last=False)
        return 0.0

    def put_back(self, key: str) -> None:
        """Return a token that was taken."""
        if key in self._full_ns:
            self._full_ns[key] -= round(1e9 / self._rate.per_s)
