"""The GigE Vision cameras that answer; checks of those that a config names, and of the network to them."""

from __future__ import annotations

import ipaddress
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from altd.devices.aravis import AravisCameraSettings, gvcp
from altd.devices.aravis.gvcp import is_address
from altd.devices.settings import details
from altd.process.machine import Finding, Machine
from altd.process.port_owner import from_kernel

MIN_MBIT_S = 1000
MIN_JUMBO_BYTES = 8000
"""Packet size from which a frame's packets no longer cost a noticeable part of a core."""

FRAMES_BUFFERED = 2
_ANSWER_TIMEOUT_S = 0.25
_MAX_TRIES = 2
_DISCOVERY_TIMEOUT_S = 0.5


@dataclass(frozen=True, slots=True)
class _Route:
    interface: str
    network: ipaddress.IPv4Network
    direct: bool
    metric: int


def lines() -> Iterator[str]:
    """Yield the cameras that answer for ``altd devices``; raises ImportError without Aravis."""
    from altd.devices.aravis.binding import usb_cameras
    from altd.devices.aravis.open_camera import find_cameras

    for found in find_cameras():
        yield f'  device = "{found.serial or found.address}"'
        yield from details(f"{found.vendor} {found.model} at {found.address}; as an id {found.id!r}")
        if found.in_use:
            yield from details("another program controls it now: its features were not read")
        elif found.formats:
            yield from details("pixel_format = " + " or ".join(f'"{name}"' for name in found.formats))
        else:
            yield from details("sends no grey picture that altd can use, or did not answer")
    for usb in usb_cameras():
        yield f'  device = "{usb.serial or usb.id}"'
        yield '  interface = "usb"'
        yield from details(f"{usb.vendor} {usb.model}; as an id {usb.id!r}")


def check(cameras: Mapping[str, AravisCameraSettings], machine: Machine) -> Iterator[Finding]:
    """Check cameras of driver "aravis" and their interfaces; a camera with a name may be on any of them."""
    interfaces: dict[str, int] = {}
    gige = {name: camera for name, camera in cameras.items() if camera.interface == "gige"}
    for name, camera in cameras.items():
        if name not in gige:
            yield _usb(f"camera {name} {camera.device}", camera.device)
    for name, camera in gige.items():
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
    if gige:
        frame_bytes = max(
            camera.width * camera.height * (1 if camera.pixel_format == "Mono8" else 2)
            for camera in gige.values()
        )
        yield from _receive_buffer(frame_bytes, machine)
        yield from _source_check(machine)


def _usb(subject: str, device: str) -> Finding:
    """Check for a USB3 Vision camera by its name, without disturbing it."""
    try:
        from altd.devices.aravis.binding import usb_cameras
    except ImportError:
        return Finding.skipped(subject, "not looked for without Aravis")
    if sum(device in (camera.id, camera.serial) for camera in usb_cameras()) == 1:
        return Finding.good(subject, "is connected")
    remedy = "lsusb   # check its cable, and the rule of udev that docs/cameras.md names"
    return Finding.error(subject, "no USB3 Vision camera of this name may be opened", remedy)


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
