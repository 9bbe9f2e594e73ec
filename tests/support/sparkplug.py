"""Sparkplug, seen from outside: a session of the unit, recorded, and payloads decoded by npm's package."""

import asyncio
import json
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from altd.reasons import Reason
from altd.records import Fault
from support.foreign import need_npm, need_program
from support.mqtt import (
    CONNECT,
    PUBLISH,
    SUBSCRIBE,
    PublishingUnit,
    Subscriber,
    Valve,
    mosquitto,
    packets_of,
    published,
    subscribed,
)

_CODEC = """
const { encodePayload, decodePayload } = require("sparkplug-payload").get("spBv1.0");
const plain = (key, value) => typeof value?.toNumber === "function" ? value.toNumber()
    : value?.low !== undefined ? value.high * 2 ** 32 + (value.low >>> 0) : value;
const { encode, decode } = JSON.parse(require("fs").readFileSync(0));
console.log(JSON.stringify({
    encoded: encode.map((payload) => Buffer.from(encodePayload(payload)).toString("hex")),
    decoded: decode.map((payload) => decodePayload(Buffer.from(payload, "hex"))),
}, plain));
"""


def _run(encode: Sequence[dict[str, Any]], decode: Sequence[bytes]) -> dict[str, Any]:
    given = json.dumps({"encode": encode, "decode": [payload.hex() for payload in decode]})
    node, folder = need_program("node", "nodejs"), need_npm("sparkplug-payload")
    done = subprocess.run(
        [node, "-e", _CODEC], input=given, cwd=folder, capture_output=True, text=True, check=True, timeout=60
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def decoded(*payloads: bytes) -> list[dict[str, Any]]:
    """Each payload; times and numbers as whole numbers."""
    answer: list[dict[str, Any]] = _run([], payloads)["decoded"]
    return answer


def encoded(payload: dict[str, Any]) -> bytes:
    return bytes.fromhex(_run([payload], [])["encoded"][0])


def rebirth(value: bool = True, name: str = "Node Control/Rebirth") -> dict[str, Any]:
    """The command for it, as a host sends it."""
    return {"timestamp": 1, "metrics": [{"name": name, "type": "Boolean", "value": value}]}


OPEN = "allow_anonymous true"
HEX = ("-F", "%t %q %r %x")
MEASUREMENTS = 300
"""More than there are sequence numbers."""
BIRTH, DATA, DEATH, COMMAND = (
    f"spBv1.0/plant-4/{kind}/ALT-0007" for kind in ("NBIRTH", "NDATA", "NDEATH", "NCMD")
)


@dataclass
class Message:
    """As the unit has sent it, or as a host has heard it."""

    topic: str
    qos: int
    retain: bool
    data: bytes
    payload: dict[str, Any] = field(default_factory=dict)

    def metrics(self) -> dict[str, dict[str, Any]]:
        return {metric["name"]: metric for metric in self.payload["metrics"]}

    def number(self, name: str) -> Any:
        return self.metrics()[name]["value"]


@dataclass
class Connection:
    """One of the unit."""

    kinds: list[int]
    flags: int
    properties: bytes
    will: Message
    subscription: bytes
    sent: list[Message]

    def of(self, topic: str) -> list[Message]:
        return [message for message in self.sent if message.topic == topic]


@dataclass
class Recorded:
    """A session: connections of the unit, messages that a host heard, and when it was."""

    connections: list[Connection]
    heard: list[Message]
    from_ms: float
    to_ms: float

    @property
    def sent(self) -> list[Message]:
        return [message for connection in self.connections for message in connection.sent]

    def of(self, topic: str) -> list[Message]:
        return [message for message in self.sent if message.topic == topic]

    @property
    def births(self) -> list[Message]:
        return self.of(BIRTH)

    @property
    def living(self) -> list[Message]:
        return [message for message in self.sent if message.topic in (BIRTH, DATA)]


def _text(body: bytes, at: int) -> tuple[bytes, int]:
    end = at + 2 + int.from_bytes(body[at : at + 2])
    return body[at + 2 : end], end


async def _connection(stream: bytes) -> Connection:
    packets = await packets_of(stream)
    kind, _, body = packets[0]
    assert (kind, body[:7]) == (CONNECT, b"\x00\x04MQTT\x05")
    at = 11 + body[10]  # one byte: the properties are short
    _, at = _text(body, at)
    at += 1 + body[at]  # the properties of the will
    topic, at = _text(body, at)
    data, _ = _text(body, at)
    will = Message(topic.decode(), body[7] >> 3 & 3, bool(body[7] & 0x20), data)
    messages = [published(flags, body)[1] for kind, flags, body in packets if kind == PUBLISH]
    sent = [Message(each.topic, each.qos, each.retain, each.data) for each in messages]
    (subscription,) = (body for kind, _, body in packets if kind == SUBSCRIBE)
    return Connection(
        [kind for kind, _, _ in packets], body[7], body[11 : 11 + body[10]], will, subscription, sent
    )


class Host:
    """mosquitto_sub, and mosquitto_pub for commands."""

    def __init__(self, client: Subscriber, port: int) -> None:
        self._client, self._port = client, port
        self.heard: list[Message] = []

    async def until(self, topic: str) -> Message:
        while True:
            name, qos, retained, text = await self._client.next()
            self.heard.append(Message(name, qos, retained, bytes.fromhex(text)))
            if name == topic:
                return self.heard[-1]

    async def command(self, payload: bytes) -> None:
        program = need_program("mosquitto_pub", "mosquitto-clients")
        line = [program, "-V", "5", "-p", str(self._port), "-t", COMMAND, "-s"]
        await asyncio.to_thread(subprocess.run, line, input=payload, check=True)


def _captured() -> datetime:
    return datetime.now(UTC) - timedelta(seconds=0.5)


async def record(folder: Path) -> Recorded:
    from_ms = time.time() * 1e3
    with mosquitto(folder, OPEN) as (port, _):
        async with Valve(port) as valve, subscribed(port, *HEX, topic="spBv1.0/#") as client:
            host = Host(client, port)
            unit = PublishingUnit.made(valve.port, every_measurement=True, sparkplug={"group": "plant-4"})
            async with unit.running():
                await host.until(BIRTH)
                for sequence in range(MEASUREMENTS):
                    unit.measure(sequence, time=_captured())
                    await host.until(DATA)
                unit.measure(
                    MEASUREMENTS, time=_captured(), values={}, status=(Fault(Reason.SPOT_MISSING, "front"),)
                )
                await host.until(DATA)
                await host.command(encoded(rebirth()))
                await host.until(BIRTH)
                valve.hang_up()
                await host.until(DEATH)
                await host.until(BIRTH)
                unit.measure(MEASUREMENTS + 1, time=_captured())
                await host.until(DATA)
            await host.until(DEATH)
            streams = list(valve.sent)
    connections = [await _connection(bytes(stream)) for stream in streams]
    recorded = Recorded(connections, host.heard, from_ms, time.time() * 1e3)
    messages = [*recorded.sent, *recorded.heard, *(connection.will for connection in connections)]
    for message, payload in zip(messages, decoded(*(m.data for m in messages)), strict=True):
        message.payload = payload
    return recorded
