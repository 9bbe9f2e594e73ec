"""Requests of Modbus TCP that are nearly valid, none of them a right command; and a reader beside them."""

import asyncio
import random
import socket
import struct
import time
import zlib

from fuzz.hostile.requests import Address, connected
from fuzz.hostile.tally import Tally
from fuzz.targets.modbus_tcp import CHECK_NOW, OWN, PDUS, UNIT, frame, judge, requests_in

from tools.pages.example import MEASURED

NEXT_ZERO = 0xBEEF
"""The number that sets a zero; no attacker knows it."""

_COMMANDS = (CHECK_NOW, struct.pack(">BHH", 6, 1001, NEXT_ZERO))
_POLL_TIMEOUT_S = 5.0
_BLOCK = struct.pack(">BHH", 4, 200, 80)


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
