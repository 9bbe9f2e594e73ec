"""Frames out of packets: of one camera, of a lossy network, and of an attacker."""

import itertools
import random
import struct
import tracemalloc
from collections.abc import Callable, Iterable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support import gvsp

from altd.devices.aravis.blocks import QUARANTINE_NS, RETENTION_NS, Assembler, Block, StreamFormat

WIDTH, HEIGHT, PACKET_BYTES = 40, 30, 136  # 100 image bytes a packet: 12 packets, or 14 with extended ids
PORT, OTHER_PORT = 5000, 5001
MS = 1_000_000
PERIOD_NS = 50 * MS
MAX_OPEN = 6
BODIES = st.binary(max_size=110) | st.sampled_from(
    [
        gvsp.leader(WIDTH, HEIGHT, 3000),
        gvsp.leader(WIDTH, HEIGHT, 3000, payload_type=gvsp.IMAGE_WITH_CHUNKS),
        gvsp.trailer(HEIGHT),
        bytes(100),
        bytes(88),
    ]
)
KINDS = st.integers(0, 127) | st.integers(1, 3)
STATUS = st.sampled_from([0, 0, 0x0100, 0x800C])
FORGED = st.one_of(
    st.builds(
        gvsp.packet,
        st.just(3) | st.just(4) | st.integers(0, 2**16 - 1),
        KINDS,
        st.integers(0, 16) | st.integers(0, 2**24 - 1),
        BODIES,
        st.just(False),
        STATUS,
    ),
    st.builds(
        gvsp.packet,
        st.just(3) | st.just(4) | st.integers(0, 2**64 - 1),
        KINDS,
        st.integers(0, 16) | st.integers(0, 2**32 - 1),
        BODIES,
        st.just(True),
        STATUS,
    ),
)


def image(number: int) -> bytes:
    return random.Random(number).randbytes(WIDTH * HEIGHT)


def frame(number: int, extended: bool = False, of: int | None = None) -> list[bytes]:
    """The packets of block ``number``, which shows the picture ``of``."""
    picture = image(number if of is None else of)
    return gvsp.frame(number, picture, WIDTH, PACKET_BYTES, 1000 * number, extended)


class Rig:
    """An assembler that is fed at 20 frames a second."""

    def __init__(
        self, resend: bool = False, source_port: int = 0, payload_bytes: int = WIDTH * HEIGHT
    ) -> None:
        self.now_ns = 10**9
        self.assembler = Assembler(
            StreamFormat(
                WIDTH, HEIGHT, gvsp.MONO8, WIDTH * HEIGHT, payload_bytes, PACKET_BYTES, 1_000_000_000
            ),
            max_open=MAX_OPEN,
            resend=resend,
            source_port=source_port,
        )

    def feed(self, packets: Iterable[bytes], port: int = PORT) -> list[Block]:
        for packet in packets:
            self.assembler.take(memoryview(packet), port, self.now_ns)
        return self.after(0)

    def after(self, ns: int) -> list[Block]:
        self.now_ns += ns
        return list(self.assembler.blocks(self.now_ns))

    def resends(self) -> list[tuple[int, int, int]]:
        """Block id, first and last packet of each request."""
        found = []
        for command in self.assembler.resend_commands(self.now_ns):
            key, flags, code, length = struct.unpack_from(">BBHH", command)
            assert (key, code, length) == (0x42, 0x0040, len(command) - 8)
            first, last = struct.unpack_from(">II", command, 12)
            block = ">Q" if flags & 0x10 else ">H"
            found.append((struct.unpack_from(block, command, 20 if flags & 0x10 else 10)[0], first, last))
        return found


def shows(block: Block, number: int) -> bool:
    return block.fault == "" and block.data is not None and bytes(block.data) == image(number)


@pytest.mark.parametrize("extended", [False, True])
class TestAFrame:
    def test_is_its_camera_s_picture(self, extended: bool) -> None:
        rig = Rig()
        (block,) = rig.feed(frame(7, extended))
        assert shows(block, 7)
        assert (block.frame_id, block.device_ns, block.arrived_ns) == (7, 7000, rig.now_ns)

    def test_comes_in_any_order_behind_its_leader(self, extended: bool) -> None:
        rig, (first, *others) = Rig(), frame(7, extended)
        random.Random(1).shuffle(others)
        assert [shows(block, 7) for block in rig.feed([first, *others])] == [True]

    def test_may_come_twice(self, extended: bool) -> None:
        rig = Rig()
        twice = [packet for packet in frame(7, extended) for _ in range(2)]
        assert [shows(block, 7) for block in rig.feed([*twice, *twice])] == [True]
        assert rig.assembler.contradictions == 0

    def test_that_lacks_any_packet_is_not_given(self, extended: bool) -> None:
        for lost in range(len(frame(1, extended))):
            rig = Rig()
            packets = frame(1, extended)
            del packets[lost]
            given = rig.feed([*packets, *frame(2, extended)])
            assert [block.frame_id for block in given if not block.fault] == [2]
            assert shows(given[-1], 2)

    def test_is_asked_for_again_where_it_lacks_something(self, extended: bool) -> None:
        rig, packets = Rig(resend=True), frame(1, extended)
        lost = [3, 4, len(packets) - 1]
        assert not rig.feed(packet for n, packet in enumerate(packets) if n not in lost)
        assert rig.resends() == []
        rig.now_ns += 11 * MS
        assert rig.resends() == [(1, 3, 4), (1, lost[-1], lost[-1])]
        assert rig.resends() == []
        assert not rig.feed(frame(2, extended))  # in order: behind the one that is waited for
        resent = [b"\x01\x00" + packets[n][2:] for n in lost]
        assert [shows(block, block.frame_id) for block in rig.feed(resent)] == [True, True]

    def test_is_given_up_in_time(self, extended: bool) -> None:
        rig = Rig(resend=True)
        rig.feed(frame(1, extended)[:-1])
        asked = 0
        for _ in range(10):
            rig.now_ns += RETENTION_NS // 10 - 1
            asked += len(rig.resends())
            assert not list(rig.assembler.blocks(rig.now_ns))
        (block,) = rig.after(100)
        assert block.fault == "1 packet missing"
        assert asked == 3


class TestNumbers:
    @pytest.mark.parametrize("numbers", [[65534, 65535, 1, 2], [1, 900, 30_000]], ids=["wrap", "jump ahead"])
    def test_go_on_without_a_contradiction(self, numbers: list[int]) -> None:
        rig = Rig()
        for number in numbers:
            assert [shows(block, number) for block in rig.feed(frame(number))] == [True]
        assert rig.assembler.contradictions == 0

    def test_of_a_payload_that_is_larger_than_the_image_do_not_matter(self) -> None:
        rig = Rig(payload_bytes=WIDTH * HEIGHT + 300)
        *packets, _ = frame(1)
        filling = [gvsp.packet(1, gvsp.PAYLOAD, 13 + n, b"\xff" * 100) for n in range(3)]
        end = gvsp.packet(1, gvsp.TRAILER, 16, gvsp.trailer(HEIGHT))
        assert [shows(block, 1) for block in rig.feed([*packets, *filling, end])] == [True]
        assert rig.assembler.refused == 0

    def test_of_a_last_packet_that_is_filled_up_do_not_matter(self) -> None:
        rig = Rig()
        packets = frame(2, extended=True)  # 88 bytes a packet, 56 in the last
        packets[-2] += bytes(88 - WIDTH * HEIGHT % 88)
        assert [shows(block, 2) for block in rig.feed(packets)] == [True]


INFORMATION = gvsp.chunk(0x1234, b"line status") + gvsp.chunk(0x77, bytes(8))


class TestChunks:
    """Of cameras that ignore ``ChunkModeActive = false``."""

    @staticmethod
    def packets(number: int, chunks: bytes, kind: int = gvsp.IMAGE_WITH_CHUNKS) -> list[bytes]:
        return gvsp.frame(number, chunks, WIDTH, PACKET_BYTES, 1000 * number, False, kind, HEIGHT)

    @pytest.mark.parametrize("kind", [gvsp.IMAGE_WITH_CHUNKS, gvsp.EXTENDED_CHUNKS])
    def test_behind_the_image_do_not_matter(self, kind: int) -> None:
        rig = Rig(payload_bytes=WIDTH * HEIGHT + 8 + len(INFORMATION))
        for number in (1, 2):
            packets = self.packets(number, gvsp.chunk(1, image(number)) + INFORMATION, kind)
            assert [shows(block, number) for block in rig.feed(packets)] == [True]
        assert (rig.assembler.refused, rig.assembler.contradictions) == (0, 0)

    def test_of_an_image_that_is_filled_up_to_four_bytes_do_not_matter(self) -> None:
        size = 37 * 3
        form = StreamFormat(37, 3, gvsp.MONO8, size, 200, PACKET_BYTES, 1_000_000_000)
        rig = Rig()
        rig.assembler = Assembler(form, max_open=MAX_OPEN, resend=False)
        chunks = gvsp.chunk(1, image(1)[:size]) + INFORMATION
        (block,) = rig.feed(
            gvsp.frame(1, chunks, 37, PACKET_BYTES, payload_type=gvsp.IMAGE_WITH_CHUNKS, lines=3)
        )
        assert bytes(block.data or b"") == image(1)[:size]

    @pytest.mark.parametrize(
        "chunks",
        [
            gvsp.chunk(1, image(1)[:-WIDTH]) + INFORMATION + bytes(WIDTH),
            INFORMATION + gvsp.chunk(1, image(1)),
            gvsp.chunk(1, image(1), stated_bytes=2**32 - 1) + INFORMATION,
            gvsp.chunk(1, image(1), stated_bytes=0) + INFORMATION,
            image(1) + bytes(len(INFORMATION) + 8),
        ],
        ids=["a row less", "image behind", "longer than the payload", "of no length", "no chunks"],
    )
    def test_that_do_not_begin_with_the_image_are_refused_by_name(self, chunks: bytes) -> None:
        rig = Rig(payload_bytes=len(chunks))
        (block,) = rig.feed(self.packets(1, chunks))
        assert block.data is None
        assert "its chunks do not begin with an image of 1200 bytes: switch chunks" in block.fault
        assert rig.assembler.last_refusal == block.fault

    def test_that_end_with_another_payload_type_or_too_late_give_no_frame(self) -> None:
        chunks = gvsp.chunk(1, image(1)) + INFORMATION + gvsp.chunk(2, bytes(300))
        for payload_bytes, end in [(len(chunks), frame(1)[-1]), (WIDTH * HEIGHT, None)]:
            rig = Rig(payload_bytes=payload_bytes)
            *packets, own_end = self.packets(1, chunks)
            assert not rig.feed([*packets, end or own_end])
            assert (
                "ends a frame of payload type 0x4001 with a trailer of another" in rig.assembler.last_refusal
            )
            (block,) = rig.after(RETENTION_NS)
            assert block.fault == "1 packet missing"

    @pytest.mark.parametrize("kind", [0x0002, gvsp.CHUNKS, 0x0006, 0x000A, 0x4002])
    def test_and_other_payloads_without_an_image_s_leader_are_refused_by_name(self, kind: int) -> None:
        rig = Rig()
        assert not rig.feed(self.packets(1, gvsp.chunk(1, image(1)), kind))
        assert (
            f"sends payload type {kind:#06x}, which announces no image: switch" in rig.assembler.last_refusal
        )


FORGERIES: dict[str, Callable[[], list[tuple[int, bytes]]]] = {
    "a leader from another port": lambda: [(OTHER_PORT, frame(9)[0])],
    "a leader of another kind of numbers": lambda: [(PORT, frame(9, extended=True)[0])],
    "a packet of the frame from another port": lambda: [(OTHER_PORT, frame(2)[3])],
    "a trailer of the frame from another port": lambda: [(OTHER_PORT, frame(2)[-1])],
    "a leader of another payload type": lambda: [
        (PORT, gvsp.frame(9, image(9), WIDTH, PACKET_BYTES, payload_type=gvsp.IMAGE_WITH_CHUNKS)[0])
    ],
    "another leader with the frame's number": lambda: [
        (PORT, gvsp.frame(2, image(2), WIDTH, PACKET_BYTES, timestamp=5)[0])
    ],
    "another packet with its number": lambda: [(PORT, frame(2, of=50)[3])],
    "a whole frame of another's picture": lambda: [(PORT, packet) for packet in frame(2, of=50)],
}


class TestTwoSenders:
    @pytest.mark.parametrize("forged", FORGERIES.values(), ids=FORGERIES.keys())
    def test_end_all_frames_for_a_while(self, forged: Callable[[], list[tuple[int, bytes]]]) -> None:
        rig = Rig()
        assert [shows(block, 1) for block in rig.feed(frame(1))] == [True]
        assert not rig.feed(frame(2)[:6])
        for port, packet in forged():
            assert not [block for block in rig.feed([packet], port) if not block.fault]
        assert not [block for block in rig.feed(frame(2)[6:]) if not block.fault]
        assert rig.assembler.contradictions >= 1
        for number in itertools.count(3):
            began_ns = rig.now_ns
            given = rig.feed(frame(number)) + rig.after(PERIOD_NS)
            if not rig.assembler.quarantined(began_ns):
                break
            assert all("another sender" in block.fault for block in given)
        assert number * PERIOD_NS >= QUARANTINE_NS
        assert [shows(block, number) for block in given] == [True]

    @pytest.mark.parametrize("port", [PORT, OTHER_PORT])
    @pytest.mark.parametrize("first", ["camera", "forger"])
    def test_give_one_frame_at_most_while_they_go_on(self, port: int, first: str) -> None:
        """Whichever of the two is believed at first, and with numbers from wherever."""
        rig, given, dice = Rig(), 0, random.Random(3)
        for number in range(1, 200):
            camera = (frame(number), PORT)
            forger = (frame(dice.choice([number, number + 1, number + 900]), of=50), port)
            for packets, source in [camera, forger] if first == "camera" else [forger, camera]:
                given += sum(not block.fault for block in rig.feed(packets, source))
            rig.after(PERIOD_NS)
        assert given <= 1

    def test_of_which_the_camera_s_port_is_known_are_told_apart(self) -> None:
        rig = Rig(source_port=PORT)
        for number in range(1, 40):
            given = rig.feed(frame(number + 900, of=50), OTHER_PORT)
            given += rig.feed(frame(number))
            assert [shows(block, number) for block in given] == [True]

    def test_that_alternate_after_the_frame_are_noticed(self) -> None:
        """A last packet that came before the camera's own one, and the camera's own one behind it."""
        rig = Rig()
        rig.feed(frame(1)[:-2])
        rig.feed([frame(1, of=50)[-2], frame(1)[-1]])
        assert rig.assembler.contradictions == 0
        rig.feed([frame(1)[-2]])
        assert rig.assembler.contradictions == 1


@pytest.mark.long
class TestHostilePackets:
    def test_take_no_memory(self) -> None:
        """The largest frame, packet and block numbers; a hundred thousand packets."""
        rig, dice = Rig(resend=True), random.Random(1)
        rig.feed([gvsp.packet(1, gvsp.LEADER, 0, gvsp.leader(WIDTH, HEIGHT, 1), extended=True)])
        tracemalloc.start()
        try:
            for n in range(100_000):
                number, extended = dice.getrandbits(32), dice.random() < 0.5
                bodies = gvsp.leader(WIDTH, HEIGHT, n), gvsp.leader(2**31, 2**31, n), gvsp.trailer(2**32 - 1)
                kind = dice.choice([1, 1, 2, 3])
                number = 0 if kind == 1 else number if extended else number % 2**24
                block_id = 2 + n * 3 if extended else 1 + n % 65535
                packet = gvsp.packet(block_id, kind, number, dice.choice(bodies), extended)
                rig.assembler.take(memoryview(packet), PORT, rig.now_ns)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < 100_000
        assert len(list(rig.assembler.resend_commands(rig.now_ns + 50 * MS))) <= MAX_OPEN * 16

    def test_the_one_that_ended_the_daemon_is_nothing(self) -> None:
        rig = Rig()
        (first, *others) = frame(1)
        given = rig.feed([gvsp.KILLER, first, gvsp.KILLER, *others, gvsp.KILLER])
        assert [shows(block, 1) for block in given] == [True]

    @given(st.lists(st.binary(max_size=200), max_size=40), st.booleans(), st.integers(0, 14))
    def test_of_any_bytes_change_no_frame(self, noise: list[bytes], extended: bool, at: int) -> None:
        packets = frame(3, extended)
        assert_only_the_camera_s(Rig(), [*packets[:at], *noise, *packets[at:]])

    @given(
        st.lists(FORGED, max_size=30), st.booleans(), st.integers(0, 14), st.sampled_from([PORT, OTHER_PORT])
    )
    @example([gvsp.packet(3, gvsp.PAYLOAD, 1, bytes(100))], False, 1, PORT)
    def test_of_the_stream_s_form_change_no_frame(
        self, forged: list[bytes], extended: bool, at: int, port: int
    ) -> None:
        packets = frame(3, extended)
        assert_only_the_camera_s(Rig(), packets[:at], forged, packets[at:], port=port)


def assert_only_the_camera_s(rig: Rig, *parts: list[bytes], port: int = PORT) -> None:
    """Every frame that is given out is block 3's picture, whatever came between its packets."""
    for n, packets in enumerate(parts):
        for block in rig.feed(packets, port if n == 1 else PORT):
            assert block.fault or shows(block, 3)
    for block in rig.after(2 * RETENTION_NS):
        assert block.fault
