"""Answers of a unit, true and forged, and a Modbus TCP server that gives the answers of a script."""

import contextlib
import enum
import socket
import struct
import threading
import zlib
from collections.abc import Iterator, Sequence

from altd.publish.modbus.checked_block import CheckedBlock
from altd.publish.modbus.registers import WordOrder
from altd.reasons import Reason
from altd.records import Fault, Measurement
from altd.status.proof import Identity, Stamp
from support.measurements import measured, measurement
from tools.pages.example import view_of

SERIAL, SESSION = "ALT-0007", 0x5C1E90A7
UNIT = zlib.crc32(SERIAL.encode())
MEASURED = measurement()


def block(
    message: int,
    clock_ms: int | None = None,
    age_ms: float | None = 60,
    *,
    unit: int = UNIT,
    session: int = SESSION,
    published: int | None = None,
    of: Measurement | None = MEASURED,
    order: WordOrder = WordOrder.ABCD,
) -> bytes:
    """An answer of the unit; a message comes each 100 ms."""
    stamp = Stamp(Identity(unit, session), message, 7000 + 100 * message if clock_ms is None else clock_ms)
    count = message if published is None else published
    age_s = None if age_ms is None else age_ms / 1000
    return struct.pack(">80H", *CheckedBlock(order).at(view_of(of, age_s, count, stamp)))


def forged(data: bytes, words: dict[int, int]) -> bytes:
    """The block with other words, and the CRC that belongs to them."""
    spoilt = list(struct.unpack(">80H", data))
    for address, word in words.items():
        spoilt[address - 200] = word
    covered = struct.pack(">78H", *spoilt[:78])
    return covered + zlib.crc32(covered).to_bytes(4, "big")


def flipped(data: bytes, *bits: int) -> bytes:
    spoilt = bytearray(data)
    for bit in bits:
        spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)


def swapped(data: bytes, size: int) -> bytes:
    """Every ``size`` bytes in the opposite order of their words or bytes."""
    step = size // 2
    return b"".join(data[at + step : at + size] + data[at : at + step] for at in range(0, len(data), size))


def refused(reason: Reason, target: str | None = None) -> Measurement:
    nowhere = dict.fromkeys(("front", "rear"))
    return measured(None, nowhere, frames=0, status=(Fault(reason, target),))


class Wire(enum.Enum):
    """A client's answer in place of its 80 registers."""

    SILENT = "nothing"
    EXCEPTION = "exception 2"
    TORN = "half of an answer, then the end of the connection"
    SHORT = "79 registers"
    OTHER_REQUEST = "the answer to another request"
    TRICKLE = "a byte each 0.2 s, and never the last one"


REQUEST = struct.pack(">BHH", 4, 200, 80)
_PDUS: dict[bytes | Wire, bytes] = {Wire.EXCEPTION: b"\x84\x02", Wire.SHORT: b"\x04\x9e" + bytes(158)}


def _answer(said: bytes | Wire, transaction: int, unit: int) -> bytes:
    """The bytes to send."""
    registers = said if isinstance(said, bytes) else bytes(160)
    pdu = _PDUS.get(said, b"\x04\xa0" + registers)
    number = transaction ^ 0x0101 if said is Wire.OTHER_REQUEST else transaction
    frame = struct.pack(">HHHB", number, 0, len(pdu) + 1, unit) + pdu
    lengths: dict[bytes | Wire, int] = {Wire.SILENT: 0, Wire.TORN: 80, Wire.TRICKLE: len(frame) - 1}
    return frame[: lengths.get(said, len(frame))]


@contextlib.contextmanager
def answering(script: Sequence[bytes | Wire]) -> Iterator[int]:
    """The port of a server that takes one line of the script for each request, and then is silent."""
    listener, over = socket.create_server(("127.0.0.1", 0)), threading.Event()
    lines = iter(script)

    def serve() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), listener.accept()[0] as connection:
                while len(request := connection.recv(12, socket.MSG_WAITALL)) == 12:
                    assert request[7:] == REQUEST, request.hex()
                    said = next(lines, Wire.SILENT)
                    answer = _answer(said, int.from_bytes(request[:2], "big"), request[6])
                    step = 1 if said is Wire.TRICKLE else len(answer)
                    for at in range(0, len(answer), step or 1):
                        connection.sendall(answer[at : at + step])
                        over.wait(0.2 * (said is Wire.TRICKLE))
                    if said is Wire.TORN:
                        connection.shutdown(socket.SHUT_RDWR)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        over.set()
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()
        listener.close()
