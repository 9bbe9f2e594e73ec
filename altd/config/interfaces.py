"""Interfaces: Modbus, HTTP, MQTT, OPC UA, serial ports, and the local socket of the unit."""

from __future__ import annotations

import ipaddress
import re
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from altd.devices.settings import SERIAL, DeviceTable, Driver
from altd.files.table import Device, Table, TcpPort, complaint, shown
from altd.process.addresses import is_unassignable


def _address(host: str) -> str:
    """Check an address to listen on. Other names are refused: a lookup could block the unit for seconds."""
    if host == "localhost":
        return host
    possible = (
        "possible: an IP address of the unit, localhost, 0.0.0.0 for every IPv4 address, :: for IPv6 too"
    )
    try:
        address = ipaddress.ip_address(host)
    except ValueError as error:
        raise complaint(((), f"{shown(host)} is not an IP address; {possible}")) from error
    if why := _refusal(address):
        raise complaint(((), f"{shown(host)} {why}; {possible}"))
    return host


def _refusal(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    """Return the reason why no computer can listen on an address; empty: listening is possible."""
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
    """Return a network as its address and prefix length."""
    possible = "possible: 10.0.0.0/8, 192.168.1.0/24, fd00::/8, a single address"
    try:
        network = ipaddress.ip_network(text)
    except ValueError as error:
        try:
            meant = ipaddress.ip_network(text, strict=False)
        except ValueError:
            raise complaint(((), f"{shown(text)} is not a network; {possible}")) from error
        raise complaint(((), f"{shown(text)} is an address in a network; possible: {meant}")) from error
    if isinstance(network, ipaddress.IPv6Network) and network.network_address.ipv4_mapped is not None:
        raise complaint(((), f"{shown(text)} is IPv4 written as IPv6: write it as IPv4"))
    return str(network)


Network = Annotated[str, AfterValidator(_network)]


Role = Annotated[str, Field(min_length=1, max_length=64)]

WordOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""Order of the four bytes of a 32-bit value in its two registers, A the highest."""


class ModbusTcpSettings(Table):
    """Modbus TCP server."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """IP address to listen on, or localhost; `0.0.0.0`: every IPv4 one, `::`: every one."""
    port: TcpPort | None = None
    """TCP port; default 502, with `certificate` 802. The service may use ports from 502 up (`install.md`)."""
    unit_id: UnitId = 1
    """Modbus unit identifier; requests to 0 and 255 are answered too."""
    word_order: WordOrder = "ABCD"
    """Byte order of 32-bit values, A the highest byte."""
    allow_self_check: bool = False
    """Clients may request a self-check by a write; without TLS any client."""
    allow_zero: bool = False
    """Clients may set the zero of the relative values by a write; without TLS any client."""
    reserved: Annotated[tuple[Network, ...], Field(max_length=64)] = ()
    """Networks of controllers, `["192.168.1.10"]`: they connect also while others flood the port."""
    certificate: Path | None = None
    """The unit's certificate chain, PEM; with it, only TLS is served. Needs `key` and `client_ca`."""
    key: Path | None = None
    """Private key of the certificate, PEM, without a passphrase."""
    client_ca: Path | None = None
    """Authorities of clients' certificates, PEM."""
    roles: Annotated[tuple[Role, ...], Field(max_length=16)] = ()
    """With TLS: roles in clients' certificates that may write."""

    @property
    def port_or_default(self) -> int:
        """Port of the server."""
        if self.port is not None:
            return self.port
        return 502 if self.certificate is None else 802


_LABEL = r"[0-9a-z_]([0-9a-z_-]{0,61}[0-9a-z_])?"
_HOST_NAME = re.compile(rf"(?=.{{1,253}}$){_LABEL}(\.{_LABEL})*", re.IGNORECASE | re.ASCII)
"""Host name by RFC 1123, 2.1, plus the underscore, which plants use in such names."""


def _host_name(text: str) -> str:
    if not _HOST_NAME.fullmatch(text):
        possible = "one such as alt-0007.plant, without scheme and port"
        raise complaint(((), f"{shown(text)} is not a host name; possible: {possible}"))
    return text


HostName = Annotated[str, AfterValidator(_host_name)]


class HttpSettings(Table):
    """HTTP server: the unit's page, its API and a stream."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its controller's network
    """IP address to listen on, or localhost, as in `[modbus_tcp]`."""
    port: TcpPort = 8080
    """TCP port."""
    allow: Annotated[tuple[Network, ...], Field(max_length=64)] = ()
    """Networks that may connect, `["10.0.0.0/8"]`; empty: all. The unit's own computer always may."""
    names: Annotated[tuple[HostName, ...], Field(max_length=64)] = ()
    """Names of the unit in URLs, `["alt-0007.plant.example"]`, besides its addresses, `localhost` and the
    computer's name."""
    credentials: Path | None = None
    """File of users and tokens (`altd password`, `altd token`). Without it, only the unit's own computer may
    send commands."""
    certificate: Path | None = None
    """The certificate chain, PEM; with it, only TLS is served. Needs `key`."""
    key: Path | None = None
    """Private key of the certificate, PEM, without a passphrase."""


def _broker(host: str) -> str:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return _host_name(host)
    return host


BrokerHost = Annotated[str, AfterValidator(_broker)]


_TOPIC = re.compile(r"[^+#/]+(/[^+#/]+)*")
"""Levels of a topic without wildcards (MQTT 5, 4.7)."""


def _topic(text: str) -> str:
    if not _TOPIC.fullmatch(text) or not text.isprintable() or text.startswith("$"):
        possible = (
            "possible: letters, digits and other characters except + and #, / between levels, no $ first"
        )
        raise complaint(((), f"{shown(text)} is not a topic prefix; {possible}"))
    return text


Topic = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_topic)]


def _sparkplug_identifier(text: str) -> str:
    """Check an identifier (Sparkplug 3.0, 4.1.2)."""
    if not _TOPIC.fullmatch(text) or not text.isprintable() or "/" in text:
        possible = "possible: letters, digits and other characters except + / #"
        raise complaint(((), f"{shown(text)} is not an identifier; {possible}"))
    return text


SparkplugIdentifier = Annotated[
    str, Field(min_length=1, max_length=100), AfterValidator(_sparkplug_identifier)
]


class SparkplugSettings(Table):
    """The unit as an edge node of Sparkplug B 3.0, instead of JSON."""

    group: SparkplugIdentifier
    """Group identifier."""
    node: SparkplugIdentifier | None = None
    """Edge node identifier; default: the serial number."""


class BrokerSettings(Table):
    """Keys of a connection to an MQTT 5 broker."""

    host: BrokerHost
    """Name or IP address of the broker, as in its certificate."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """TCP port; default 1883, with `ca` 8883."""
    topic: Topic = "altd"
    """First part of the topics: `altd/ALT-0007/summary`."""
    ca: Path | None = None
    """Authorities of the broker's certificate, PEM; with it, only TLS is used."""
    certificate: Path | None = None
    """The client's certificate chain, PEM, if the broker requires one. Needs `key` and `ca`."""
    key: Path | None = None
    """Private key of the certificate, PEM, without a passphrase."""
    credentials: Path | None = None
    """File with the user name in line 1 and the password in line 2, readable by its owner and group only."""

    @property
    def port_or_default(self) -> int:
        """Port to connect to."""
        return self.port or (1883 if self.ca is None else 8883)


class MqttSettings(BrokerSettings):
    """Publishes to an MQTT 5 broker."""

    every_measurement: bool = False
    """Publish every measurement, not only the summary of each second."""
    store_and_forward: bool = False
    """Keep the summaries of 1 s until an ingest has acknowledged them: `fleet.md`. Needs the history."""
    home_assistant: Topic | None = None
    """Discovery prefix of Home Assistant, usually `homeassistant`; announces the unit."""
    sparkplug: SparkplugSettings | None = None
    """Sparkplug B, a separate table (below)."""


class OpcUaSettings(Table):
    """OPC UA server. Needs the extra `altd[opcua]`."""

    host: Host = "0.0.0.0"  # noqa: S104  a unit serves its plant's network
    """IP address to listen on, or localhost, as in `[modbus_tcp]`."""
    port: TcpPort = 4840
    """TCP port."""
    certificate: Path | None = None
    """The unit's certificate, PEM; with it, clients must sign, or sign and encrypt. Needs `key`."""
    key: Path | None = None
    """Private RSA key of the certificate, PEM, without a passphrase."""
    credentials: Path | None = None
    """File of users as in `[http]`; with it, clients must log in. Needs `certificate`."""
    allow_self_check: bool = False
    """Clients may call the method `SelfCheck`; without `credentials` any client."""


class Rs485Settings(Table):
    """The kernel's RS485 mode: the port switches its transceiver by RTS.

    Not for adapters that switch automatically.
    """

    rts_while_sending: Literal["high", "low"] = "high"
    """Level of RTS while sending."""
    delay_before_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from switching to the first bit, ms."""
    delay_after_ms: Annotated[int, Field(ge=0, le=100)] = 0
    """Time from the last bit to switching back, ms."""


class SerialPortSettings(DeviceTable):
    """Keys of all serial ports."""

    about: ClassVar[Driver | None] = SERIAL

    device: Device
    """Device path, preferably a stable one such as /dev/serial/by-id/…."""
    baud: Literal[1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400] = 9600
    """Bits per second."""
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    rs485: Rs485Settings | None = None
    """RS485 mode, a separate table (below); without it RS232."""


class TelegramPortSettings(SerialPortSettings):
    """A serial port that sends telegrams."""

    speaks: Literal["telegram"]
    interval_s: Annotated[float, Field(ge=0.05, le=3600)] = 1.0
    """Time between telegrams, s; with ``on_request`` the shortest."""
    on_request: bool = False
    """Send only when the line `?` is received."""
    checked: bool = False
    """Send a last sentence for checks (`proof.md`)."""
    sigma_now: bool = False
    """Send a sentence with `sigma_now` of a beam, the uncertainty at sending."""
    identify_every_s: Annotated[float, Field(ge=1, le=86400)] | None = None
    """Interval of `$PALTI`, s: serial number, versions and date."""


class ConsolePortSettings(SerialPortSettings):
    """A serial port with a console for a technician."""

    speaks: Literal["console"]


class ModbusRtuPortSettings(SerialPortSettings):
    """A serial port that serves Modbus RTU."""

    speaks: Literal["modbus_rtu"]
    unit_id: UnitId = 1
    """Modbus unit identifier."""
    word_order: WordOrder = "ABCD"
    """Byte order of 32-bit values, as in `[modbus_tcp]`."""
    allow_self_check: bool = False
    """Clients may request a self-check by a write, as in `[modbus_tcp]`."""
    allow_zero: bool = False
    """Clients may set the zero of the relative values by a write, as in `[modbus_tcp]`."""


AnySerialPortSettings = Annotated[
    TelegramPortSettings | ConsolePortSettings | ModbusRtuPortSettings, Field(discriminator="speaks")
]


MAX_SOCKET_BYTES = 107
"""Maximum length of a socket's path: 108 bytes minus the terminating one (unix(7))."""


def _socket(path: Path) -> Path:
    if not path.is_absolute() or not str(path).isprintable():
        raise complaint(
            ((), f"{shown(str(path))} is not an absolute path; possible: one such as /run/altd/altd.sock")
        )
    if (size := len(str(path).encode())) > MAX_SOCKET_BYTES:
        raise complaint(((), f"{size} bytes are too long for a socket; possible: up to {MAX_SOCKET_BYTES}"))
    return path


class LocalSettings(Table):
    """The socket of `altd status`, `altd watch` and `altd selfcheck`."""

    socket: Annotated[Path, AfterValidator(_socket)] = Path("/run/altd/altd.sock")
    """Path of the socket; its folder must exist."""
