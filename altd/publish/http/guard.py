"""Permission to act: by token, by session, or, without credentials, from the unit's own computer."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Protocol

from starlette.requests import HTTPConnection
from starlette.responses import Response

from altd.ports import Clock
from altd.publish.http.clients import ALL_ATTEMPTS, ATTEMPTS, MAX_FAMILIAR, MAX_SESSION_S, Sessions, host_of
from altd.publish.http.errors import Refused, refusal
from altd.runtime.threads import SingleCall
from altd.status.event_log import EventKind, EventLog
from altd.tcp_port import Buckets, address_of, group_of, is_loopback

REQUEST_HEADER = "X-Altd-Request"
"""Header that each action requires: a page of another site cannot send it without permission (CORS)."""

THIS_COMPUTER = "this computer"
"""User name if the address, or the local socket, alone gives the permission."""

_LOCAL_NAMES = ("localhost", "")
_UNFAMILIAR = "unfamiliar"


class CredentialStore(Protocol):
    """Users with a password or a token, implemented by ``altd.credentials``."""

    @property
    def names(self) -> frozenset[str]:
        """Names of all users that may act."""

    def is_password(self, name: str, password: str) -> bool:
        """Whether it is the password of this name. Takes long."""

    def password_of(self, name: str) -> object | None:
        """Value that changes with each new password of the user; None: the user has none."""

    def name_of_token(self, token: str) -> str | None:
        """User of a token; None: no user."""


class Guard:
    """Checks the permissions on one interface. ``credentials`` returns the current ones; None: none are set.

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
        self._unfamiliar_attempts = Buckets(ALL_ATTEMPTS, clock)
        self._familiar = OrderedDict[str, None]()
        """Addresses that have logged in, in the order of their last login."""
        self._verifying = SingleCall("password")
        """One at a time: each takes 16 MB and a core."""

    @property
    def has_credentials(self) -> bool:
        """Whether credentials are set, so that tokens and passwords give permission to act."""
        return self._credentials is not None

    def actor(self, request: HTTPConnection) -> str:
        """Return the user that requests an action; raises Refused without permission."""
        _check_is_no_other_page(request)
        if self._is_local or self._credentials is None:
            if not self._is_local:
                _check_is_own_computer(request)
            return THIS_COMPUTER
        return self._identified(request, self._credentials())

    def requester(self, request: HTTPConnection) -> str:
        """Return address and user of a requested action for the events; raises Refused without permission."""
        actor = self.actor(request)
        host = "" if request.client is None else f" {request.client.host}"
        return f"http{host}{'' if actor == THIS_COMPUTER else f', {actor}'}"

    def check_may_look(self, connection: HTTPConnection) -> None:
        """Raise Refused if the client may not see pictures: credentials are set, and it shows none."""
        if self._credentials is not None and not self._is_local:
            self._identified(connection, self._credentials())

    def _identified(self, request: HTTPConnection, credentials: CredentialStore) -> str:
        """Return the user of the token or session of the request; raises Refused.

        Unlike wrong passwords, failures are not counted: 256 bits cannot be guessed, and a page with an
        expired session, or a program with an old token, would keep its own user from logging in.
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
        """Return the logged-in user, for a request that only reads; None: no user."""
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
        credentials = self._credentials()
        if not await self._verifying.call(partial(credentials.is_password, name, password)):
            if name in credentials.names:
                self._note(request, "a wrong password", "login_refused", name)
            else:  # the name is not noted: some people type their password there
                self._note(request, "a wrong name or password", "login_refused")
            raise _unknown("name or password is wrong")
        self._return_attempt(request)
        self._note(request, "logged in", "login", name)
        return self._sessions.begin(name, credentials.password_of(name))

    def may_act(self, request: HTTPConnection) -> bool:
        """Whether the client may act, by its session, or, without credentials, by its address."""
        if self._credentials is not None and not self._is_local:
            return self.viewer(request) is not None
        try:
            if not self._is_local:
                _check_is_own_computer(request)
        except Refused:
            return False
        return True

    def log_out(self, request: HTTPConnection) -> None:
        """End the session of a request; raises Refused for a request of a foreign page."""
        _check_is_no_other_page(request)
        if self._credentials is None or (secret := secret_of(request)) is None:
            return
        if (name := self._name_of_session(secret, self._credentials())) is not None:
            self._note(request, "logged out", "logout", name)
        self._sessions.end(secret)

    def _name_of_session(self, secret: str, credentials: CredentialStore) -> str | None:
        """Return the user of a session; a changed or removed password invalidates it."""
        return self._sessions.name_of(secret, credentials.password_of)

    def _check_attempts(self, request: HTTPConnection) -> None:
        address = _group(request)
        wait_s = self._attempts.wait_s(address)
        if address not in self._familiar:
            wait_s = max(wait_s, self._unfamiliar_attempts.wait_s(_UNFAMILIAR))
        if wait_s:
            self._note(request, "too many wrong attempts", "attempts_limited")
            raise Refused(too_many("too many wrong attempts", wait_s))

    def _count_attempt(self, request: HTTPConnection) -> None:
        self._attempts.take(address := _group(request))
        if address not in self._familiar:
            self._unfamiliar_attempts.take(_UNFAMILIAR)

    def _note(self, request: HTTPConnection, what: str, code: str, name: str | None = None) -> None:
        """Note an action of a user and its address; the event log counts repetitions."""
        if self._events is None:
            return
        address = "an unknown address" if request.client is None else request.client.host
        detail = {"code": code, "address": address}
        self._events.note(EventKind.REQUEST, f"{what}, from {address}", name, None, detail)

    def _return_attempt(self, request: HTTPConnection) -> None:
        self._attempts.put_back(address := _group(request))
        if address not in self._familiar:
            self._unfamiliar_attempts.put_back(_UNFAMILIAR)
        self._familiar[address] = None
        self._familiar.move_to_end(address)
        if len(self._familiar) > MAX_FAMILIAR:
            self._familiar.popitem(last=False)


def too_many(sentence: str, wait_s: float) -> Response:
    """Return the response to a client that exceeds a rate."""
    seconds = max(math.ceil(wait_s), 1)
    return refusal(429, f"{sentence}; wait {seconds} s", {"Retry-After": str(seconds)})


def cookie_name(request: HTTPConnection) -> str:
    """Return the cookie name, with the port: cookies ignore ports, and two units may be behind one address.

    With TLS its prefix makes browsers accept it only from this host and only over TLS (RFC 6265bis, 4.1.3).
    """
    server = request.scope.get("server")
    port = server[1] if server is not None else 0
    return f"{'__Host-' if _is_tls(request) else ''}altd_{port}"


def session_cookie(request: HTTPConnection, secret: str) -> str:
    """Return the header that sets the session cookie of a browser, or, with an empty secret, deletes it."""
    parts = [
        f"{cookie_name(request)}={secret}",
        "Path=/",
        f"Max-Age={round(MAX_SESSION_S) if secret else 0}",
        "HttpOnly",
        "SameSite=Strict",
    ]
    return "; ".join([*parts, "Secure"] if _is_tls(request) else parts)


def secret_of(request: HTTPConnection) -> str | None:
    """Return the session secret of a request; None: there is none, or several, of which any may be ours."""
    wanted = cookie_name(request)
    found = [
        value.strip()
        for name, _, value in (part.partition("=") for part in request.headers.get("Cookie", "").split(";"))
        if name.strip() == wanted
    ]
    return found[0] if len(found) == 1 and found[0] else None


def _token_of(request: HTTPConnection) -> str | None:
    """Return the token of ``Authorization: Bearer`` (RFC 6750); None: no header; empty: another scheme."""
    header = request.headers.get("Authorization")
    if header is None:
        return None
    scheme, _, token = header.partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def _check_is_no_other_page(request: HTTPConnection) -> None:
    """Raise Refused for a foreign page: it cannot send our header without permission, nor hide its origin."""
    if REQUEST_HEADER not in request.headers:
        raise Refused(refusal(403, f"the header {REQUEST_HEADER} is missing"))
    own = f"{'https' if _is_tls(request) else 'http'}://{request.headers.get('Host', '')}"
    if request.headers.get("Origin", own) != own:
        raise Refused(refusal(403, "a page that is not the unit's own asks"))


def _check_is_own_computer(request: HTTPConnection) -> None:
    """Raise Refused for other computers and, against DNS rebinding in a local browser, for foreign names."""
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
    """Whether the connection itself uses TLS; headers are not trusted."""
    return request.scope.get("scheme") in ("https", "wss")


def _group(request: HTTPConnection) -> str:
    address = None if request.client is None else address_of(request.client.host)
    return "" if address is None else group_of(address)


def _unknown(sentence: str) -> Refused:
    return Refused(refusal(401, sentence, {"WWW-Authenticate": 'Bearer realm="altd"'}))
