"""Requests of Modbus TCP that are nearly valid, none of them a right command; and a reader beside them."""

import asyncio
import random
import socket
import struct
import time
import zlib

from fuzz.hostile.requests import Address, connected
from fuzz.hostile.tally import Tally

from tools.pages.example import MEASURED

UNIT = 7
OWN = (UNIT, 0, 255)
"""The unit ids that it answers."""
MAPS = tuple(
    range(first, first + count)
    for first, count in ((0, 120), (200, 80), (300, 50), (400, 60), (500, 30), (600, 106), (720, 106))
)
"""The ranges that can be read: a read stays in one of them."""
CHECK_NOW = bytes.fromhex("0603e80001")
PDUS = (
    *(struct.pack(">BHH", function, 0, count) for function in (3, 4) for count in (1, 120, 121, 125, 126)),
    *(struct.pack(">BHH", 4, address, 80) for address in (199, 200, 201)),
    *(struct.pack(">BHH", 3, address, 50) for address in (299, 300, 301, 400, 410, 411)),
    *(struct.pack(">BHH", 4, address, 30) for address in (499, 500, 501)),
    *(struct.pack(">BHH", 6, 1001, number) for number in (*range(8), 0xFFFF)),
    *(struct.pack(">BHHBH", 16, address, 1, 2, 0) for address in (1001, 502)),
    *(struct.pack(">BHH", 2, address, count) for address in (0, 6) for count in (1, 7, 8, 2000, 2001)),
    *(bytes.fromhex(text) for text in ("2b0e0100", "2b0e0200", "2b0e0402", "2b0e04ff", "2b0d00", "2b")),
    *(bytes.fromhex(text) for text in ("0603e80001", "0603e80001", "0603e80002", "0603e90001", "06e8030001")),
    *(bytes.fromhex(text) for text in ("1003e80001020001", "0503e8ff00", "0403e80001", "0603e8000100")),
    *(bytes.fromhex(text) for text in ("010000 0001", "0600001234", "100000000102 1234", "080000a5a5", "11")),
    *(
        bytes.fromhex(text)
        for text in ("140706000400010 00a".replace(" ", ""), "1800 00", "170000000100000001020000")
    ),
)


NEXT_ZERO = 0xBEEF
"""The number that sets a zero; no attacker knows it."""

_COMMANDS = (CHECK_NOW, struct.pack(">BHH", 6, 1001, NEXT_ZERO))
_POLL_TIMEOUT_S = 5.0
_BLOCK = struct.pack(">BHH", 4, 200, 80)


def frame(pdu: bytes, transaction: int, unit: int) -> bytes:
    """With its MBAP header."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def send(address: Address, chance: random.Random) -> tuple[str, str]:
    """Send some over one connection; returns how it ended, and what is wrong with an answer."""
    stream = _stream(chance)
    asked, is_garbled = requests_in(stream)
    if any(unit in OWN and pdu in _COMMANDS for _, unit, pdu in asked):
        return "left out", ""
    heard = b""
    try:
        with connected(address) as connection:
            connection.sendall(stream)
            connection.shutdown(socket.SHUT_WR)
            while piece := connection.recv(65536):
                heard += piece
    except OSError:  # reset: it was closed for what makes no sense
        if not is_garbled:
            return "reset", f"reset at {stream.hex()}"
        return "reset", ""
    kind = "garbled" if is_garbled else "silent" if not asked else "answered"
    try:
        for transaction, unit, pdu in asked:
            got, protocol, length, got_unit = struct.unpack_from(">HHHB", heard)
            assert (got, protocol, got_unit) == (transaction, 0, unit)
            judge(pdu, unit, heard[7 : 6 + length], False)
            heard = heard[6 + length :]
        assert heard == b""
    except (AssertionError, struct.error, IndexError) as error:
        return kind, f"{error!r} at {stream.hex()}"
    return kind, ""


def _stream(chance: random.Random) -> bytes:
    stream = b""
    for _ in range(chance.randrange(1, 5)):
        pdu = bytearray(chance.choice(PDUS))
        if chance.randrange(3) == 0:
            pdu[chance.randrange(len(pdu))] = chance.randrange(256)
        if chance.randrange(8) == 0:
            pdu = bytearray(struct.pack(">BHH", 6, chance.choice((1000, 1001)), chance.randrange(NEXT_ZERO)))
        stream += frame(bytes(pdu), chance.randrange(1 << 16), chance.choice((UNIT, UNIT, 0, 255, 9)))
    if chance.randrange(10) == 0:
        at = chance.randrange(len(stream))
        stream = stream[:at] + chance.choice((b"", b"\x00", chance.randbytes(9))) + stream[at + 1 :]
    return stream


async def poll(address: Address, tally: Tally) -> None:
    """Read the checked block once, as a controller does, and check it."""
    began_s = time.monotonic()
    heard = b""
    try:
        async with asyncio.timeout(_POLL_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(sock=await asyncio.to_thread(connected, address))
            writer.write(frame(_BLOCK, 1, UNIT))
            heard = (await reader.readexactly(9 + 160))[9:]
            writer.close()
    except (OSError, EOFError, TimeoutError) as error:
        tally.wrong.append(f"the poller got nothing: {error!r}")
        return
    x_mm = struct.unpack_from(">f", heard, 60)[0]
    if zlib.crc32(heard[:-4]) != int.from_bytes(heard[-4:]) or abs(x_mm - MEASURED.number("x_mm")) > 1e-4:
        tally.wrong.append(f"the poller read {heard.hex()}")
        return
    tally.polled(time.monotonic() - began_s)


def requests_in(stream: bytes) -> tuple[list[tuple[int, int, bytes]], bool]:
    """Transaction, unit and protocol data unit of what can be answered; and whether nonsense follows."""
    requests = []
    while len(stream) >= 7:
        transaction, protocol, length, unit = struct.unpack_from(">HHHB", stream)
        if protocol != 0 or not 2 <= length <= 254:
            return requests, True
        if len(stream) < 6 + length:
            break
        requests.append((transaction, unit, stream[7 : 6 + length]))
        stream = stream[6 + length :]
    return requests, False


def judge(asked: bytes, unit: int, answer: bytes, is_command: bool) -> None:
    """Raise AssertionError unless that is the answer; ``is_command``: to a command that is carried out."""
    function = asked[0]
    if unit not in OWN:
        assert answer == bytes([function | 0x80, 11])
    elif function in (3, 4) and len(asked) == 5:
        address, count = struct.unpack(">HH", asked[1:])
        if not 1 <= count <= 125:
            assert answer == bytes([function | 0x80, 3])
        elif not any(address in map_ and address + count - 1 in map_ for map_ in MAPS):
            assert answer == bytes([function | 0x80, 2])
        else:
            assert answer[:2] == bytes([function, 2 * count])
            assert len(answer) == 2 + 2 * count
            if (address, count) == (200, 80):
                assert zlib.crc32(answer[2:-4]) == int.from_bytes(answer[-4:])
    elif function == 2 and len(asked) == 5 and answer[0] == 2:
        address, count = struct.unpack(">HH", asked[1:])
        assert address + count <= 7
        assert len(answer) == 3
        assert answer[2] >> count == 0
    elif function == 43 and answer[0] == 43:
        _judge_identification(asked, answer)
    elif function == 6:
        assert answer in ((asked,) if is_command else (b"\x86\x02", b"\x86\x03"))
    elif function not in (2, 3, 4, 43):
        assert answer == bytes([function | 0x80, 1])
    else:
        assert answer[0] == function | 0x80
        assert answer[1] in (1, 2, 3)
        assert len(answer) == 2


def _judge_identification(asked: bytes, answer: bytes) -> None:
    assert asked[1] == 14
    number, rest = answer[6], answer[7:]
    for _ in range(number):
        rest = rest[2 + rest[1] :]
    assert number > 0
    assert rest == b""
