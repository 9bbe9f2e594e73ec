"""Bytes of a broker into the unit's connection: it ends with a sentence, and leaves nothing behind."""

import asyncio

from fuzz.served import Faces
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st
from support.mqtt import PublishingUnit

from altd.publish.mqtt.limits import BrokerError

NAME = "mqtt"
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
_STREAMS = st.lists(st.sampled_from(PACKETS) | st.binary(max_size=40), max_size=6).map(b"".join)
EXAMPLES = st.tuples(st.booleans(), st.booleans(), _STREAMS | spoilt_bytes(_STREAMS.filter(bool)))
"""Whether the profile is Sparkplug, whether a good CONNACK comes first, and what comes then."""

_faces: list[Faces] = []


def check(example: tuple[bool, bool, bytes]) -> None:
    """Whatever the bytes are, the end is a BrokerError; no task is left, and nothing is logged."""
    if not _faces:
        _faces.append(Faces())
    is_sparkplug, is_greeted, stream = example
    sentence = _faces[0].do(_exchange(is_sparkplug, CONNECTED * is_greeted + stream))
    assert sentence.isprintable()


async def _exchange(is_sparkplug: bool, stream: bytes) -> str:
    answered = asyncio.Event()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(stream)
        writer.close()
        answered.set()

    before = asyncio.all_tasks()
    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    sparkplug = {"group": "g"} if is_sparkplug else None
    unit = PublishingUnit.made(server.sockets[0].getsockname()[1], sparkplug=sparkplug)
    sentence = ""
    try:
        async with asyncio.timeout(5.0):
            await unit.publisher.run(lambda: None)
    except BrokerError as error:
        sentence = str(error)
    server.close()
    await answered.wait()
    for _ in range(5):
        await asyncio.sleep(0)
    left = {task.get_name() for task in asyncio.all_tasks() - before}
    assert not left, left
    return sentence
