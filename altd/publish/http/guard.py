"""Permission to act: by a token, by a session, or, where there is neither, from the unit's own computer."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Callable
from typing import Protocol

from starlette.requests import HTTPConnection
from starlette.responses import Response

from altd.ports import Clock
from altd.publish.http.clients import ALL_ATTEMPTS, ATTEMPTS, LONGEST_S, MAX_FAMILIAR, Sessions, host_of
from altd.publish.http.errors import Refused, refusal
from altd.status.event_log import EventKind, EventLog
from altd.tcp_port import Buckets, address_of, group_of, is_loopback

REQUEST_HEADER = "X-Altd-Request"
"""A page of another site, opened in a browser, cannot send it unasked (CORS): each action asks for it."""

THIS_COMPUTER = "this computer"
"""The user's name where the address alone gives the permission."""

_LOCAL_NAMES = ("localhost", "")
_STRANGERS = "strangers"


class CredentialStore(Protocol):
    """The users with a password or a token: ``altd.credentials``."""

    @property
    def names(self) -> frozenset[str]:
        """Everybody who may act."""

    def is_password(self, name: str, password: str) -> bool:
        """Whether it is his. Takes long."""

    def password_of(self, name: str) -> object | None:
        """A value that changes with each new password of the user; None: the user has none."""

    def name_of_token(self, token: str) -> str | None:
        """Whose token it is."""


class Guard:
    """One interface's guard. ``credentials`` gives those of this moment; None: no credentials are set.

    Logins, logouts and failed attempts are noted in ``events``.
    """

    def __init__(
        self,
        credentials: Callable[[], CredentialStore] | None,
        clock: Clock,
        events: EventLog | None = None,
        *,
        is_local: bool = False,
    ) -> None:
        self._credentials = credentials
        self._events = events
        self._is_local = is_local
        self._sessions = Sessions(clock)
        self._attempts = Buckets(ATTEMPTS, clock)
        self._strangers_attempts = Buckets(ALL_ATTEMPTS, clock)
        self._familiar = OrderedDict[str, None]()
        """Addresses that have logged in; the one that did so last comes last."""
        self._verifying = asyncio.Lock()

    @property
    def has_credentials(self) -> bool:
        """Whether tokens and passwords say who may act."""
        return self._credentials is not None

    def actor(self, request: HTTPConnection) -> str:
        """The user who asks for an action; raises Refused without permission."""
        _check_is_no_other_page(request)
        if self._is_local or self._credentials is None:
            if not self._is_local:
                _check_is_own_computer(request)
            return THIS_COMPUTER
        return self._identified(request, self._credentials())

    def requester(self, request: HTTPConnection) -> str:
        """The address and user who ask for an action, for the events; raises Refused without permission."""
        actor = self.actor(request)
        host = "" if request.client is None else f" {request.client.host}"
        return f"http{host}{'' if actor == THIS_COMPUTER else f', {actor}'}"

    def check_may_look(self, connection: HTTPConnection) -> None:
        """Raise Refused where pictures are not for this client: credentials are set, and it shows none."""
        if self._credentials is not None and not self._is_local:
            self._identified(connection, self._credentials())

    def _identified(self, request: HTTPConnection, credentials: CredentialStore) -> str:
        """The user, by the token or session of the request; raises Refused.

        What is wrong is not counted, as passwords are: 256 bits cannot be guessed, and a page whose session
        is over, or a program whose token is, would keep its own user from logging in.
        """
        token, secret = _token_of(request), secret_of(request)
        if token is not None:
            name = credentials.name_of_token(token)
        elif secret is not None:
            name = self._name_of_session(secret, credentials)
        else:
            raise _unknown("a token, or a session that /api/v1/login begins, is needed")
        if name is None:
            if token is not None:
                self._note(request, "a wrong token", "token_refused")
            raise _unknown("the token or the session is unknown or over")
        return name

    def viewer(self, request: HTTPConnection) -> str | None:
        """The user that is logged in, for a request that only reads; None: none."""
        secret = secret_of(request)
        if self._credentials is None or secret is None:
            return None
        return self._name_of_session(secret, self._credentials())

    async def log_in(self, request: HTTPConnection, name: str, password: str) -> str:
        """Begin a session; returns its secret. Raises Refused."""
        _check_is_no_other_page(request)
        if self._credentials is None:
            raise Refused(refusal(409, "logging in is not possible: [http] credentials is not set"))
        self._check_attempts(request)
        self._count_attempt(request)
        async with self._verifying:  # one at a time: each takes 16 MB and a core
            credentials = self._credentials()
            fits = await asyncio.to_thread(credentials.is_password, name, password)
        if not fits:
            if name in credentials.names:
                self._note(request, "a wrong password", "login_refused", name)
            else:  # the name is not noted: some people type their password there
                self._note(request, "a wrong name or password", "login_refused")
            raise _unknown("name or password is wrong")
        self._forgive(request)
        self._note(request, "logged in", "login", name)
        return self._sessions.begin(name, credentials.password_of(name))

    def may_act(self, request: HTTPConnection) -> bool:
        """Whether an action could be asked for from there, with what the request shows."""
        if self._credentials is not None and not self._is_local:
            return self.viewer(request) is not None
        try:
            if not self._is_local:
                _check_is_own_computer(request)
        except Refused:
            return False
        return True

    def log_out(self, request: HTTPConnection) -> None:
        """End the session of a request; raises Refused where a page of elsewhere does."""
        _check_is_no_other_page(request)
        if self._credentials is None or (secret := secret_of(request)) is None:
            return
        if (name := self._name_of_session(secret, self._credentials())) is not None:
            self._note(request, "logged out", "logout", name)
        self._sessions.end(secret)

    def _name_of_session(self, secret: str, credentials: CredentialStore) -> str | None:
        """Whose it is; a password that was changed, or taken out, ends it."""
        return self._sessions.name_of(secret, credentials.password_of)

    def _check_attempts(self, request: HTTPConnection) -> None:
        address = _group(request)
        wait_s = self._attempts.wait_s(address)
        if address not in self._familiar:
            wait_s = max(wait_s, self._strangers_attempts.wait_s(_STRANGERS))
        if wait_s:
            self._note(request, "too many wrong attempts", "attempts_limited")
            raise Refused(too_many("too many wrong attempts", wait_s))

    def _count_attempt(self, request: HTTPConnection) -> None:
        self._attempts.take(address := _group(request))
        if address not in self._familiar:
            self._strangers_attempts.take(_STRANGERS)

    def _note(self, request: HTTPConnection, what: str, code: str, name: str | None = None) -> None:
        """Note what a user did, and from which address; what repeats, the log counts."""
        if self._events is None:
            return
        address = "an unknown address" if request.client is None else request.client.host
        detail = {"code": code, "address": address}
        self._events.note(EventKind.REQUEST, f"{what}, from {address}", name, None, detail)

    def _forgive(self, request: HTTPConnection) -> None:
        self._attempts.give_back(address := _group(request))
        if address not in self._familiar:
            self._strangers_attempts.give_back(_STRANGERS)
        self._familiar[address] = None
        self._familiar.move_to_end(address)
        if len(self._familiar) > MAX_FAMILIAR:
            self._familiar.popitem(last=False)


def too_many(sentence: str, wait_s: float) -> Response:
    """The answer to a client that asks too often."""
    seconds = max(math.ceil(wait_s), 1)
    return refusal(429, f"{sentence}; wait {seconds} s", {"Retry-After": str(seconds)})


def cookie_name(request: HTTPConnection) -> str:
    """The cookie of this interface. Cookies know no ports: two units behind one address have two names.

    With TLS its prefix has browsers take it from this host only, and never without TLS (RFC 6265bis, 4.1.3).
    """
    server = request.scope.get("server")
    port = server[1] if server is not None else 0
    return f"{'__Host-' if _is_tls(request) else ''}altd_{port}"


def session_cookie(request: HTTPConnection, secret: str) -> str:
    """The header that gives a browser its session, or with an empty secret takes it away."""
    parts = [
        f"{cookie_name(request)}={secret}",
        "Path=/",
        f"Max-Age={round(LONGEST_S) if secret else 0}",
        "HttpOnly",
        "SameSite=Strict",
    ]
    return "; ".join([*parts, "Secure"] if _is_tls(request) else parts)


def secret_of(request: HTTPConnection) -> str | None:
    """The session that a request names; None: none, or several, of which any may be ours."""
    wanted = cookie_name(request)
    found = [
        value.strip()
        for name, _, value in (part.partition("=") for part in request.headers.get("Cookie", "").split(";"))
        if name.strip() == wanted
    ]
    return found[0] if len(found) == 1 and found[0] else None


def _token_of(request: HTTPConnection) -> str | None:
    """The token of ``Authorization: Bearer`` (RFC 6750); None: there is none. Another scheme: a wrong one."""
    header = request.headers.get("Authorization")
    if header is None:
        return None
    scheme, _, token = header.partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def _check_is_no_other_page(request: HTTPConnection) -> None:
    """A page of elsewhere can neither send our header unasked nor hide where it is from."""
    if REQUEST_HEADER not in request.headers:
        raise Refused(refusal(403, f"the header {REQUEST_HEADER} is missing"))
    own = f"{'https' if _is_tls(request) else 'http'}://{request.headers.get('Host', '')}"
    if request.headers.get("Origin", own) != own:
        raise Refused(refusal(403, "a page that is not the unit's own asks"))


def _check_is_own_computer(request: HTTPConnection) -> None:
    """By its address; a name in ``Host`` may have been bent to the unit for a browser that runs on it."""
    client, server = request.client, request.scope.get("server")
    theirs = None if client is None else address_of(client.host)
    ours = None if server is None else address_of(server[0])
    if theirs is None or not (is_loopback(theirs) or theirs == ours):
        sentence = "only the unit's own computer may ask for this: [http] credentials is not set"
        raise Refused(refusal(403, sentence))
    host = host_of(request.headers.get("Host", ""))
    if host not in _LOCAL_NAMES and address_of(host) is None:
        raise Refused(refusal(403, "the header Host names no address of the unit"))


def _is_tls(request: HTTPConnection) -> bool:
    """From the connection itself; no header is believed."""
    return request.scope.get("scheme") in ("https", "wss")


def _group(request: HTTPConnection) -> str:
    address = None if request.client is None else address_of(request.client.host)
    return "" if address is None else group_of(address)


def _unknown(sentence: str) -> Refused:
    return Refused(refusal(401, sentence, {"WWW-Authenticate": "Bearer"}))
