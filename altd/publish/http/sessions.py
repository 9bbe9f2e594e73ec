"""Sessions of users who logged in: on the unit, few, limited in time by the monotonic clock."""

from __future__ import annotations

import hashlib
import secrets
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from altd.ports import Clock

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
        """It is over, if there was one."""
        self._sessions.pop(_key(secret), None)


def _key(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).digest()
