"""A hostile broker, to which units publish in both profiles; they measure, and a client polls by HTTP."""

import asyncio
import contextlib
import json
import logging
import random
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from fuzz.hostile import served
from fuzz.hostile.readers import poll
from fuzz.hostile.tally import Tally
from support.mqtt import CONNECT, PINGREQ, PUBLISH, SUBSCRIBE, PublishingUnit, packet_of, published

from altd.publish.mqtt import broker as connection
from altd.publish.mqtt import connecting, edge_node
from altd.runtime import supervision
from tools.pages.example import MEASURED

CONNECTED = bytes.fromhex("20 03 00 00 00")
_NCMD = b"\x00\x17spBv1.0/g/NCMD/ALT-0007"
_REBIRTH = b"\x12\x1a\x0a\x14Node Control/Rebirth\x20\x0b\x70\x01"
PACKETS = (
    CONNECTED,
    *(bytes.fromhex(text) for text in ("20020000", "200300 8700", "20020001", "2009 00 00 06 130005 210001")),
    *(bytes.fromhex(text) for text in ("40020001", "4003000187", "400400010000", "40020002", "50020001")),
    *(bytes.fromhex(text) for text in ("62020001", "70020001", "9003000100", "9004000100 00", "b003000100")),
    *(
        bytes.fromhex(text)
        for text in ("d000", "e000", "e0028e00", "e0018b", "f000", "f00100", "1000", "c000")
    ),
    *(bytes.fromhex(text) for text in ("3006000161007879", "32080001610001007879", "34080001610001007879")),
    *(bytes.fromhex(text) for text in ("9004000100 01", "d000")),
    b"\x30\x36" + _NCMD + b"\x00" + _REBIRTH,
    b"\x33\x38" + _NCMD + b"\x00\x01\x00" + _REBIRTH,
    b"\x30\x1a" + _NCMD + b"\x00",
    b"\x30\xff\xff\xff\x7f",
    b"HTTP/1.1 400 Bad Request\r\n\r\n",
)
UNITS = 8
_MEASURE_INTERVAL_S = 0.05
_FAST = {
    connecting: {"INTERVAL_S": 0.02, "MAX_JITTER_S": 0.0},
    connection: {"ACK_TIMEOUT_S": 0.2, "CONNECT_TIMEOUT_S": 0.2, "GOODBYE_TIMEOUT_S": 0.02},
    edge_node: {"REBIRTH_INTERVAL_S": 0.02},
    supervision: {
        "MIN_BACKOFF_S": 0.001,
        "MAX_BACKOFF_S": 0.001,
        "log": logging.Logger("unheard", logging.CRITICAL),
    },
}
_TOPICS = {
    *(f"altd/ALT-0007/{name}" for name in ("availability", "birth", "state", "summary", "measurement")),
    *(f"spBv1.0/g/{kind}/ALT-0007" for kind in ("NBIRTH", "NDATA", "NDEATH")),
}


class HostileBroker:
    """Does what a broker does, and sends in between what none may send."""

    def __init__(self, inputs: int, seed: int, tally: Tally) -> None:
        self._left, self._chance, self._tally = inputs, random.Random(seed), tally
        self.done = asyncio.Event()

    def _hostile(self) -> bytes:
        """Up to four packets, some of them corrupted."""
        stream = b""
        for packet in self._chance.choices(PACKETS, k=self._chance.randrange(5)):
            data = bytearray(packet)
            for _ in range(max(self._chance.randrange(-2, 4), 0)):
                data[self._chance.randrange(len(data))] = self._chance.randrange(256)
            stream += data
            self._left -= 1
        if self._left <= 0:
            self.done.set()
        return stream

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            while True:
                kind, flags, body = await packet_of(reader)
                answer = b""
                if kind == CONNECT:
                    answer = self._chance.choice((CONNECTED,) * 9 + (b"",))
                elif kind == SUBSCRIBE:
                    answer = b"\x90\x04" + body[:2] + b"\x00\x01"
                elif kind == PINGREQ:
                    answer = b"\xd0\x00"
                elif kind == PUBLISH:
                    number = self._check(flags, body)
                    answer = b"\x40\x02" + number.to_bytes(2) if number else b""
                writer.write(answer + self._hostile())
        writer.close()

    def _check(self, flags: int, body: bytes) -> int:
        """The number of a message, in which no hostile input has left a trace."""
        number, message = published(flags, body)
        if message.topic not in _TOPICS:
            self._tally.wrong.append(f"the unit published on {message.topic}")
        if message.topic.endswith("/measurement"):
            line, _, crc = message.payload.rpartition(', "crc32": ')
            shown = json.loads(message.payload)["x_mm"]
            if crc != f'"{zlib.crc32(line.encode()):08X}"}}' or shown not in (None, MEASURED.number("x_mm")):
                self._tally.wrong.append(f"the unit published {message.payload}")
        return number


async def attack(inputs: int, seed: int, tally: Tally) -> None:
    """So many hostile packets to units that connect again each time."""
    broker, sequence = HostileBroker(inputs, seed, tally), 0
    async with contextlib.AsyncExitStack() as stack:
        for module, values in _FAST.items():
            stack.enter_context(patch.multiple(module, **values))
        good = await stack.enter_async_context(served.http(Path(stack.enter_context(TemporaryDirectory()))))
        server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
        stack.callback(server.close)
        port = server.sockets[0].getsockname()[1]
        profiles = [{"sparkplug": {"group": "g"}}, {"every_measurement": True}]
        units = [PublishingUnit.made(port, **profiles[number % 2]) for number in range(UNITS)]
        tasks = [await stack.enter_async_context(unit.running()) for unit in units]
        while not (broker.done.is_set() or tally.wrong):
            sequence += 1
            for unit, task in zip(units, tasks, strict=True):
                unit.measure(sequence)
                if task.done() or not unit.component.message.isprintable():
                    tally.wrong.append(f"{task}: {unit.component.message!r}")
            await poll(good.address, tally)
            await asyncio.sleep(_MEASURE_INTERVAL_S)
    tally.answers["packets"] = inputs
    tally.answers["connections ended"] = sum(unit.component.counters.get("failures", 0) for unit in units)
