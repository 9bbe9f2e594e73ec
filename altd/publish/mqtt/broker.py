"""One connection to a broker: its socket is closed in any case, and received data is limited."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import socket
import ssl
import struct
from collections.abc import AsyncIterator, Callable
from types import TracebackType
from typing import Any, Self

import aiomqtt
from paho.mqtt.client import Client as PahoClient
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from altd.config import MqttSettings
from altd.errors import one_line
from altd.publish.mqtt.limits import NO_MQTT, BrokerError, Limits, why_ended, why_not_taken, why_refused
from altd.runtime.threads import SingleCall

KEEP_ALIVE_S = 10
"""Keep-alive time. A broker that receives nothing for 1.5 times as long publishes the will."""

CONNECT_TIMEOUT_S = 10.0
"""Maximum time from resolving the broker's name to CONNACK."""

ACK_TIMEOUT_S = 5.0
"""Maximum time until a message is acknowledged; a longer time ends the connection."""

GOODBYE_TIMEOUT_S = 1.0
"""Maximum time for sending ``offline`` and ending the connection."""

MAX_RECEIVED_BYTES = 64 << 10
MAX_RECEIVED_BYTES_PER_MESSAGE = 256
"""Limits of received bytes: for handshake and CONNACK, and for the acknowledgement of each message."""

MAX_PACKET_BYTES = 4096
"""Maximum size of a packet to the unit; the broker drops larger ones (Maximum Packet Size of MQTT 5)."""

MAX_UNACKNOWLEDGED = 8
"""Maximum number of unacknowledged messages to the unit (Receive Maximum of MQTT 5), and from it."""

_TCP_INFO_BYTES = 136
_BYTES_RECEIVED = struct.Struct("=128xQ")
"""``tcpi_bytes_received`` in ``struct tcp_info`` of linux/tcp.h."""

Login = tuple[str, str] | None
"""User name and password."""

_log = logging.getLogger("altd.mqtt")
_log.disabled = True
"""Disabled: aiomqtt and paho log what a broker sends, line by line; errors contain the relevant part."""


class Broker(aiomqtt.Client):
    """A connection of MQTT 5. ``will`` is sent by the unit itself before an orderly disconnect.

    aiomqtt 2.5 lacks four things, so this class uses private parts of it. The socket is closed in any case
    (aiomqtt leaves it open if the broker is silent at the end, or sends malformed packets) and never watched
    from two threads. Received data is limited, and the broker's refusal of a message is reported. aiomqtt's
    timeouts are not used: Python 3.11's ``wait_for`` loses a cancellation that comes with an acknowledgement.
    """

    def __init__(
        self,
        settings: MqttSettings,
        identifier: str,
        will: aiomqtt.Will,
        login: Login = None,
        tls: ssl.SSLContext | None = None,
        limits: Limits | None = None,
    ) -> None:
        """``limits`` receives what the broker accepts."""
        user, password = login or (None, None)
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = MAX_PACKET_BYTES
        properties.ReceiveMaximum = MAX_UNACKNOWLEDGED
        super().__init__(
            settings.host,
            settings.port_or_default,
            identifier=identifier,
            username=user,
            password=password,
            protocol=aiomqtt.ProtocolVersion.V5,
            will=will,
            keepalive=KEEP_ALIVE_S,
            tls_context=tls,
            properties=properties,
            socket_options=[
                (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            ],  # a ping must not wait for a TCP acknowledgement
            timeout=math.inf,
            logger=_log,
        )
        self._will = will
        self.connecting = SingleCall("mqtt connect")
        """Makes the calls that resolve the broker's name and connect, which may hang."""
        self.limits = limits or Limits()
        self._free = asyncio.Semaphore(MAX_UNACKNOWLEDGED)
        self._answered = asyncio.Event()
        self._pinging = asyncio.Lock()
        self._is_left = False
        self.has_sent_connect = False
        """Whether CONNECT was sent to a server, whatever followed."""
        self._watched: socket.socket | None = None
        self._sent = 0
        self._topic = ""
        self._take: Callable[[bytes, bool], None] = lambda payload, is_retained: None

    async def __aenter__(self) -> Self:
        """Connect; raises BrokerError."""
        lost = self._disconnected
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                await self.connecting.call(self._connect)
                await super().__aenter__()
        except TimeoutError as error:
            self._close()
            raise BrokerError(f"no answer within {CONNECT_TIMEOUT_S:g} s") from error
        except (OSError, aiomqtt.MqttError) as error:
            self._close()
            raise BrokerError(why_refused(error)) from error
        except BaseException:
            self._close()  # the connecting thread cannot be stopped: _watch closes its socket
            raise
        if lost.done():  # aiomqtt forgets a connection that was lost right after CONNACK
            self._disconnected = lost
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Send the will and disconnect. If that is not acknowledged, disconnect; the broker then sends it."""
        try:
            if self._sent and not self._disconnected.done():
                async with asyncio.timeout(GOODBYE_TIMEOUT_S):
                    await self._leave()
        except (TimeoutError, aiomqtt.MqttError):
            pass
        finally:
            self._close()

    async def _leave(self) -> None:
        will = self._will
        qos, retain = min(will.qos, self.limits.max_qos), will.retain and self.limits.has_retain
        await self.publish(will.topic, will.payload, qos, retain)
        await super().__aexit__(None, None, None)

    async def send(self, topic: str, payload: str, *, expiry_s: int | None, retain: bool = False) -> None:
        """Publish with QoS 1 and wait for the acknowledgement; raises BrokerError.

        The broker discards a message that it has stored for ``expiry_s``; None: never. A broker without QoS 1
        acknowledges a ping instead. Raises MessageTooLongError for a message above the broker's limit.
        """
        qos, encoded = self.limits.max_qos, payload.encode()
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if expiry_s is not None:
            properties.MessageExpiryInterval = expiry_s
        self.limits.check(topic, encoded, qos, properties)
        async with self._free, self._acknowledged():
            await self.publish(topic, encoded, qos, retain and self.limits.has_retain, properties)
            if not qos:
                await self._ping()

    async def _ping(self) -> None:
        """Ping the broker and wait: it reads in order, so its answer confirms everything sent before.

        Without this, a broker that stops reading would receive old numbers when it continues: QoS 0 has no
        acknowledgement.
        """
        async with self._pinging:
            self._answered.clear()
            self._client._send_pingreq()  # noqa: SLF001  paho sends no ping on request
            await self._answered.wait()

    @property
    def own_address(self) -> str:
        """The unit's IP address on this connection; empty: there is none."""
        return "" if self._watched is None else str(self._watched.getsockname()[0])

    async def subscribe_to(
        self, topic: str, take: Callable[[bytes, bool], None], with_retained: bool = False
    ) -> None:
        """Pass each message on ``topic``, and whether it is retained, to ``take``; raises BrokerError.

        ``with_retained``: the broker sends its retained message first, and only that one is marked.
        """
        self._topic, self._take = topic, take
        handling = SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
        if not with_retained:
            handling = SubscribeOptions.RETAIN_DO_NOT_SEND
        options = SubscribeOptions(1, retainAsPublished=not with_retained, retainHandling=handling)
        async with self._acknowledged():
            granted = [str(code) for code in await self.subscribe(topic, options=options)]
        if granted != ["Granted QoS 1"]:
            raise BrokerError(f"the broker refuses the subscription of {topic}: {', '.join(granted)}")

    @contextlib.asynccontextmanager
    async def _acknowledged(self) -> AsyncIterator[None]:
        """Limit the time until the broker acknowledges what is sent; raises BrokerError."""
        self._sent += 1
        try:
            async with asyncio.timeout(ACK_TIMEOUT_S):
                yield
        except TimeoutError as error:
            text = f"the broker has not acknowledged a message for {ACK_TIMEOUT_S:g} s"
            raise BrokerError(text) from error
        except aiomqtt.MqttError as error:
            raise BrokerError(str(error.__cause__ or error)) from error

    async def lost(self) -> None:
        """Wait until the connection is lost, then raise BrokerError."""
        await asyncio.shield(self._disconnected)

    def _close(self) -> None:
        """Remove everything of this connection from the event loop."""
        self._is_left = True
        if self._watched is not None:
            self._client.reinitialise()  # the only public call that closes at once
        for state in (self._connected, self._disconnected):
            if state.done() and not state.cancelled():
                state.exception()  # otherwise asyncio logs that it was never retrieved

    def _fail(self, error: Exception) -> None:
        for state in (self._connected, self._disconnected):
            if not (state.done() or self._is_left):
                state.set_exception(error)
                return

    def _connect(self) -> None:
        """Connect, in a thread; after that only the event loop uses the socket."""
        super()._client_connect()
        self.has_sent_connect = True
        self._loop.call_soon_threadsafe(self._watch)

    def _client_connect(self) -> None:
        """Do nothing: aiomqtt would connect in asyncio's pool, where calls that hang stop all others."""

    def _watch(self) -> None:
        sock = self._client.socket()
        if self._is_left:
            self._client.reinitialise()
        elif isinstance(sock, socket.socket):
            self._watched = sock
            self._loop.add_reader(sock.fileno(), self._read, sock)
            if self._client.want_write():
                self._loop.add_writer(sock.fileno(), self._client.loop_write)
            self._misc_task = self._loop.create_task(self._misc_loop())

    def _on_socket_open(self, client: PahoClient, userdata: Any, sock: Any) -> None:
        pass

    def _on_socket_register_write(self, client: PahoClient, userdata: Any, sock: Any) -> None:
        if self._watched is not None and sock is self._watched:
            self._loop.add_writer(sock.fileno(), self._client.loop_write)

    def _on_socket_unregister_write(self, client: PahoClient, userdata: Any, sock: Any) -> None:
        if self._watched is not None and sock is self._watched:
            self._loop.remove_writer(sock.fileno())

    def _on_socket_close(self, client: PahoClient, userdata: Any, sock: Any) -> None:
        if sock is self._watched:
            self._watched = None
            super()._on_socket_close(client, userdata, sock)

    def _read(self, sock: socket.socket) -> None:
        """Read a packet; with TLS, all packets that were decrypted with it."""
        try:
            self._check_received(sock)
            self._client.loop_read()
            while isinstance(sock, ssl.SSLSocket) and sock.fileno() >= 0 and sock.pending():
                self._client.loop_read()
            if self._client._in_messages:  # noqa: SLF001  paho keeps these until the broker releases them
                raise BrokerError("the broker sent a message with QoS 2, and the subscription has QoS 1")
        except BrokerError as error:
            self._stop_reading(sock, error)
        except Exception as error:  # paho raises many exception types for malformed packets
            text = one_line(f"{NO_MQTT} ({type(error).__name__}: {error})")
            self._stop_reading(sock, BrokerError(text))
        if not self._client._ping_t:  # noqa: SLF001  zero: every ping was answered
            self._answered.set()

    def _stop_reading(self, sock: socket.socket, error: BrokerError) -> None:
        if sock.fileno() >= 0:
            self._loop.remove_reader(sock.fileno())
        self._fail(error)

    def _check_received(self, sock: socket.socket) -> None:
        """Raise BrokerError for too much data: paho would keep 256 MB of one packet, and many packets."""
        info = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES)
        received: int = _BYTES_RECEIVED.unpack(info)[0]
        if received > MAX_RECEIVED_BYTES + MAX_RECEIVED_BYTES_PER_MESSAGE * self._sent:
            raise BrokerError("the broker sends more than acknowledgements")

    def _on_connect(
        self,
        client: PahoClient,
        userdata: Any,
        flags: Any,
        reason_code: ReasonCode,
        properties: Properties | None = None,
    ) -> None:
        if self._connected.done():  # a second CONNACK (MQTT 5, 3.2)
            self._fail(BrokerError(NO_MQTT))
            return
        self.limits.take(reason_code, properties)
        self._free = asyncio.Semaphore(getattr(properties, "ReceiveMaximum", MAX_UNACKNOWLEDGED))
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_message(self, client: PahoClient, userdata: Any, message: Any) -> None:
        if message.topic == self._topic:
            self._take(message.payload, message.retain)
        elif self._topic:
            self._fail(BrokerError("the broker sent a message on another topic than that of commands"))
        else:
            self._fail(BrokerError("the broker sent a message, but the unit has no subscription"))

    def _on_publish(
        self, client: PahoClient, userdata: Any, mid: int, reason_code: ReasonCode, properties: Properties
    ) -> None:
        if reason_code.is_failure:
            self._fail(BrokerError(why_not_taken(reason_code)))
        super()._on_publish(client, userdata, mid, reason_code, properties)

    def _on_disconnect(
        self,
        client: PahoClient,
        userdata: Any,
        flags: Any,
        reason_code: ReasonCode,
        properties: Properties | None = None,
    ) -> None:
        is_by_server = flags.is_disconnect_packet_from_server
        if not (is_by_server or reason_code.is_failure):  # ended by the unit
            super()._on_disconnect(client, userdata, flags, reason_code, properties)
            return
        was_connected = self._connected.done() and self._connected.exception() is None
        text = why_ended(reason_code, is_by_server=is_by_server, was_connected=was_connected)
        self._loop.call_soon_threadsafe(self._fail, BrokerError(text))
