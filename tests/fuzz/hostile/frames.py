"""WebSockets as no browser speaks them (RFC 6455): handshakes, frames, and what a server may say to them."""

import random
import socket
import struct
from collections.abc import Callable
from itertools import pairwise

from fuzz.hostile.pictures import PATH, complaint_of_pictures, complaint_of_views
from fuzz.hostile.requests import STATUSES, Address, complaint, connected

_CONTINUATION, _TEXT, _BINARY, _CLOSE, _PING, _PONG = 0, 1, 2, 8, 9, 10
_RESERVED_OPCODES = 3, 4, 5, 6, 7, 11, 12, 13, 14, 15
_UNSENT_CODES = {1004, 1005, 1006, 1015}
"""That no end may put into a frame (RFC 6455, 7.4.1)."""

_LONGEST_HEARD = 1 << 20
_WAIT_S = 0.03

_KEY = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
_HEADERS = ["Host: unit", "Upgrade: websocket", "Connection: Upgrade", _KEY, "Sec-WebSocket-Version: 13"]
_ADDED = (
    *("Sec-WebSocket-Version: 8", "Sec-WebSocket-Version: 13, 13", "Sec-WebSocket-Key: short", _KEY),
    *("Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits=99999", "Upgrade: h2c"),
    *("Sec-WebSocket-Extensions: ;;=,", "Sec-WebSocket-Protocol: a, b, \x7f", "Origin: http://evil.example"),
    *(
        "Origin: null",
        "Content-Length: 9",
        "Transfer-Encoding: chunked",
        "Connection: close",
        "X: " + "y" * 9000,
    ),
)


def frame(
    opcode: int, payload: bytes, first_bits: int = 0x80, is_masked: bool = True, length: int | None = None
) -> bytes:
    """A frame; ``first_bits`` are FIN and the reserved ones, ``length`` the one that it claims."""
    said = len(payload) if length is None else length
    mask_bit = 0x80 if is_masked else 0
    if said < 126:
        head = bytes([first_bits | opcode, mask_bit | said])
    elif said < 1 << 16:
        head = struct.pack(">BBH", first_bits | opcode, mask_bit | 126, said)
    else:
        head = struct.pack(">BBQ", first_bits | opcode, mask_bit | 127, said)
    if not is_masked:
        return head + payload
    mask = b"\x37\xfa\x21\x3d"
    return head + mask + bytes(byte ^ mask[place % 4] for place, byte in enumerate(payload))


def _ask(chance: random.Random) -> bytes:
    return frame(_TEXT, b"next") * chance.choice((1, 1, 2, 50))


def _opcode(chance: random.Random) -> bytes:
    return frame(chance.choice(_RESERVED_OPCODES), chance.randbytes(chance.randrange(126)))


def _reserved_bits(chance: random.Random) -> bytes:
    bits = chance.choice((0xC0, 0xA0, 0x90, 0x40, 0xF0))
    return frame(chance.choice((_TEXT, _PING)), b"next", first_bits=bits)


def _unmasked(chance: random.Random) -> bytes:
    return frame(chance.choice((_TEXT, _BINARY, _PING, _CLOSE)), b"next", is_masked=False)


def _huge(chance: random.Random) -> bytes:
    length = chance.choice((1 << 16, 1 << 31, 1 << 32, (1 << 63) - 1, (1 << 64) - 1))
    return frame(chance.choice((_TEXT, _BINARY)), chance.randbytes(500), length=length)


def _long_form(chance: random.Random) -> bytes:
    """A short length in a long form, which is not allowed (RFC 6455, 5.2)."""
    head = chance.choice((struct.pack(">BBH", 0x81, 0xFE, 4), struct.pack(">BBQ", 0x81, 0xFF, 4)))
    return head + bytes(4) + b"next"


def _endless(chance: random.Random) -> bytes:
    """A message in fragments, of which none is the last."""
    piece = frame(_CONTINUATION, b"x" * chance.choice((0, 1, 100)), first_bits=0)
    return frame(_TEXT, b"ne", first_bits=0) + piece * chance.choice((1, 5, 20, 1000))


def _out_of_order(chance: random.Random) -> bytes:
    begun = frame(_TEXT, b"ne", first_bits=0)
    follow = frame(_CONTINUATION, b"xt"), begun + frame(_TEXT, b"next"), begun + frame(_PING, b"") + begun
    return chance.choice(follow)


def _no_text(chance: random.Random) -> bytes:
    wrong = chance.choice((b"\xff", b"\xc0\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80", b"next\xe2\x82"))
    if chance.random() < 0.5:
        return frame(_TEXT, wrong)
    return frame(_TEXT, wrong[:1], first_bits=0) + frame(_CONTINUATION, wrong[1:])


def _pings(chance: random.Random) -> bytes:
    return frame(_PING, chance.randbytes(chance.choice((0, 125)))) * chance.choice((1, 1, 10, 300))


def _long_control(chance: random.Random) -> bytes:
    opcode = chance.choice((_CLOSE, _PING, _PONG))
    if chance.random() < 0.5:
        return frame(opcode, bytes(chance.choice((126, 200, 300, 70_000))))
    return frame(opcode, b"", first_bits=0)


def _pong(chance: random.Random) -> bytes:
    return frame(_PONG, chance.randbytes(chance.randrange(126))) * chance.choice((1, 5, 100))


def _close(chance: random.Random) -> bytes:
    codes = 0, 999, 1000, 1001, 1003, 1004, 1005, 1006, 1012, 1015, 2999, 3000, 4999, 5000, 65535
    code = chance.choice(codes)
    payload = chance.choice((b"", b"\x03", code.to_bytes(2, "big"), code.to_bytes(2, "big") + b"\xff\xfe"))
    return frame(_CLOSE, payload) * chance.choice((1, 1, 3))


def _long_message(chance: random.Random) -> bytes:
    return frame(chance.choice((_TEXT, _BINARY)), b"n" * chance.choice((0, 256, 257, 1000, 70_000)))


def _cut_short(chance: random.Random) -> bytes:
    return frame(_TEXT, b"next")[: chance.randrange(1, 10)]


def _noise(chance: random.Random) -> bytes:
    return chance.randbytes(chance.randrange(1, 300))


_KINDS: tuple[Callable[[random.Random], bytes], ...] = (
    *(_ask, _ask, _opcode, _reserved_bits, _unmasked, _huge, _long_form, _endless, _out_of_order, _no_text),
    *(_pings, _long_control, _pong, _close, _long_message, _cut_short, _noise),
)


def handshake(chance: random.Random, is_good: bool) -> bytes:
    """The request that opens a WebSocket, or one that is corrupted in up to three places."""
    headers = list(_HEADERS)
    if not is_good:
        for _ in range(chance.randrange(1, 3)):
            if chance.random() < 0.5:
                del headers[chance.randrange(len(headers))]
            else:
                headers.insert(chance.randrange(len(headers) + 1), chance.choice(_ADDED))
    data = bytearray("\r\n".join([f"GET {PATH} HTTP/1.1", *headers, "", ""]).encode("latin-1"))
    if not is_good and chance.random() < 0.5:
        for _ in range(chance.randrange(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


def send(address: Address, chance: random.Random) -> tuple[str, str]:
    """Open a WebSocket and send frames; returns how it ended, and what was wrong with what the unit said."""
    opening = handshake(chance, chance.random() < 0.7)
    frames = b"".join(kind(chance) for kind in chance.choices(_KINDS, k=chance.randrange(1, 5)))
    if chance.random() < 0.2:
        spoilt = bytearray(frames)
        spoilt[chance.randrange(len(spoilt))] ^= 1 << chance.randrange(8)
        frames = bytes(spoilt)
    heard, is_closed = _exchange(address, opening, frames, chance)
    how, why = judge(heard, len(frames) // 6, is_closed)
    return how, f"{why}; sent {(opening + frames)[:600]!r}" if why else ""


def judge(heard: bytes, most_pictures: int, is_closed: bool) -> tuple[str, str]:
    """The end of a conversation, and messages of the unit that are not allowed (RFC 6455, 5.2, 5.5, 7.4)."""
    if not heard.startswith(b"HTTP/1.1 101 "):
        return heard[9:12].decode("latin-1") or "closed", complaint(heard, {*STATUSES, 426})
    said, why = _frames_of(heard.partition(b"\r\n\r\n")[2])
    if why:
        return "frames", why
    texts = [payload for opcode, payload in said if opcode == _TEXT]
    pictures = [payload for opcode, payload in said if opcode == _BINARY]
    closes = [payload for opcode, payload in said if opcode == _CLOSE]
    try:
        complaints = [*map(complaint_of_views, texts), *map(complaint_of_pictures, pictures)]
    except (ValueError, KeyError, TypeError) as error:
        return "frames", f"a message that is none: {error!r}"
    if len(texts) > 1 or len(pictures) > most_pictures:
        complaints.append(f"{len(texts)} texts and {len(pictures)} messages with pictures")
    if closes and (said[-1][0] != _CLOSE or len(closes) > 1):
        complaints.append("it spoke after it had closed")
    if not closes:
        return "cut" if is_closed else "open", "".join(complaints)
    code = int.from_bytes(closes[0][:2], "big") if closes[0] else 0
    if closes[0] and (not 1000 <= code < 5000 or code in _UNSENT_CODES):
        complaints.append(f"it closed with {code}")
    return f"close {code or '-'}", "".join(complaints)


def _frames_of(data: bytes) -> tuple[list[tuple[int, bytes]], str]:
    """Opcode and payload of each whole frame, and what no server may send."""
    said: list[tuple[int, bytes]] = []
    while len(data) >= 2:
        first, second = data[0], data[1]
        opcode, length, at = first & 15, second & 127, 2
        if first & 0xF0 != 0x80 or opcode not in (_TEXT, _BINARY, _CLOSE, _PING, _PONG) or second & 0x80:
            return said, f"a frame that no server sends: {data[:20]!r}"
        if length > 125:
            if opcode >= _CLOSE:
                return said, "a control frame that is too long"
            at = 4 if length == 126 else 10
            length = int.from_bytes(data[2:at], "big")
        if len(data) < at + length:
            break
        said.append((opcode, data[at : at + length]))
        data = data[at + length :]
    return said, ""


def _exchange(address: Address, opening: bytes, frames: bytes, chance: random.Random) -> tuple[bytes, bool]:
    """The unit's messages, and whether it closed the connection; a silent client is left alone."""
    heard, is_closed = b"", False
    cuts = sorted({0, len(frames), *(chance.randrange(len(frames) + 1) for _ in range(chance.randrange(3)))})
    try:
        with connected(address) as connection:
            if chance.random() < 0.1:  # in one piece, before the unit has agreed
                connection.sendall(opening + frames)
            else:
                connection.sendall(opening)
                connection.settimeout(_WAIT_S * 10)
                heard = connection.recv(65536)
                for begin, end in pairwise(cuts):
                    connection.sendall(frames[begin:end])
            if chance.random() < 0.2:
                connection.shutdown(socket.SHUT_WR)
            connection.settimeout(_WAIT_S)
            while len(heard) < _LONGEST_HEARD:
                piece = connection.recv(65536)
                if not piece:
                    is_closed = True
                    break
                heard += piece
            if chance.random() < 0.3:  # leave by a reset
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    except TimeoutError:
        pass
    except OSError:  # reset
        is_closed = True
    return heard, is_closed
