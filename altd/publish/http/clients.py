"""The clients: which may connect, how often an address may ask, and the sessions of users who logged in."""

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
    """The name or address in a header ``Host``, without the port."""
    if header.startswith("["):
        return header[1:].partition("]")[0]
    return header.partition(":")[0]


class OwnNames:
    """The names by which a browser may address the unit: an address, the computer's own name, and ``names``.

    Any other name may be one that a page of elsewhere has bent to the unit's address (DNS rebinding), so as
    to read what the browser's computer can.
    """

    def __init__(self, names: Iterable[str]) -> None:
        own = socket.gethostname().lower()
        short = own.partition(".")[0]
        self._names = {"", "localhost", own, short, f"{short}.local", *(name.lower() for name in names)}

    def __contains__(self, header: str) -> bool:
        host = host_of(header)
        return address_of(host) is not None or host.lower().removesuffix(".") in self._names


class Allowed:
    """Clients that may connect: the unit's own computer, and the networks; all clients if none is named."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = Networks(networks)

    def __contains__(self, host: str) -> bool:
        if not self._networks:
            return True
        address = address_of(host)
        return is_loopback(address) or address in self._networks


REQUESTS = Rate(burst=100, per_s=50.0)
"""Of one address: ten browsers behind one address ask for some 20 a second, a request takes about 1 ms."""

ATTEMPTS = Rate(burst=5, per_s=0.1)
"""Wrong passwords of one address."""

ALL_ATTEMPTS = Rate(burst=20, per_s=0.2)
"""The same of all addresses that have not logged in: a password that is tried takes 0.2 s of a core."""

SELF_CHECK_WAIT_S = 25.0
"""A check that was asked for has ended by then, unless the cameras do not deliver."""

MAX_WAITING = 8
"""More do not wait for a check at once, so that connections are left for those who read."""

MAX_FAMILIAR = 16
"""Addresses that have logged in, the last of them: each has its own attempts, whatever others try."""


MAX_SESSIONS = 16
IDLE_S = 1800.0
LONGEST_S = 8 * 3600.0


@dataclass(slots=True)
class _Session:
    name: str
    password: object
    began_ns: int
    used_ns: int


class Sessions:
    """The users that are logged in. The key of a session is kept as a hash, by which it is found."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sessions: OrderedDict[bytes, _Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, name: str, password: object = None) -> str:
        """A new session by a password, or its hash; returns its secret.

        Where there are too many, the one longest unused ends.
        """
        secret, now_ns = secrets.token_urlsafe(32), self._clock.monotonic_ns()
        self._sessions[_key(secret)] = _Session(name, password, now_ns, now_ns)
        while len(self._sessions) > MAX_SESSIONS:
            self._sessions.popitem(last=False)
        return secret

    def name_of(self, secret: str, password_of: Callable[[str], object] = lambda name: None) -> str | None:
        """Whose session it is; None: there is no such session, or it is over.

        Nor is it his while ``password_of`` gives something else for the name than it was begun with.
        """
        key, now_ns = _key(secret), self._clock.monotonic_ns()
        session = self._sessions.get(key)
        if session is None:
            return None
        if now_ns - session.used_ns > IDLE_S * 1e9 or now_ns - session.began_ns > LONGEST_S * 1e9:
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
