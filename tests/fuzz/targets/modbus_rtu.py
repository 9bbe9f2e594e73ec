"""A bus with silences, torn frames and noise: our requests are found, those of others left alone."""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass

from fuzz.served import served
from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st
from support.modbus_rtu_wire import frame
from support.modbus_wire import UNIT

from altd.config import ModbusTcpSettings
from altd.publish.modbus.responder import Responder
from altd.publish.modbus.rtu import Bus

NAME = "modbus_rtu"
WITHIN_S, APART_S = 0.016, 0.2
"""The silence between the pieces of a frame that an adapter tears, and one that ends everything."""


@dataclass(frozen=True)
class Said:
    """The traffic on the bus; ``asked`` is the part that this unit has to hear in it, None nothing."""

    data: bytes
    asked: bytes | None = None
    is_noise: bool = False


_OTHERS = st.integers(0, 247).filter(lambda unit: unit != UNIT)
_USUAL = UNIT, 3, 4, 0, 1, 2, 8, 17, 43, 14
_LIKE_OURS = st.lists(st.sampled_from(_USUAL) | st.integers(0, 255), max_size=60)


@st.composite
def _polls_of_others(draw: st.DrawFn) -> list[Said]:
    unit, function = draw(_OTHERS.filter(bool)), draw(st.sampled_from((3, 4)))
    content = bytes(draw(_LIKE_OURS))
    content += bytes(len(content) % 2)
    count = len(content) // 2
    request = frame(struct.pack(">BHH", function, draw(st.integers(0, 0xFFFF)), max(count, 1)), unit)
    answer = frame(bytes([function, len(content)]) + content, unit)
    if count == 0 or draw(st.integers(0, 9)) == 0:
        answer = frame(bytes([function | 0x80, 2]), unit)
    return [Said(request), Said(answer)]


_READS = st.builds(
    lambda function, a, n: struct.pack(">BHH", function, a, n),
    st.sampled_from((2, 3, 4)),
    st.integers(0, 130),
    st.integers(0, 130),
)
_OURS = _READS.map(lambda pdu: [Said(frame(pdu), pdu)])
_NOISE = spoilt_bytes(_READS.map(lambda pdu: frame(pdu))).map(
    lambda data: [Said(data, is_noise=True)] if data else []
)
EXAMPLES = st.lists(
    st.tuples(_polls_of_others() | _OURS | _NOISE, st.integers(0, 300), st.sampled_from((WITHIN_S, APART_S))),
    max_size=12,
)
"""The traffic, the place where its last frame is torn, and the silence before it."""

_face = served(lambda faces: _Silent(Responder(ModbusTcpSettings(), faces.published, faces.component(NAME))))


@dataclass
class _Silent:
    """Serves no client: the framer and the responder are called directly, the silences are numbers."""

    responder: Responder

    async def run(self, ready: Callable[[], None]) -> None:
        ready()
        await asyncio.get_running_loop().create_future()


def check(example: list[tuple[list[Said], int, float]]) -> None:
    """A heard request has a frame of its own; without noise all requests are heard, and nothing else."""
    faces, silent = _face()
    bus, now_s, before, is_clear = Bus(UNIT), 0.0, b"", True
    for said, torn_at, silence_s in example:
        now_s += silence_s
        if silence_s > 0.1:
            is_clear = True
        for one in said:
            is_clear &= not one.is_noise
            pieces = [one.data[:torn_at], one.data[torn_at:]] if one is said[-1] else [one.data]
            heard = []
            for piece in filter(None, pieces):
                now_s += WITHIN_S
                before = (before + piece)[-600:]
                request = bus.receive(piece, now_s)
                if request is not None:
                    assert before.endswith(frame(request))
                    faces.do(_answered(silent.responder, request))
                    heard.append(request)
            if is_clear:
                assert heard == ([] if one.asked is None else [one.asked]), (one, heard)
    read = struct.pack(">BHH", 4, 102, 2)
    assert bus.receive(frame(read), now_s + 2.0) == read


async def _answered(responder: Responder, request: bytes) -> None:
    answer = responder.answer(request)
    assert 2 <= len(answer) <= 253
    assert answer[0] in (request[0], request[0] | 0x80)
