"""Checks of the network: addresses that altd listens on, and the MQTT broker."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterator

from altd.config import Config, HttpSettings, ModbusTcpSettings
from altd.process.machine import Finding, Machine, Verdict
from altd.process.port_owner import bytes_of, listening_sockets, owner_of_socket

_CONNECT_TIMEOUT_S = 2.0


def listening(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check the ports of interfaces: whether altd may use them, and whether another program does."""
    for subject, host, port in _ports(config):
        refused = [*_low_port(subject, port, machine), *_missing_address(subject, host, machine)]
        yield from refused
        if (taken := _taken(subject, host, port, machine)) is not None:
            yield taken
        elif not refused:
            yield Finding.good(subject, "the address is free")
    if config.http is not None:
        yield from _openness(config.http)


def taken_ports(config: Config, machine: Machine) -> Iterator[Finding]:
    """Yield an error for each port of an interface on which a program other than altd listens."""
    found = (_taken(*place, machine) for place in _ports(config))
    yield from (each for each in found if each is not None and each.verdict is Verdict.ERROR)


def _ports(config: Config) -> Iterator[tuple[str, str, int]]:
    """Yield subject, host and port of each interface with a fixed port."""
    for name in ("modbus_tcp", "http", "opcua"):
        if (table := getattr(config, name)) is not None:
            port = table.port_or_default if isinstance(table, ModbusTcpSettings) else table.port
            if port != 0:
                yield f"{name} {table.host}:{port}", table.host, port


def _taken(subject: str, host: str, port: int, machine: Machine) -> Finding | None:
    """Return the finding about a program that listens there; None: none does."""
    taken = next(listening_sockets(host, port, machine.root), None)
    if taken is None:
        return None
    owner = owner_of_socket(taken, machine.root)
    if owner is not None and owner[1] == "altd":
        return Finding.good(subject, f"altd listens there (process {owner[0]})")
    remedy = f"sudo ss -ltnp 'sport = :{port}'"
    if owner is None:
        return Finding.warning(subject, "another user's program listens there: altd itself?", remedy)
    return Finding.error(subject, f"{owner[1]} (process {owner[0]}) listens there", remedy)


def broker(config: Config) -> Iterator[Finding]:
    """Check whether the broker of ``[mqtt]`` accepts connections from here; login and TLS are not tried."""
    if (mqtt := config.mqtt) is None:
        return
    port = mqtt.port_or_default
    subject = f"mqtt {mqtt.host}:{port}"
    try:
        with socket.create_connection((mqtt.host, port), _CONNECT_TIMEOUT_S):
            yield Finding.good(subject, "accepts connections")
    except OSError as error:
        text = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
        remedy = "docs/mqtt.md   # [mqtt] host, port; is the broker running, does a firewall refuse?"
        yield Finding.error(subject, f"the broker cannot be reached: {text}", remedy)


def _openness(http: HttpSettings) -> Iterator[Finding]:
    """Advise on missing restrictions; this is no fault, as in a network of its own a unit may be open."""
    address = ipaddress.ip_address("127.0.0.1" if http.host == "localhost" else http.host)
    if address.is_loopback:
        return
    wanted = {"allow": http.allow, "credentials": http.credentials, "TLS": http.certificate}
    lacking = [name for name, value in wanted.items() if not value]
    subject = f"http {http.host}:{http.port}"
    if "allow" in lacking:
        text = f"any computer here can read this page (no {', no '.join(lacking)})"
        text += ": acceptable only on a private network"
        yield Finding.warning(subject, text, "docs/http.md   # [http] allow, credentials, certificate")
    elif "TLS" in lacking and "credentials" not in lacking:
        text = "passwords and tokens are sent unencrypted, without TLS"
        yield Finding.warning(subject, text, "docs/http.md   # [http] certificate and key")


def _low_port(subject: str, port: int, machine: Machine) -> Iterator[Finding]:
    first = machine.number("/proc/sys/net/ipv4/ip_unprivileged_port_start")
    if port >= (1024 if first is None else first):
        return
    service = machine.service()
    if service is not None:
        if not service.low_ports:
            remedy = f"sudo sysctl net.ipv4.ip_unprivileged_port_start={port}   # and in /etc/sysctl.d"
            yield Finding.error(
                subject, f"the service may not listen on a port below {first or 1024}", remedy
            )
    elif machine.account.uid != 0:
        remedy = "docs/install.md   # run it as the service, which may; or choose a port from 1024 on"
        yield Finding.error(subject, f"{machine.account.name} may not listen on a port below 1024", remedy)


def _missing_address(subject: str, host: str, machine: Machine) -> Iterator[Finding]:
    """Check if an interface has the address; altd waits for a missing one, as it must during booting."""
    wanted = bytes_of(host)
    if host == "localhost" or not any(wanted) or ipaddress.ip_address(wanted).is_loopback:
        return
    ours = _addresses(machine)
    if ours and wanted not in ours:
        known = (ipaddress.ip_address(address) for address in sorted(ours))
        there = (
            ", ".join(str(address) for address in known if not address.is_loopback)
            or "only loopback addresses"
        )
        remedy = "ip -brief address   # use one of these in the settings, or 0.0.0.0 for all of them"
        yield Finding.error(subject, f"no interface of this computer has the address; it has {there}", remedy)


def _addresses(machine: Machine) -> set[bytes]:
    """The computer's own addresses; empty if the kernel does not report them."""
    ours: set[bytes] = set()
    address = ""
    for line in machine.text("/proc/net/fib_trie").splitlines():
        words = line.split()
        if len(words) >= 2 and words[0] == "|--":
            address = words[1]
        elif words[-2:] == ["host", "LOCAL"]:
            ours.add(socket.inet_pton(socket.AF_INET, address))
    for line in machine.text("/proc/net/if_inet6").splitlines():
        ours.add(bytes.fromhex(line.split()[0]))
    return ours
