"""The interfaces: Modbus, HTTP, MQTT, OPC UA, serial ports, and the local socket of the unit."""

from __future__ import annotations

import ipaddress
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from altd.config.addresses import is_unassignable
from altd.config.table import Device, Table, TcpPort, complaint, shown


def _address(host: str) -> str:
    """An address to listen on. No other name: to look it up could hold the unit up for seconds."""
    if host == "localhost":
        return host
    possible = (
        "possible: an IP address of the unit, localhost, 0.0.0.0 for every address, :: for every IPv6 one"
    )
    try:
        address = ipaddress.ip_address(host)
    except ValueError as error:
        raise complaint(((), f"{shown(host)} is no IP address; {possible}")) from error
    if why := _refusal(address):
        raise complaint(((), f"{shown(host)} {why}; {possible}"))
    return host


def _refusal(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    """Why no computer can listen on an address; empty: one may."""
    if address.is_multicast:
        return "is an address of groups, which no client can connect to"
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return f"is IPv4 written as IPv6: write {address.ipv4_mapped}"
        if address.is_link_local and not address.scope_id:
            return "is an address of one wire only: name its interface, as in fe80::1%eth0"
        return ""
    return "is an address that no computer has" if is_unassignable(address) else ""


Host = Annotated[str, AfterValidator(_address)]
UnitId = Annotated[int, Field(ge=1, le=247)]


def _network(text: str) -> str:
    """A network, as its address and the length of its prefix."""
    possible = "possible: 10.0.0.0/8, 192.168.1.0/24, fd00::/8, a single address"
    try:
        network = ipaddress.ip_network(text)
    except ValueError as error:
        try:
            meant = ipaddress.ip_network(text, strict=False)
        except ValueError:
            raise complaint(((), f"{shown(text)} is no network; {possible}")) from error
        raise complaint(((), f"{shown(text)} is an address in a network; possible: {meant}")) from error
    if isinstance(network, ipaddress.IPv6Network) and network.network_address.ipv4_mapped is not None:
        raise complaint(((), f"{shown(text)} is IPv4 written as IPv6: write it as IPv4"))
    return str(network)


Network = Annotated[str, AfterValidator(_network)]


Role = Annotated[str, Field(min_length=1, max_length=64)]

WordOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""The order of the four bytes of a 32-bit value in its two registers, A the highest."""


class ModbusTcpSettings(Table):
    """Modbus TCP server."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The IP address to listen on, or localhost; 0.0.0.0 is every address of the unit, :: every IPv6 one."""
    port: TcpPort | None = None
    """TCP port; without it 802 with `certificate`, else 502.

    Below 1024 the daemon needs CAP_NET_BIND_SERVICE, which the systemd unit grants.
    """
    unit_id: UnitId = 1
    """Modbus unit identifier; 0 and 255 are answered too."""
    word_order: WordOrder = "ABCD"
    """Bytes of a 32-bit value in its two registers, A the highest; 16-bit values and text do not change."""
    allow_self_check: bool = False
    """Let clients ask for a self-check by a write (`modbus.md`): without TLS, any client on the network."""
    allow_zero: bool = False
    """Let clients set the zero of the relative values by a write (`modbus.md`): without TLS, any client."""
    reserved: Annotated[tuple[Network, ...], Field(max_length=64)] = ()
    """Addresses or networks of controllers, as in `["192.168.1.10"]`: they always get a connection.

    Clients from elsewhere never close one of theirs (`modbus.md`).
    """
    certificate: Path | None = None
    """The unit's certificate chain, PEM: only TLS is spoken with it. With `key` and `client_ca`."""
    key: Path | None = None
    """The certificate's private key, PEM, without a passphrase."""
    client_ca: Path | None = None
    """The certificates of the authorities that vouch for clients, PEM; a client without one is refused."""
    roles: Annotated[tuple[Role, ...], Field(max_length=16)] = ()
    """With TLS: roles in clients' certificates that may do what `allow_self_check` and `allow_zero` allow."""

    @property
    def port_or_default(self) -> int:
        """The port that is served."""
        if self.port is not None:
            return self.port
        return 502 if self.certificate is None else 802


_LABEL = r"[0-9a-z_]([0-9a-z_-]{0,61}[0-9a-z_])?"
_HOST_NAME = re.compile(rf"(?=.{{1,253}}$){_LABEL}(\.{_LABEL})*", re.IGNORECASE | re.ASCII)
"""RFC 1123, 2.1, and the underscore that plants have in such names."""


def _host_name(text: str) -> str:
    if not _HOST_NAME.fullmatch(text):
        possible = "one such as alt-0007.plant, without scheme and port"
        raise complaint(((), f"{shown(text)} is no name of a computer; possible: {possible}"))
    return text


HostName = Annotated[str, AfterValidator(_host_name)]


class HttpSettings(Table):
    """HTTP server: the unit's page, its API and a stream."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """The IP address to listen on, or localhost; 0.0.0.0 is every address of the unit, :: every IPv6 one."""
    port: TcpPort = 8080
    """TCP port."""
    allow: Annotated[tuple[Network, ...], Field(max_length=64)] = ()
    """Networks that may connect, as in `["10.0.0.0/8"]`; none: everybody whom the service lets in.

    The unit's own computer always may.
    """
    names: Annotated[tuple[HostName, ...], Field(max_length=64)] = ()
    """Names by which browsers and programs ask for the unit, as in `["alt-0007.plant.example"]`.

    Its addresses, `localhost`, and the computer's own name, alone or with `.local`, need not be named. By any
    other name it answers nothing, but for `/healthz`. With TLS the certificate's names count instead.
    """
    credentials: Path | None = None
    """A file of names with hashes of passwords and tokens, made by `altd password` and `altd token`.

    Without it only the unit's own computer may act: ask for a self-check, keep frames, mark a recording.
    """
    certificate: Path | None = None
    """The certificate chain, PEM: from then on TLS alone is spoken. With `key`."""
    key: Path | None = None
    """The certificate's private key, PEM, without a passphrase."""


def _broker(host: str) -> str:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return _host_name(host)
    return host


_TOPIC = re.compile(r"[A-Za-z0-9_.:-]+(/[A-Za-z0-9_.:-]+)*", re.ASCII)


def _topic(text: str) -> str:
    if not _TOPIC.fullmatch(text):
        possible = "possible: letters, digits and _ . : -, and / between levels"
        raise complaint(((), f"{shown(text)} is no beginning of topics; {possible}"))
    return text


Topic = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_topic)]


def _sparkplug_identifier(text: str) -> str:
    if not _TOPIC.fullmatch(text) or "/" in text:
        raise complaint(((), f"{shown(text)} is no identifier; possible: letters, digits and _ . : -"))
    return text


SparkplugIdentifier = Annotated[
    str, Field(min_length=1, max_length=100), AfterValidator(_sparkplug_identifier)
]


class SparkplugSettings(Table):
    """The unit as an edge node of Sparkplug B 3.0, in place of the topics in JSON."""

    group: SparkplugIdentifier
    """The group identifier."""
    node: SparkplugIdentifier | None = None
    """The edge node identifier; without it the serial number."""


class MqttSettings(Table):
    """Publishes to an MQTT 5 broker; except for the rebirth of Sparkplug the unit takes no command."""

    host: Annotated[str, AfterValidator(_broker)]
    """The broker's name or IP address; with TLS its certificate must have it."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """TCP port; without it 8883 with `ca`, else 1883."""
    topic: Topic = "altd"
    """What the unit's topics begin with; its serial number follows: `altd/ALT-0007/summary`."""
    every_measurement: bool = False
    """Publish every measurement beside the summary of each second."""
    home_assistant: Topic | None = None
    """Announce the unit to Home Assistant; the value is its discovery prefix, usually `homeassistant`."""
    sparkplug: SparkplugSettings | None = None
    """A table of its own, see below; without it the unit publishes in JSON."""
    ca: Path | None = None
    """The certificates of the authorities that may vouch for the broker, PEM: TLS alone is spoken with it."""
    certificate: Path | None = None
    """The unit's own certificate chain, PEM, where the broker asks for one. With `key` and `ca`."""
    key: Path | None = None
    """The certificate's private key, PEM, without a passphrase."""
    credentials: Path | None = None
    """A file with the user name in its first line and the password in its second, for its owner alone."""

    @property
    def port_or_default(self) -> int:
        """The port that is connected to."""
        return self.port or (1883 if self.ca is None else 8883)


class OpcUaSettings(Table):
    """OPC UA server. Needs the package `asyncua`: `pip install 'altd[opcua]'`."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its plant's network
    """The IP address to listen on, or localhost; 0.0.0.0 is every address of the unit, :: every IPv6 one."""
    port: TcpPort = 4840
    """TCP port."""
    certificate: Path | None = None
    """The unit's certificate, PEM: clients must then sign, or sign and encrypt. With `key`."""
    key: Path | None = None
    """The certificate's private RSA key, PEM, without a passphrase."""
    credentials: Path | None = None
    """A file as in `[http]`: clients log in with a name and its password. Needs `certificate`."""
    allow_self_check: bool = False
    """Let clients call the method `SelfCheck`; without `credentials` everybody on the network can."""


class Rs485Settings(Table):
    """The kernel's RS485 mode: the port switches the direction of its transceiver with RTS.

    For a port that the kernel can do this with; an adapter that switches automatically needs none of it.
    """

    rts_while_sending: Literal["high", "low"] = "high"
    """The level of RTS while the unit sends."""
    delay_before_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from switching to sending until the first bit."""
    delay_after_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from the last bit until switching back."""


class SerialPortSettings(Table):
    """What every serial port has, whatever it speaks."""

    device: Device
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    baud: Literal[1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400] = 9600
    """Bits per second."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    rs485: Rs485Settings | None = None
    """A table of its own, see below; without it the port is RS232, or an adapter does the rest."""


class TelegramPortSettings(SerialPortSettings):
    """A serial port that sends the measurement as a telegram, at an interval or on request."""

    speaks: Literal["telegram"]
    interval_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Time from one telegram to the next; the shortest one when they are sent on request."""
    on_request: bool = False
    """Send a telegram only when the line `?` is received."""
    checked: bool = False
    """Whether a third sentence lets the reader check the telegram: see `proof.md`."""
    identify_every_s: Annotated[float, Field(ge=1, le=86400)] | None = None
    """Time after which a telegram ends with `$PALTI`: serial number, versions and date. Without it: never."""


class ConsolePortSettings(SerialPortSettings):
    """A serial port with a console for a technician."""

    speaks: Literal["console"]


class ModbusRtuPortSettings(SerialPortSettings):
    """A serial port that serves Modbus RTU."""

    speaks: Literal["modbus_rtu"]
    unit_id: UnitId = 1
    """Modbus unit identifier; requests to another one are not answered."""
    word_order: WordOrder = "ABCD"
    """As in `[modbus_tcp]`."""
    allow_self_check: bool = False
    """Let the controller ask for a self-check by a write (`modbus.md`)."""
    allow_zero: bool = False
    """Let the controller set the zero of the relative values by a write (`modbus.md`)."""


AnySerialPortSettings = Annotated[
    TelegramPortSettings | ConsolePortSettings | ModbusRtuPortSettings, Field(discriminator="speaks")
]


MAX_SOCKET_BYTES = 107
"""Of a socket's path: 108 with the byte that ends it (unix(7))."""


def _socket(path: Path) -> Path:
    if not path.is_absolute() or not str(path).isprintable():
        raise complaint(
            ((), f"{shown(str(path))} is no path from the root; possible: one such as /run/altd/altd.sock")
        )
    if (size := len(str(path).encode())) > MAX_SOCKET_BYTES:
        raise complaint(((), f"{size} bytes are too long for a socket; possible: up to {MAX_SOCKET_BYTES}"))
    return path


class LocalSettings(Table):
    """The socket of `altd status`, `altd watch` and `altd selfcheck`, a file that says who may ask."""

    socket: Annotated[Path, AfterValidator(_socket)] = Path("/run/altd/altd.sock")
    """Its path; the folder must be there."""
