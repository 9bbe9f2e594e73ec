"""Assembly of frames from the packets of a stream, from any sender.

Bounded by construction: the size of a frame is the camera's setting, never the value that a packet claims; at
most ``max_open`` frames are open; a packet that does not fit into one of them is dropped. Frames are from one
sender only: where two packets contradict each other, it is unknown which of them is the camera's, and no
frame is delivered until ``QUARANTINE_NS`` after the last contradiction. No input or output here: packets and
times are arguments.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from altd.devices.aravis import gvsp
from altd.records import counted

RETENTION_NS = 100_000_000
"""Time after its last packet at which an incomplete frame is given up; it delays those behind it."""
QUARANTINE_NS = 2_000_000_000

_RESEND_TIMEOUT_NS = 10_000_000
_RESEND_INTERVAL_NS = 25_000_000
_MAX_RESENDS = 3
_MAX_RESEND_RANGES = 16
_MAX_LEADERS_KEPT = 16
REMEDY = "switch chunks, compression and multi-part off with the maker's tool"
_MAX_STANDARD_ID = 65535
_MAX_EXTENDED_ID = 2**64 - 1


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """The camera's settings of the stream: sizes in bytes, ``packet_bytes`` with all headers (IP, UDP, GVSP).

    ``packet_bytes`` and ``ticks_per_s`` are those of GigE Vision alone.

    ``payload_bytes`` is the size of a block that the camera reports; it may include padding behind the image.
    """

    width: int
    height: int
    pixel_format: int
    image_bytes: int
    payload_bytes: int
    packet_bytes: int = 0
    ticks_per_s: int = 0


@dataclass(frozen=True, slots=True)
class Block:
    """A block of the stream. ``fault`` describes its fault, if any; it then has no data.

    ``device_ns`` is the camera's own timestamp, 0 where it has none; ``arrived_ns`` is the time of the
    leader's arrival on the monotonic clock.
    """

    fault: str
    frame_id: int
    device_ns: int = 0
    arrived_ns: int = 0
    data: memoryview | None = None


@dataclass(frozen=True, slots=True)
class _Layout:
    """Source, id format and payload type of frames, from the first leader, and thus each packet's contents.

    ``needed`` payload packets hold the ``needed_bytes`` of the image and, in a chunk, of the end of that; the
    last of them holds ``last_data_bytes``. Up to ``max_packets`` may arrive.
    """

    port: int
    extended: bool
    payload_type: int
    needed_bytes: int
    data_bytes: int
    needed: int
    last_data_bytes: int
    max_packets: int


@dataclass(slots=True)
class _OpenBlock:
    """A block whose leader has arrived. ``have[k]`` is 1 once packet k has; the last one is the trailer's."""

    id: int
    layout: _Layout
    device_ns: int
    arrived_ns: int
    last_ns: int
    missing: int
    pixels: memoryview
    have: bytearray
    resends: int = 0
    requested_ns: int = 0


class Assembler:
    """Assembles packets into blocks in their order. ``source_port`` 0: the camera does not report its port.

    ``refused`` counts packets that fit nowhere, ``contradictions`` those that show a second sender;
    ``last_refusal`` and ``last_contradiction`` describe the last one of each.
    """

    def __init__(
        self, stream_format: StreamFormat, *, max_open: int, resend: bool, source_port: int = 0
    ) -> None:
        self.refused = self.contradictions = 0
        self.last_refusal = self.last_contradiction = ""
        self._format = stream_format
        self._max_open = max_open
        self._resend = resend
        self._source_port = source_port
        self._layout: _Layout | None = None
        self._open: dict[int, _OpenBlock] = {}
        self._leaders: deque[tuple[int, bytes]] = deque(maxlen=_MAX_LEADERS_KEPT)
        self._last_whole: _OpenBlock | None = None
        self._quarantined_until_ns = 0
        self._request_id = 0

    @property
    def busy(self) -> bool:
        """Whether a block is being assembled."""
        return bool(self._open)

    def quarantined(self, now_ns: int) -> bool:
        """Whether frames are withheld because of a contradiction."""
        return now_ns < self._quarantined_until_ns

    def take(self, packet: memoryview, port: int, now_ns: int) -> None:
        """Process a datagram from the camera's address and ``port``."""
        header = gvsp.read_header(packet)
        if header is None or (self._source_port and port != self._source_port):
            self.refused += 1
            return
        body = packet[header.size :]
        if header.packet_format == gvsp.LEADER:
            self._take_leader(header, body, port, now_ns)
            return
        block = self._open.get(header.block_id)
        if block is None and self._last_whole is not None and header.block_id == self._last_whole.id:
            block = self._last_whole
        if block is None or header.extended != block.layout.extended:
            self.refused += 1
        elif header.packet_format == gvsp.PAYLOAD:
            self._take_payload(block, header.packet_id, body, port, now_ns)
        elif header.packet_format == gvsp.TRAILER:
            self._take_trailer(block, header.packet_id, body, port, now_ns)
        else:
            self.refused += 1

    def blocks(self, now_ns: int) -> Iterator[Block]:
        """Yield the blocks that are complete or given up, in the order in which they began."""
        while self._open:
            block = next(iter(self._open.values()))
            whole = block.missing == 0
            waits = now_ns - block.last_ns < RETENTION_NS and (self._resend or len(self._open) == 1)
            if not whole and waits:
                return
            del self._open[block.id]
            if not whole:
                yield Block(f"{counted(block.missing, 'packet')} missing", block.id)
                continue
            self._last_whole = block
            if self.quarantined(now_ns):
                yield Block(self.last_contradiction, block.id)
            elif fault := self._chunk_fault(block):
                self.refused += 1
                self.last_refusal = fault
                yield Block(fault, block.id)
            else:
                image = block.pixels[: self._format.image_bytes]
                yield Block("", block.id, block.device_ns, block.arrived_ns, image)

    def resend_commands(self, now_ns: int) -> Iterator[bytes]:
        """Yield requests for packets that a block has lacked for some time; at most three times a block."""
        if not self._resend:
            return
        for block in self._open.values():
            interval_ns = _RESEND_INTERVAL_NS if block.resends else _RESEND_TIMEOUT_NS
            if (
                block.missing == 0
                or block.resends == _MAX_RESENDS
                or now_ns - max(block.last_ns, block.requested_ns) < interval_ns
            ):
                continue
            block.resends += 1
            block.requested_ns = now_ns
            for first, last in _gaps(block.have):
                if last == len(block.have) - 1:  # the trailer follows all packets that the camera may send
                    last = block.layout.max_packets + 1
                self._request_id = self._request_id % 65535 + 1
                yield gvsp.resend_command(self._request_id, block.id, block.layout.extended, first, last)

    def _take_leader(self, header: gvsp.Header, body: memoryview, port: int, now_ns: int) -> None:
        leader = gvsp.read_leader(body)
        form = self._format
        if leader is None or header.packet_id != 0:
            self.refused += 1
            kind = gvsp.payload_type(body)
            self.last_refusal = f"sends payload type {kind:#06x}, which announces no image: {REMEDY}"
            return
        if leader[2:] != (form.pixel_format, form.width, form.height, 0, 0):
            self.refused += 1
            self.last_refusal = (
                f"sends {leader.width} x {leader.height} in format {leader.pixel_format:#x}, "
                f"padded by {leader.padding_x} and {leader.padding_y}, and was not set to that"
            )
            return
        layout = self._layout
        if layout is None:
            layout = self._layout = _layout(form, port, header.extended, leader.payload_type)
        elif (port, header.extended, leader.payload_type) != (
            layout.port,
            layout.extended,
            layout.payload_type,
        ):
            self._contradict("frames come from two ports, or have two forms", now_ns)
            return
        content = bytes(body)
        known = next((other for block_id, other in self._leaders if block_id == header.block_id), None)
        if known is not None:
            if known != content:
                self._contradict("two frames have the same number", now_ns)
        elif self._leaders and not _is_ahead(header.block_id, self._leaders[-1][0], header.extended):
            self._contradict("the frames' numbers go back", now_ns)
        elif len(self._open) >= self._max_open:
            self.refused += 1
        else:
            self._leaders.append((header.block_id, content))
            device_ns = leader.timestamp * 1_000_000_000 // form.ticks_per_s if form.ticks_per_s else 0
            self._open[header.block_id] = _OpenBlock(
                id=header.block_id,
                layout=layout,
                device_ns=device_ns,
                arrived_ns=now_ns,
                last_ns=now_ns,
                missing=layout.needed + 1,
                pixels=memoryview(bytearray(layout.needed_bytes)),
                have=bytearray(layout.needed + 2),
            )

    def _take_payload(
        self, block: _OpenBlock, packet_id: int, body: memoryview, port: int, now_ns: int
    ) -> None:
        layout = block.layout
        if 0 < packet_id < layout.needed:
            fits = len(body) == layout.data_bytes
        elif packet_id == layout.needed:
            fits = layout.last_data_bytes <= len(body) <= layout.data_bytes
            body = body[: layout.last_data_bytes]
        else:
            return  # behind the image, or an invalid id
        if not fits:
            self.refused += 1
        elif port != layout.port:
            self._contradict("a frame's packets come from two ports", now_ns)
        else:
            begin = (packet_id - 1) * layout.data_bytes
            place = block.pixels[begin : begin + len(body)]
            if not block.have[packet_id]:
                block.have[packet_id] = 1
                place[:] = body
                block.missing -= 1
                block.last_ns = now_ns
            elif place != body:
                self._contradict("two packets have the same number", now_ns)

    def _take_trailer(
        self, block: _OpenBlock, packet_id: int, body: memoryview, port: int, now_ns: int
    ) -> None:
        layout = block.layout
        fits = layout.needed < packet_id <= layout.max_packets + 1
        if not fits or not gvsp.is_trailer(body, layout.payload_type):
            self.refused += 1
            self.last_refusal = (
                f"ends a frame of payload type {layout.payload_type:#06x} with a trailer of another type, "
                f"or not between packets {layout.needed + 1} and {layout.max_packets + 1}"
            )
        elif port != layout.port:
            self._contradict("a frame's packets come from two ports", now_ns)
        elif not block.have[-1]:
            block.have[-1] = 1
            block.missing -= 1
            block.last_ns = now_ns

    def _chunk_fault(self, block: _OpenBlock) -> str:
        """Describe why the image cannot be the first chunk of a whole block; empty if it can."""
        layout, image_bytes = block.layout, self._format.image_bytes
        if layout.payload_type == gvsp.IMAGE:
            return ""
        stated = gvsp.chunk_bytes(block.pixels)
        if stated >= image_bytes and gvsp.bytes_to_end_of_chunk(stated) == layout.needed_bytes:
            return ""
        return f"its chunks do not begin with an image of {image_bytes} bytes: {REMEDY}"

    def _contradict(self, what: str, now_ns: int) -> None:
        """Discard all earlier packets; the sender of the next packet is taken for the camera."""
        self.contradictions += 1
        self.last_contradiction = f"{what}: another sender uses the camera's address"
        self._quarantined_until_ns = now_ns + QUARANTINE_NS
        self._open.clear()
        self._leaders.clear()
        self._layout = self._last_whole = None


def _layout(form: StreamFormat, port: int, extended: bool, payload_type: int) -> _Layout:
    is_plain = payload_type == gvsp.IMAGE
    needed_bytes = form.image_bytes if is_plain else gvsp.bytes_to_end_of_chunk(form.image_bytes)
    data_bytes = gvsp.data_bytes(form.packet_bytes, extended)
    needed = -(-needed_bytes // data_bytes)
    return _Layout(
        port,
        extended,
        payload_type,
        needed_bytes,
        data_bytes,
        needed,
        last_data_bytes=needed_bytes - (needed - 1) * data_bytes,
        max_packets=max(needed, -(-form.payload_bytes // data_bytes)),
    )


def _is_ahead(block_id: int, last: int, extended: bool) -> bool:
    """Whether a block's number follows another one, across the wrap, by less than half of all numbers."""
    count = _MAX_EXTENDED_ID if extended else _MAX_STANDARD_ID
    return 0 < (block_id - last) % count < count / 2


def _gaps(have: bytearray) -> Iterator[tuple[int, int]]:
    """First and last packet id of the first ranges of missing packets; the leader is never missing."""
    last = 0
    for _ in range(_MAX_RESEND_RANGES):
        first = have.find(0, last + 1)
        if first < 0:
            return
        following = have.find(1, first)
        last = (len(have) if following < 0 else following) - 1
        yield first, last
