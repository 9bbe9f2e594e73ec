"""Bytes into a real Modbus TCP server: who makes sense is answered as asked, and the next controller too."""

import asyncio
import contextlib
import struct
import zlib

from fuzz.served import Faces, read_all, served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.config import ModbusTcpSettings
from altd.publish.modbus.tcp import ModbusTcpPublisher
from altd.status.zero import Zero

NAME = "modbus_tcp"
UNIT = 7
OWN = (UNIT, 0, 255)
"""The unit ids that it answers."""
MAPS = (
    range(120),
    range(200, 280),
    range(300, 350),
    range(400, 460),
    range(500, 530),
    range(600, 706),
    range(720, 826),
)
"""The ranges that can be read: a read stays in one of them."""
CHECK_NOW = bytes.fromhex("0603e80001")
TEST_READ = struct.pack(">HHHBBHH", 77, 0, 6, UNIT, 4, 102, 2)
TEST_ANSWER = struct.pack(">HHHB", 77, 0, 7, UNIT) + bytes.fromhex("04 04 12345678")

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


def frame(pdu: bytes, transaction: int, unit: int) -> bytes:
    """With its MBAP header."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


_FRAMES = st.builds(
    frame,
    st.sampled_from(PDUS) | spoilt_bytes(st.sampled_from(PDUS)).map(lambda pdu: pdu[:253] or b"\4"),
    st.integers(0, 0xFFFF),
    st.sampled_from((UNIT, UNIT, 0, 255, 9)),
)
_STREAMS = st.lists(_FRAMES, min_size=1, max_size=6).map(b"".join)
EXAMPLES = st.tuples(_STREAMS | spoilt_bytes(_STREAMS), st.integers(1, 300))
"""The bytes to send, and the size of the pieces."""


class _Asked:
    """The number of requests for a self-check."""

    times = 0

    @classmethod
    def once_more(cls) -> None:
        cls.times += 1


def _publisher(faces: Faces) -> ModbusTcpPublisher:
    faces.health.self_check.open(_Asked.once_more)
    allowed = {"allow_self_check": True, "allow_zero": True}
    settings = ModbusTcpSettings(host="127.0.0.1", port=0, unit_id=UNIT, **allowed)
    return ModbusTcpPublisher(settings, faces.board, faces.component(NAME), faces.health)


_face = served(_publisher)


def check(example: tuple[bytes, int]) -> None:
    """Each whole request has one answer of its own, up to where the bytes make no sense.

    Nothing but a self-check's own request asks for one, byte for byte; only its number sets a zero.
    """
    faces, publisher = _face()
    before = _Asked.times
    zero = faces.health.zero = Zero(faces.health.events, first_number=2)
    next_number = 2
    asked, is_garbled = requests_in(example[0])
    answers = faces.do(_exchange(publisher.port, *example))
    for transaction, unit, pdu in asked:
        if is_garbled and not answers:
            break  # lost with the connection that was closed: who still sends into it is reset
        got_transaction, protocol, length, got_unit = struct.unpack_from(">HHHB", answers)
        assert (got_transaction, protocol, got_unit) == (transaction, 0, unit)
        is_zero = unit in OWN and pdu == struct.pack(">BHH", 6, 1001, next_number)
        next_number += is_zero
        judge(pdu, unit, answers[7 : 6 + length], is_zero or pdu == CHECK_NOW)
        answers = answers[6 + length :]
    assert answers == b""
    assert is_garbled or zero.next_number == next_number
    for_checks = sum(pdu == CHECK_NOW and unit in OWN for _, unit, pdu in asked)
    assert _Asked.times - before <= for_checks
    assert is_garbled or _Asked.times - before == for_checks


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


async def _exchange(port: int, stream: bytes, piece: int) -> bytes:
    """The unit's answers; meanwhile another controller is answered."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    other_reader, other_writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        with contextlib.suppress(ConnectionError):
            for begin in range(0, len(stream), piece):
                if writer.transport.is_closing():
                    break
                writer.write(stream[begin : begin + piece])
                await asyncio.sleep(0)
            other_writer.write(TEST_READ)
            assert await other_reader.readexactly(len(TEST_ANSWER)) == TEST_ANSWER
            with contextlib.suppress(OSError):  # the daemon may have cut it off meanwhile
                writer.write_eof()
        return await read_all(reader)
    finally:
        for closing in (writer, other_writer):
            closing.transport.abort()
