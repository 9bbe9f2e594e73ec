"""Datagrams that the camera did not send, at the ports of a running driver."""

import os
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from fuzz.hostile.datagrams import udp_ports
from support import gvsp
from support.gige import HOME, Cameras, Grabbed, driver, register

from altd.records import Frame

pytestmark = [pytest.mark.own_network, pytest.mark.waits]

FOREIGN = "127.0.0.2"
WIDTH, HEIGHT, PACKET_BYTES = 752, 480, 1400
BLACK = bytes(WIDTH * HEIGHT)


def is_the_cameras(frame: Frame) -> bool:
    """A ramp that moves by a grey value a frame."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    return bool(np.array_equal(frame.pixels, (x + y + int(frame.pixels[0, 0])) % 255))


def stream_port() -> int:
    """The destination of the frames: the camera tells it to any client (bootstrap register SCP0)."""
    port = register(HOME, 0x0D00)
    assert port
    return port & 0xFFFF


@contextmanager
def forger(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        sending.bind((address, 0))
        yield sending


@pytest.fixture
def grabbed(cameras: Cameras) -> Iterator[Grabbed]:
    cameras.start()
    with Grabbed(driver()) as grabbed:
        grabbed.await_frames(3)
        yield grabbed


class TestAnotherAddress:
    def test_gives_no_frame_and_takes_none(self, grabbed: Grabbed) -> None:
        goal = HOME, stream_port()
        with forger(FOREIGN) as sending:
            for number in range(40):
                for packet in [gvsp.KILLER, *gvsp.frame(1 + number * 700, BLACK, WIDTH, PACKET_BYTES)]:
                    sending.sendto(packet, goal)
                time.sleep(0.02)
        grabbed.await_frames(5)
        assert not grabbed.errors
        assert all(is_the_cameras(frame) for _, frame in grabbed.frames)
        assert max(np.diff([frame.sequence for _, frame in grabbed.frames])) < 100

    def test_is_not_heard_at_the_control_channel(self, grabbed: Grabbed) -> None:
        """Under one acknowledgement "wait for a minute" every request to the camera would be late."""
        wait_a_minute = struct.pack(">HHHHHH", 0, 0x89, 4, 1, 0, 60_000)
        control = [goal for goal in udp_ports(os.getpid()) if goal[1] != stream_port()]
        assert len(control) == 1
        before = dropped(control[0][1])
        with forger(FOREIGN) as sending:
            for _ in range(50):
                sending.sendto(wait_a_minute, control[0])
        assert dropped(control[0][1]) == before + 50


class TestTheCamerasAddress:
    def test_without_its_port_ends_the_frames_for_as_long(self, grabbed: Grabbed) -> None:
        goal = HOME, stream_port()
        with forger(HOME) as sending:
            before = len(grabbed.frames)
            for number in range(20):
                for packet in gvsp.frame(1 + number * 700, BLACK, WIDTH, PACKET_BYTES):
                    sending.sendto(packet, goal)
                time.sleep(0.05)
            assert len(grabbed.frames) <= before + 3
            assert not grabbed.errors
        grabbed.await_frames(5)
        assert all(is_the_cameras(frame) for _, frame in grabbed.frames)

    def test_with_what_is_no_frame_changes_nothing(self, grabbed: Grabbed) -> None:
        goal, dice = (HOME, stream_port()), np.random.default_rng(1)
        with forger(HOME) as sending:
            for _ in range(3000):
                sending.sendto(gvsp.KILLER, goal)
                sending.sendto(dice.bytes(int(dice.integers(0, 2000))), goal)
        grabbed.await_frames(5)
        assert not grabbed.errors
        assert all(is_the_cameras(frame) for _, frame in grabbed.frames)

    def test_does_not_keep_a_camera_that_started_anew_from_being_opened(
        self, grabbed: Grabbed, cameras: Cameras
    ) -> None:
        goal = HOME, stream_port()
        cameras.kill()
        with forger(HOME) as sending:
            for number in range(30):
                for packet in gvsp.frame(1 + number, BLACK, WIDTH, PACKET_BYTES)[:-1]:
                    sending.sendto(packet, goal)
                time.sleep(0.02)
        cameras.start()
        assert grabbed.back_after_s(time.monotonic_ns()) < 5.0


def dropped(port: int) -> int:
    """The datagrams to a UDP port that the kernel dropped (proc(5), the last column of /proc/net/udp)."""
    rows = [line.split() for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if row[1].endswith(f":{port:04X}"))
