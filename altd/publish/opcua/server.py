"""asyncua's server on an already listening socket, with limits for connections.

Private parts of asyncua that are used: ``OPCUAProtocol._buffer``, ``UaProcessor._connection``,
``Server._setup_server_nodes``, ``Server._policies``, ``InternalSubscription._not_acknowledged_results``.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager

from altd.credentials.file import CredentialsKeeper
from altd.publish.opcua.sessions import MAX_QUEUED_VALUES, MAX_SUBSCRIPTIONS, SESSION_TIMEOUT_S, Session
from altd.tcp_port import address_of, group_of

MAX_CONNECTIONS = 16
MAX_CONNECTIONS_OF_ONE_ADDRESS = 8
MAX_SESSIONS = 2 * MAX_CONNECTIONS
MAX_SESSIONS_BEGUN = 20
"""Maximum number of sessions that one connection may begin: each leaves a task of asyncua behind."""
ACTIVATION_TIMEOUT_S = 10.0
IDLE_TIMEOUT_S = 120.0
"""Time without a received byte until a connection is closed."""

MAX_REQUEST_BYTES = 1 << 16
MIN_BUFFER_BYTES = 8192
"""Minimum buffer of a client (OPC 10000-6, 7.1.2.3); less would split every answer into countless pieces."""
MAX_UNSENT_BYTES = 4 << 20
"""Maximum size of answers that a client has not read; its connection is closed beyond it."""

_NO_SECURITY = "http://opcfoundation.org/UA/SecurityPolicy#None"
_KEEP_ALIVE = {socket.TCP_KEEPIDLE: 10, socket.TCP_KEEPINTVL: 5, socket.TCP_KEEPCNT: 3}
"""TCP keep-alive: a client that lost power or network occupies its place for 25 s."""


class _Connection(OPCUAProtocol):
    """A client's connection. asyncua buffers what a header announces, up to 4 GB, and unread answers."""

    heard_s = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Admit the client, or close the connection."""
        self.heard_s = time.monotonic()
        of_address = _group(transport)
        same = sum(_group(each.transport) == of_address for each in self.clients)
        if same >= MAX_CONNECTIONS_OF_ONE_ADDRESS or len(self.clients) >= MAX_CONNECTIONS:
            self.iserver.refuse("connections")
            transport.close()
            return
        super().connection_made(transport)
        self.iserver.clients_changed.set()
        sock = transport.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in _KEEP_ALIVE.items():
            sock.setsockopt(socket.IPPROTO_TCP, option, value)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 25_000)
        self.transport.set_write_buffer_limits(high=MAX_UNSENT_BYTES)
        if not any(policy.matches(_NO_SECURITY) for policy in self.policies):
            # asyncua lets clients open such a channel anyway, and then checks no permission
            connection = self.processor._connection  # noqa: SLF001
            connection.security_policy.permissions = _Nothing()

    def connection_lost(self, ex: BaseException | None) -> None:
        """Remove the client."""
        self.iserver.begun.pop(self.peer_name, None)
        if self.processor is not None and self.processor.session is not None:
            self.processor.session.is_left = True
        super().connection_lost(ex)
        self.closing_tasks[:] = [task for task in self.closing_tasks if not task.done()]
        self.iserver.clients_changed.set()

    def data_received(self, data: bytes) -> None:
        """Process bytes; a chunk larger than agreed ends the connection before it is complete."""
        self.heard_s = time.monotonic()
        if self.transport is None or self.transport.is_closing():
            return
        super().data_received(data)
        if len(self._buffer) > self.limits.max_recv_buffer:
            self.abort()

    def pause_writing(self) -> None:
        """End the connection of a client that does not read its answers."""
        self.abort()

    def abort(self) -> None:
        """End the connection at once."""
        self.iserver.refuse("connections")
        if self.transport is not None:
            self.transport.abort()


class _Nothing(PermissionRuleset):
    """Permissions over a channel without security if the unit offers none: only requests for endpoints."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: Any) -> bool:
        """Refuse the request."""
        return False


class _Limits(TransportLimits):
    """Limits with a minimum buffer: asyncua splits answers by any buffer size that a client names."""

    def create_acknowledge_and_set_limits(self, msg: ua.Hello) -> ua.Acknowledge:
        """Answer the client's limits; raises ServiceError for impossible ones."""
        if min(msg.ReceiveBufferSize, msg.SendBufferSize) < MIN_BUFFER_BYTES:
            raise ServiceError(ua.StatusCodes.BadTcpInternalError)
        return super().create_acknowledge_and_set_limits(msg)


class _Users(UserManager):
    """Names and passwords of a file; without a file every client may read."""

    def __init__(self, keeper: CredentialsKeeper | None) -> None:
        self._keeper = keeper

    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,
    ) -> User | None:
        """Return a client that may read, else None. asyncua's manager makes any "admin" an administrator."""
        if self._keeper is None:
            return User(UserRole.User)
        is_known = username and password and self._keeper.current().is_password(username, password)
        return User(UserRole.User, username) if is_known else None


class LimitedServer(InternalServer):
    """State that clients share.

    asyncua keeps sessions that are never activated, and servers that strangers register. It decrypts
    passwords by RSA with PKCS #1 1.5 and answers differently if the padding is wrong, by which a client could
    decrypt what others have sent.
    """

    def __init__(self, keeper: CredentialsKeeper | None) -> None:
        super().__init__(user_manager=_Users(keeper))
        self.allow_remote_admin = False
        self.max_connections = MAX_CONNECTIONS
        self.max_pending_activation_seconds = ACTIVATION_TIMEOUT_S
        self.max_session_timeout_ms = 1000 * SESSION_TIMEOUT_S
        self.max_unacked_messages_per_subscription = MAX_QUEUED_VALUES
        self.max_monitored_item_queue_size = MAX_QUEUED_VALUES
        self.max_subscriptions = MAX_SESSIONS * MAX_SUBSCRIPTIONS
        self.max_pending_messages_per_connection = 64
        named = (ua.UserNameIdentityToken,)
        self.supported_tokens = (ua.AnonymousIdentityToken,) if keeper is None else named
        self.sessions: dict[ua.NodeId, Session] = {}
        """Sessions of clients, by their tokens."""
        self._ending: set[asyncio.Future[None]] = set()
        self.begun: Counter[Any] = Counter()
        self.clients_changed = asyncio.Event()
        self.failed_logins: dict[str, float] = {}
        self.refused: Counter[str] = Counter()
        """Number of requests over a limit, by kind."""
        self.withdraw_stale: Callable[[], Awaitable[None]]
        self.read_history: Callable[[ua.HistoryReadParameters], Awaitable[list[ua.HistoryReadResult]]]

    def refuse(self, what: str) -> None:
        """Count a refusal."""
        self.refused[what] += 1

    def lookup_external_session(self, auth_token: ua.NodeId) -> Session | None:
        """Return the session with a token."""
        return self.sessions.get(auth_token)

    def register_external_session(self, session: Session) -> None:
        """Keep a session."""
        self.sessions[session.auth_token] = session

    def unregister_external_session(self, session: Session) -> None:
        """Forget a session."""
        self.sessions.pop(session.auth_token, None)

    def create_session(self, name: Any, user: User = User(), external: bool = False) -> InternalSession:  # noqa: B008
        """Create a session of the connection with this peer name; raises ServiceError for too many."""
        now_s = time.monotonic()
        for session in list(self.sessions.values()):
            if not session.is_activated() and now_s - session.active_s > ACTIVATION_TIMEOUT_S:
                self.unregister_external_session(session)
        self.begun[name] += 1
        if len(self.sessions) >= MAX_SESSIONS:
            self._end_previous()
        is_open = any(session.name == name and not session.is_left for session in self.sessions.values())
        if is_open or self.begun[name] > MAX_SESSIONS_BEGUN or len(self.sessions) >= MAX_SESSIONS:
            self.refuse("sessions")
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        return Session(self, self.aspace, self.subscription_service, name, user=user, external=external)

    def _end_previous(self) -> None:
        """End the oldest abandoned session: lost clients may return for a time, but must not block others."""
        left = [session for session in self.sessions.values() if session.is_left]
        if left:
            oldest = min(left, key=lambda session: session.active_s)
            self.unregister_external_session(oldest)
            self._ending = {each for each in self._ending if not each.done()}
            self._ending.add(asyncio.ensure_future(oldest.close_session()))

    def register_server(self, server: Any, conf: Any = None) -> None:
        """Refuse: the unit is not a discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def decrypt_user_token(self, isession: Any, token: ua.UserNameIdentityToken) -> tuple[str, str]:
        """Return name and password; raises ServiceError for an unsafe algorithm."""
        if token.EncryptionAlgorithm and token.EncryptionAlgorithm.endswith("#rsa-1_5"):
            raise ServiceError(ua.StatusCodes.BadSecurityPolicyRejected)
        return super().decrypt_user_token(isession, token)


class OpcUaServer(Server):
    """The server on an already listening socket."""

    def __init__(self, listener: socket.socket, keeper: CredentialsKeeper | None) -> None:
        self.limited = LimitedServer(keeper)
        super().__init__(iserver=self.limited)
        self._listener = listener
        self.limits = _Limits(MAX_REQUEST_BYTES - 1, MAX_REQUEST_BYTES - 1, 4, MAX_REQUEST_BYTES)

    async def start(self) -> None:
        """Start to serve clients."""
        await self._setup_server_nodes()
        await self.iserver.start()
        self.bserver = shared = BinaryServer(self.iserver, "", 0, self.limits)

        def connection() -> _Connection:
            return _Connection(
                self.iserver, self._policies, shared.clients, shared.closing_tasks, self.limits
            )

        self._listening = await asyncio.get_running_loop().create_server(connection, sock=self._listener)

    async def stop(self) -> None:
        """Stop to serve clients."""
        self._listening.close()
        await super().stop()

    def close_idle(self) -> None:
        """Close silent connections; asyncua ends their sessions but keeps the connections."""
        now_s = time.monotonic()
        for client in list(self.bserver.clients) if self.bserver else ():
            if isinstance(client, _Connection) and now_s - client.heard_s > IDLE_TIMEOUT_S:
                client.abort()


def _group(transport: asyncio.BaseTransport | None) -> str:
    peer = transport.get_extra_info("peername") if transport is not None else None
    address = address_of(peer[0]) if peer else None
    return "" if address is None else group_of(address)
