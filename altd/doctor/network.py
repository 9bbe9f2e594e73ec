"""Checks of the network: cameras and routes to them, addresses that altd listens on, the MQTT broker."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path

from altd.config import AravisCameraSettings, Config, HttpSettings, ModbusTcpSettings
from altd.devices.aravis import gvcp
from altd.devices.aravis.gvcp import is_address
from altd.doctor.finding import Finding, Verdict
from altd.doctor.machine import Machine
from altd.process.port_owner import bytes_of, from_kernel, listening_sockets, owner_of_socket

MIN_MBIT_S = 1000
MIN_JUMBO_BYTES = 8000
"""Packet size from which a frame's packets no longer cost a noticeable part of a core."""

FRAMES_BUFFERED = 2
_ANSWER_TIMEOUT_S = 0.25
_MAX_TRIES = 2
_DISCOVERY_TIMEOUT_S = 0.5
_CONNECT_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class _Route:
    interface: str
    network: ipaddress.IPv4Network
    direct: bool
    metric: int


def gige_cameras(config: Config, machine: Machine) -> Iterator[Finding]:
    """Check cameras of driver "aravis" and their interfaces; a camera with a name may be on any of them."""
    cameras = {
        name: camera for name, camera in config.cameras.items() if isinstance(camera, AravisCameraSettings)
    }
    interfaces: dict[str, int] = {}
    for name, camera in cameras.items():
        try:
            address = ipaddress.IPv4Address(camera.device)
        except ValueError:
            reached = _wired(machine)
            if not reached:
                yield Finding.error(f"camera {name}", "no network interface is up", "ip -brief link")
        else:
            reached = yield from _way(f"camera {name} {address}", address, machine)
        yield from _answer(f"camera {name} {camera.device}", str(camera.device), machine)
        for interface in reached:
            interfaces[interface] = max(interfaces.get(interface, 0), camera.packet_bytes)
    for interface, packet_bytes in interfaces.items():
        yield from _interface(interface, packet_bytes, machine)
    if cameras:
        frame_bytes = max(
            camera.width * camera.height * (1 if camera.pixel_format == "Mono8" else 2)
            for camera in cameras.values()
        )
        yield from _receive_buffer(frame_bytes, machine)
        yield from _source_check(machine)


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
        open_to = f"any computer that reaches it can read it without {', '.join(lacking)}"
        text = f"{open_to}: acceptable in a network of its own"
        yield Finding.warning(subject, text, "docs/http.md   # [http] allow, credentials, certificate")
    elif "TLS" in lacking and "credentials" not in lacking:
        text = "passwords and tokens are sent unencrypted, without TLS"
        yield Finding.warning(subject, text, "docs/http.md   # [http] certificate and key")


def _answer(subject: str, device: str, machine: Machine) -> Iterator[Finding]:
    """Check the answers of the camera itself, without disturbing it."""
    if is_address(device):
        tries = (gvcp.discover_at(device, _ANSWER_TIMEOUT_S) for _ in range(_MAX_TRIES))
        there = [camera for camera in tries if camera is not None][:1]
    else:
        found = gvcp.discover(_DISCOVERY_TIMEOUT_S)
        there = [camera for camera in found if camera.has_name(device)]
    if len(there) != 1:
        text = f"{len(there)} cameras have this name" if there else "no GigE Vision camera answers"
        remedy = "check its supply and cable; altd devices   # lists the cameras that answer"
        yield Finding.error(subject, text, remedy)
        return
    (camera,) = there
    about = f"{camera.vendor} {camera.model} at {camera.address} answers"
    privilege = gvcp.control_privilege(camera.address, _ANSWER_TIMEOUT_S)
    if privilege is None:
        yield Finding.error(
            subject, f"{about}, but its registers cannot be read", "switch the camera off and on again"
        )
    elif privilege == 0 or machine.runs_daemon():
        yield Finding.good(subject, f"{about}; in use by altd" if privilege else about)
    else:
        yield Finding.error(
            subject, f"{about}; in use by another program", "end that program, on whichever computer it runs"
        )


def _way(
    subject: str, address: ipaddress.IPv4Address, machine: Machine
) -> Generator[Finding, None, list[str]]:
    """Yield findings; return the interfaces that lead to the address."""
    routes = [route for route in _routes(machine) if address in route.network]
    direct = list(
        dict.fromkeys(
            route.interface
            for route in routes
            if route.direct and route.network.prefixlen == routes[0].network.prefixlen
        )
    )
    if address.is_loopback:
        yield Finding.good(subject, "is on this computer")
        return []
    if not direct:
        over = f"packets for it go to the gateway at {routes[0].interface}" if routes else "no route to it"
        remedy = (
            f"sudo ip address add {_neighbour(address)}/24 dev INTERFACE   # and permanently in its settings"
        )
        yield Finding.error(subject, f"no interface has an address in its network: {over}", remedy)
        return []
    if len(direct) > 1:
        strict = [name for name in direct if _filters(name, machine)]
        remedy = f"ip -brief address show dev {direct[1]}   # give each interface a network of its own"
        drops = f", and {', '.join(strict)} drops packets received on the other (rp_filter)" if strict else ""
        yield Finding.error(subject, f"{' and '.join(direct)} have the same network{drops}", remedy)
    else:
        yield Finding.good(subject, f"is in the network of {direct[0]}")
    return direct


def _interface(name: str, packet_bytes: int, machine: Machine) -> Iterator[Finding]:
    folder, subject = f"/sys/class/net/{name}", f"network {name}"
    state = machine.text(f"{folder}/operstate")
    if state in ("down", "lowerlayerdown"):
        remedy = f"sudo ip link set {name} up   # and check the cable and the camera's supply"
        yield Finding.error(subject, "is down", remedy)
        return
    speed = machine.number(f"{folder}/speed")
    if speed is None or speed < 0:
        yield Finding.warning(subject, "does not report its speed", f"sudo ethtool {name}")
    elif speed < MIN_MBIT_S:
        remedy = (
            f"sudo ethtool -s {name} autoneg on   # all eight wires: another cable, another socket or switch"
        )
        yield Finding.error(subject, f"runs at {speed} Mbit/s instead of {MIN_MBIT_S}", remedy)
    else:
        yield Finding.good(subject, f"runs at {speed} Mbit/s")
    mtu = machine.number(f"{folder}/mtu") or 0
    larger = (
        f"sudo ip link set {name} mtu 9000   # and permanently in its settings; the switch must pass it on"
    )
    if packet_bytes > mtu:
        yield Finding.error(subject, f"its MTU is {mtu} but packet_bytes {packet_bytes}", larger)
    elif mtu < MIN_JUMBO_BYTES:
        yield Finding.warning(subject, f"its MTU is {mtu}: it works; larger packets need less CPU", larger)
    else:
        yield Finding.good(subject, f"its MTU is {mtu}")


def _receive_buffer(frame_bytes: int, machine: Machine) -> Iterator[Finding]:
    path, subject = "/proc/sys/net/core/rmem_max", "network receive buffer"
    largest, wanted = machine.number(path), FRAMES_BUFFERED * frame_bytes
    if largest is None:
        yield Finding.warning(subject, f"{path} cannot be read")
    elif largest < wanted:
        setting = f"net.core.rmem_max={max(wanted, 1 << 22)}"
        remedy = f"echo {setting} | sudo tee /etc/sysctl.d/90-altd.conf && sudo sysctl --system"
        yield Finding.warning(
            subject, f"is {largest} bytes at most, {FRAMES_BUFFERED} frames are {wanted}", remedy
        )
    else:
        yield Finding.good(subject, f"up to {largest} bytes")


def _source_check(machine: Machine) -> Iterator[Finding]:
    """Check if packets in a camera's name are dropped when they come from another network (RFC 3704)."""
    interfaces = _wired(machine)
    open_ones = [name for name in interfaces if not _filters(name, machine)]
    subject = "network source check"
    if len(interfaces) < 2:
        return  # then there is no other network
    if open_ones:
        settings = "\\n".join(f"net.ipv4.conf.{name}.rp_filter=1" for name in ("all", *open_ones))
        remedy = f"printf '{settings}\\n' | sudo tee /etc/sysctl.d/91-altd.conf && sudo sysctl --system"
        text = (
            f"{', '.join(open_ones)} accepts packets with a camera's address from another network (rp_filter)"
        )
        yield Finding.warning(subject, text, remedy)
    else:
        yield Finding.good(subject, "packets are accepted only on the interface of their network")


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
        remedy = "ip -brief address   # use one of these in altd.toml, or 0.0.0.0 for all of them"
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


def _routes(machine: Machine) -> list[_Route]:
    """The kernel's IPv4 routes, the most specific first."""
    routes = []
    for line in machine.text("/proc/net/route").splitlines()[1:]:
        name, destination, gateway, flags, _, _, metric, mask = line.split()[:8]
        prefix_bits = int(mask, 16).bit_count()
        network = ipaddress.IPv4Network((from_kernel(destination), prefix_bits), strict=False)
        if int(flags, 16) & 1:
            routes.append(_Route(name, network, int(gateway, 16) == 0, int(metric)))
    return sorted(routes, key=lambda route: (-route.network.prefixlen, route.metric))


def _neighbour(address: ipaddress.IPv4Address) -> ipaddress.IPv4Address:
    """An address for this computer in the network of a camera."""
    network = ipaddress.IPv4Network((address, 24), strict=False)
    return next(other for other in network.hosts() if other != address)


def _filters(interface: str, machine: Machine) -> bool:
    """Whether packets are dropped if answers to them would go elsewhere: the larger of two settings."""
    settings = (machine.number(f"/proc/sys/net/ipv4/conf/{name}/rp_filter") for name in ("all", interface))
    return max(setting or 0 for setting in settings) == 1


def _wired(machine: Machine) -> list[str]:
    """Real network interfaces that are up: no loopback, no bridge of containers, no wireless ones."""
    names = [Path(path).name for path in machine.paths("/sys/class/net/*")]
    return [
        name
        for name in names
        if machine.at(f"/sys/class/net/{name}/device").exists()
        and not machine.at(f"/sys/class/net/{name}/wireless").exists()
        and machine.text(f"/sys/class/net/{name}/operstate") == "up"
    ]
