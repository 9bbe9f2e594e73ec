"""Clients: networks that may connect, rates of requests per address, and sessions of logged-in users."""

from __future__ import annotations

import hashlib
import secrets
import socket
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from altd.ports import Clock
from altd.tcp_port import Networks, Rate, address_of, is_loopback


def host_of(header: str) -> str:
    """Return the name or address in a header ``Host``, without the port."""
    if header.startswith("["):
        return header[1:].partition("]")[0]
    return header.partition(":")[0]


class OwnNames:
    """Names by which a browser may address the unit: any address, the computer's own name, and ``names``.

    A foreign page may have redirected any other name to the unit's address (DNS rebinding), to read
    everything that the browser's computer can read.
    """

    def __init__(self, names: Iterable[str]) -> None:
        own = socket.gethostname().lower()
        short = own.partition(".")[0]
        self._names = {"", "localhost", own, short, f"{short}.local", *(name.lower() for name in names)}

    def __contains__(self, header: str) -> bool:
        host = host_of(header)
        return address_of(host) is not None or host.lower().removesuffix(".") in self._names


class Allowed:
    """Clients that may connect: the unit's own computer and ``networks``; all clients without networks."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = Networks(networks)

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        address = address_of(host)
        return is_loopback(address) or address in self._networks


REQUESTS = Rate(burst=100, per_s=50.0)
"""Limit of requests per address: ten browsers at one address send about 20/s; a request takes about 1 ms."""

ATTEMPTS = Rate(burst=5, per_s=0.1)
"""Limit of wrong passwords per address."""

ALL_ATTEMPTS = Rate(burst=20, per_s=0.2)
"""Limit of wrong passwords of all addresses without a login: each attempt takes 0.2 s of a core."""

SELF_CHECK_WAIT_S = 25.0
"""Time limit of a requested check, which ends earlier unless the cameras do not deliver."""

MAX_WAITING = 8
"""Maximum number of clients that wait for a check, so that connections remain for reading clients."""

MAX_FAMILIAR = 16
"""Number of addresses with the latest logins that have their own attempts, independent of other clients."""


MAX_SESSIONS = 16
IDLE_S = 1800.0
MAX_SESSION_S = 8 * 3600.0


@dataclass(slots=True)
class _Session:
    name: str
    password: object
    began_ns: int
    used_ns: int


class Sessions:
    """Sessions of logged-in users. Only the hash of a session's secret is stored, as its key."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sessions: OrderedDict[bytes, _Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, name: str, password: object = None) -> str:
        """Begin a session with a password, or its hash; returns its secret.

        If there are too many, the one unused for longest ends.
        """
        secret, now_ns = secrets.token_urlsafe(32), self._clock.monotonic_ns()
        self._sessions[_key(secret)] = _Session(name, password, now_ns, now_ns)
        while len(self._sessions) > MAX_SESSIONS:
            self._sessions.popitem(last=False)
        return secret

    def name_of(self, secret: str, password_of: Callable[[str], object] = lambda name: None) -> str | None:
        """Return the user of a session; None: there is no such session, or it has expired.

        Also None while ``password_of`` returns another value than the ``password`` of ``begin``.
        """
        key, now_ns = _key(secret), self._clock.monotonic_ns()
        session = self._sessions.get(key)
        if session is None:
            return None
        if now_ns - session.used_ns > IDLE_S * 1e9 or now_ns - session.began_ns > MAX_SESSION_S * 1e9:
            del self._sessions[key]
            return None
        if session.password != password_of(session.name):
            return None
        session.used_ns = now_ns
        self._sessions.move_to_end(key)
        return session.name

    def end(self, secret: str) -> None:
        """End the session of a secret, if there is one."""
        self._sessions.pop(_key(secret), None)


def _key(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).digest()
