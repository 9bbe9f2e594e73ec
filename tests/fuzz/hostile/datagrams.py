"""A foreign voice on the cameras' network: ``python -m fuzz.hostile.datagrams``.

Arguments: process id of the daemon and of the cameras, for how long, s, how long in one way, s, datagrams a
second, seed. Sends datagrams with forged sources (raw socket) to the UDP ports that the daemon has at the
moment, in one way after the other; it listens in to the cameras' frames, to forge frames that look like them.
It shares no code with altd: packets are made from the GigE Vision standard.
"""

import itertools
import os
import random
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from support import gvsp

FOREIGN = "127.0.0.66"
_GVCP_PORT = 3956
_HEADER = struct.Struct(">HHI")
_IP_UDP = struct.Struct(">BBHHHBBH4s4sHHHH")
_CAPTURE_S = 0.3
_PORT_SCAN_INTERVAL_S = 0.25
_IDLE_S = 0.05


Datagrams = Iterator[tuple[tuple[str, int], tuple[str, int], bytes]]
Ends = list[tuple[str, int]]


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """A frame on its way from a camera to the daemon."""

    at_s: float
    block_id: int
    leader: bytes
    image: bytes
    data_bytes: int


@dataclass(frozen=True, slots=True)
class Target:
    """A camera's stream: its address and port, where the daemon takes it, and a frame of it."""

    source: tuple[str, int]
    goal: tuple[str, int]
    captured: CapturedFrame


Phase = Callable[[random.Random, Ends, list[Target]], Datagrams]


def main() -> int:
    """Send for so long; prints a line for each phase: when it began, monotonic s, datagrams, its name."""
    daemon, cameras, seconds, phase_s, rate, seed = (float(text) for text in sys.argv[1:7])
    dice = random.Random(seed)
    raw = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW)
    end_s = time.monotonic() + seconds
    for phase, made_in in itertools.cycle(PHASES.items()):
        began_s = due_s = time.monotonic()
        if began_s >= end_s:
            break
        goals = list(udp_ports(int(daemon)))
        targets = list(_targets(list(udp_ports(int(cameras))), goals))
        looked_s, sent = began_s, 0
        while (now_s := time.monotonic()) < min(began_s + phase_s, end_s):
            if now_s - looked_s > _PORT_SCAN_INTERVAL_S:
                looked_s, goals = now_s, list(udp_ports(int(daemon)))
            burst = list(made_in(dice, goals, targets)) if goals else []
            for source, goal, data in burst:
                raw.sendto(_packet(source, goal, data), goal)
            sent += len(burst)
            due_s = max(due_s, now_s) + (len(burst) / rate if burst else _IDLE_S)
            time.sleep(max(due_s - time.monotonic(), 0.0))
        print(f"{began_s:.3f} {sent} {phase}", flush=True)
    return 0


def _silence(_dice: random.Random, _goals: Ends, _targets: list[Target]) -> Datagrams:
    return iter(())


def _foreign(dice: random.Random, goals: Ends, targets: list[Target]) -> Datagrams:
    """Anything at all, whole frames among it, from an address that is no camera's."""
    source = FOREIGN, dice.randrange(1, 65536)
    for _ in range(50):
        yield source, dice.choice(goals), _anything(dice)
    for target in targets:
        yield from _frame(target, source, ahead=dice.choice((0, 1, 1, 2, 30_000)))


def _noise(dice: random.Random, goals: Ends, _targets: list[Target]) -> Datagrams:
    """Anything but well-formed frames, in the camera's name."""
    for _ in range(50):
        goal = dice.choice(goals)
        yield (goal[0], dice.randrange(1, 65536)), goal, _anything(dice)


def _noise_from_port(dice: random.Random, goals: Ends, targets: list[Target]) -> Datagrams:
    """The same from the camera's own port."""
    yield from _noise(dice, goals, targets)
    for target in targets:
        for _ in range(50):
            yield target.source, target.goal, _anything(dice)


def _frames(dice: random.Random, _goals: Ends, targets: list[Target]) -> Datagrams:
    """Whole frames in the camera's name, from another port."""
    for target in targets:
        yield from _frame(target, (target.source[0], dice.randrange(1, 65536)), ahead=dice.choice((1, 2, 3)))


def _frames_from_port(dice: random.Random, _goals: Ends, targets: list[Target]) -> Datagrams:
    """Whole frames in the camera's name, from its own port, with numbers about the next one."""
    for target in targets:
        yield from _frame(target, target.source, ahead=dice.choice((0, 1, 2, 3, 10)))


def _packets_from_port(dice: random.Random, _goals: Ends, targets: list[Target]) -> Datagrams:
    """Single packets of the frame that is about to come, from the camera's own port."""
    for target in targets:
        packets = [data for _, _, data in _frame(target, target.source, ahead=dice.choice((0, 1)))]
        yield from ((target.source, target.goal, data) for data in dice.sample(packets, 20))


PHASES: Mapping[str, Phase] = {
    "silence": _silence,
    "foreign": _foreign,
    "noise": _noise,
    "silence again": _silence,
    "noise from the camera's port": _noise_from_port,
    "frames": _frames,
    "frames from the camera's port": _frames_from_port,
    "packets from the camera's port": _packets_from_port,
}


def _anything(dice: random.Random) -> bytes:
    """Noise; or what looks like GVSP or GVCP at its beginning."""
    noise = dice.randbytes(dice.choice((0, 1, 8, 20, 28, 44, 200, 1372, 1472, 9000)))
    kind = dice.randrange(6)
    if kind == 0:
        return noise
    if kind == 1:
        return gvsp.KILLER
    if kind == 2:  # GVSP, standard ids
        return _HEADER.pack(0, dice.randrange(65536), dice.randrange(8) << 24 | dice.getrandbits(24)) + noise
    if kind == 3:  # GVSP, extended ids
        packet_kind, block_id = dice.randrange(8), dice.getrandbits(64)
        number = dice.choice((0, 1, 0xF0000000, 0xFFFFFFFF))
        return gvsp.packet(block_id, packet_kind, number, noise, extended=True)
    if kind == 4:  # acknowledgements of registers and memory; "wait for me" for a minute
        command = dice.choice((0x81, 0x83, 0x85, 0x87, 0x89))
        return struct.pack(">HHHH", 0, command, len(noise), dice.randrange(65536)) + noise
    return struct.pack(">HHHH", dice.getrandbits(16), 0x89, 4, dice.randrange(65536)) + b"\0\0\xff\xff"


def _frame(target: Target, source: tuple[str, int], ahead: int) -> Datagrams:
    """A frame like the one that was heard, its picture 200 columns aside."""
    captured = target.captured
    block_id = (captured.block_id + int((time.monotonic() - captured.at_s) * 20) + ahead - 1) % 65535 + 1
    width = struct.unpack_from(">I", captured.leader, 16)[0]
    picture = np.frombuffer(captured.image, np.uint8).reshape(-1, width)
    image = np.roll(picture, 200, axis=1).tobytes()
    bodies = [captured.leader]
    bodies += [image[at : at + captured.data_bytes] for at in range(0, len(image), captured.data_bytes)]
    bodies += [gvsp.trailer(0)]
    for number, body in enumerate(bodies):
        kind = gvsp.PAYLOAD if number else gvsp.LEADER
        if number == len(bodies) - 1:
            kind = gvsp.TRAILER
        yield source, target.goal, gvsp.packet(block_id, kind, number, body)


def _targets(sources: Ends, goals: Ends) -> Iterator[Target]:
    """Listen in until a whole frame of each camera was heard."""
    with socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800)) as ear:
        ear.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        ear.settimeout(0.1)
        wanted = {source for source in sources if source[1] != _GVCP_PORT}
        parts: dict[tuple[str, int], dict[int, bytes]] = {}
        until_s = time.monotonic() + _CAPTURE_S
        while wanted and time.monotonic() < until_s:
            try:
                packet = ear.recv(65536)
            except TimeoutError:
                return
            source = socket.inet_ntoa(packet[12:16]), int.from_bytes(packet[20:22], "big")
            goal = socket.inet_ntoa(packet[16:20]), int.from_bytes(packet[22:24], "big")
            if source not in wanted or goal not in goals or len(packet) < 44:
                continue
            status, block_id, word = _HEADER.unpack_from(packet, 28)
            kind, number, body = word >> 24, word & 0xFFFFFF, packet[36:]
            if status == 0 and kind == gvsp.LEADER:
                parts[source] = {0: body}
            elif status == 0 and source in parts and kind == gvsp.PAYLOAD:
                parts[source][number] = body
            elif status == 0 and source in parts and kind == gvsp.TRAILER and len(parts[source]) == number:
                of = parts.pop(source)
                image = b"".join(of[n] for n in range(1, number))
                wanted.discard(source)
                frame = CapturedFrame(time.monotonic(), block_id, of[0], image, len(of[1]))
                yield Target(source, goal, frame)


def udp_ports(process: int) -> Iterator[tuple[str, int]]:
    """Address and port of a process's UDP sockets that are not connected."""
    inodes = set()
    for entry in Path(f"/proc/{process}/fd").iterdir():
        try:
            inodes.add(os.readlink(entry))  # noqa: PTH115  a link to no file
        except OSError:
            continue  # closed meanwhile
    for line in Path(f"/proc/{process}/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        local, remote, inode = fields[1], fields[2], fields[9]
        address, _, port = local.partition(":")
        if f"socket:[{inode}]" in inodes and remote.startswith("00000000"):
            yield socket.inet_ntoa(struct.pack("=I", int(address, 16))), int(port, 16)


def _packet(source: tuple[str, int], goal: tuple[str, int], data: bytes) -> bytes:
    """IPv4 and UDP without a checksum, which UDP allows; the kernel fills in that of IP."""
    addresses = socket.inet_aton(source[0]), socket.inet_aton(goal[0])
    udp_bytes = 8 + len(data)
    ports = source[1], goal[1], udp_bytes, 0
    return _IP_UDP.pack(0x45, 0, 20 + udp_bytes, 0, 0, 64, 17, 0, *addresses, *ports) + data


if __name__ == "__main__":
    sys.exit(main())
