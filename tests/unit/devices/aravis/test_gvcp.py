"""Single questions, and what a camera or something else may answer."""

import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from altd.devices.aravis import gvcp

ELSEWHERE = f"127.99.{os.getpid() % 250}.{os.getpid() // 250 % 250 + 1}"
"""Port 3956 is fixed; an address of our own keeps test runs apart."""


@contextmanager
def answering(answer: Callable[[bytes], list[bytes]]) -> Iterator[None]:
    """Something on GVCP's port that answers so."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind((ELSEWHERE, gvcp.PORT))

        def serve() -> None:
            while question := server.recvfrom(2048):
                if not question[0]:
                    return
                for packet in answer(question[0]):
                    server.sendto(packet, question[1])

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield
        finally:
            server.sendto(b"", (ELSEWHERE, gvcp.PORT))
            thread.join()


def ack(question: bytes, payload: bytes, status: int = 0, of: int = 0, claimed: int | None = None) -> bytes:
    _, command, _, request_id = struct.unpack_from(">HHHH", question)
    length = len(payload) if claimed is None else claimed
    return struct.pack(">HHHH", status, command + 1, length, request_id + of) + payload


class TestQuestions:
    @pytest.mark.parametrize(
        "answer",
        [
            lambda question: [],
            lambda question: [b"", b"\0", os.urandom(7), os.urandom(600)],
            lambda question: [ack(question, b"\0\0\0\0", status=0x8006)],
            lambda question: [ack(question, b"\0\0\0\0", of=1)],
            lambda question: [ack(question, b"\0\0\0\0", claimed=4000)],
            lambda question: [ack(question, b"\0\0\0\0", claimed=2)],
            lambda question: [ack(question, b"\0")],
            lambda question: [ack(question, b"\0" * 5), ack(question, b"\0" * 249)],
            lambda question: [ack(question, b"\0" * 248)],
            lambda question: [question],
        ],
        ids=[
            "nothing",
            "noise",
            "refusal",
            "answer to another question",
            "cut off",
            "longer than it says",
            "too short",
            "too long",
            "of another address",
            "echo",
        ],
    )
    def test_what_is_no_answer_is_none(self, answer: Callable[[bytes], list[bytes]]) -> None:
        with answering(answer):
            assert gvcp.control_privilege(ELSEWHERE, 0.1) is None
            assert gvcp.discover_at(ELSEWHERE, 0.1) is None

    def test_no_two_have_the_same_number(self) -> None:
        """A sender that does not see the question cannot forge its answer."""
        asked: list[bytes] = []
        with answering(lambda question: asked.append(question[6:8]) or []):
            for _ in range(20):
                gvcp.control_privilege(ELSEWHERE, 0.01)
        assert len(set(asked)) > 15

    def test_the_answer_is_found_behind_noise(self) -> None:
        with answering(
            lambda question: [b"\0", ack(question, b"\0\0\0\7", of=3), ack(question, b"\0\0\1\2")]
        ):
            assert gvcp.control_privilege(ELSEWHERE, 1.0) == 0x102

    def test_a_name_is_text_whatever_the_camera_says(self) -> None:
        hostile = bytearray(248)
        hostile[0x24:0x28] = socket.inet_aton(ELSEWHERE)
        hostile[0x48:0x68] = b"\xff\x1b[2J\n" * 5 + b"\xff\xff"
        with answering(lambda question: [ack(question, bytes(hostile))]):
            camera = gvcp.discover_at(ELSEWHERE, 1.0)
        assert camera.vendor.isprintable()

    @pytest.mark.parametrize(
        ("text", "is_one"), [("10.0.0.7", True), ("10.0.0", False), ("::1", False), ("22334", False)]
    )
    def test_only_dotted_quads_are_addresses(self, text: str, is_one: bool) -> None:
        assert gvcp.is_address(text) is is_one
