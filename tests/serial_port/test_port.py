"""The port on a pseudo terminal: whole or not at all, never blocking, loud when it is gone."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import time
from pathlib import Path

import pytest
import serial
from support.foreign import need_program
from support.wire import Wire

from altd.config import SerialPort
from altd.serial_port.opening import open_serial
from altd.serial_port.port import describe, opened, seconds_on_line

GONE = "the port is gone"


async def test_bytes_go_both_ways(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as port:
        assert port.write(b"out")
        assert await wire.receive(lambda data: data == b"out")
        wire.send(b"in")
        assert await port.read() == b"in"


async def test_a_real_serial_client_at_the_far_end(tmp_path: Path) -> None:
    far, near = tmp_path / "far", tmp_path / "near"
    socat = await asyncio.create_subprocess_exec(
        need_program("socat"), f"pty,raw,echo=0,link={far}", f"pty,raw,echo=0,link={near}"
    )
    try:
        async with asyncio.timeout(3.0):
            while not (far.exists() and near.exists()):  # noqa: ASYNC110  a foreign program makes them
                await asyncio.sleep(0.005)
        settings = SerialPort(device=near, speaks="telegram", baud=115200, parity="even", stop_bits=2)
        async with opened(settings, limit=100, fresh=True) as port:
            with serial.Serial(str(far), 115200, timeout=1) as client:
                port.write(b"$PALT\r\n")
                assert await asyncio.to_thread(client.readline) == b"$PALT\r\n"
                client.write(b"help\r")
                assert await port.read() == b"help\r"
                socat.terminate()
                with pytest.raises(OSError, match=GONE):
                    await asyncio.wait_for(port.read(), 2.0)
    finally:
        if socat.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                socat.terminate()
            await socat.wait()


async def test_reading_ends_when_the_pause_is_over(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as port:
        assert await port.read(until=asyncio.ensure_future(asyncio.sleep(0.01))) == b""


async def test_what_does_not_fit_is_refused_whole_and_never_blocks(wire: Wire) -> None:
    """Nobody reads: the kernel's buffer fills up, then one telegram waits, then all are refused."""
    telegram = b"x" * 98 + b"\r\n"
    async with opened(wire.settings(), limit=150, fresh=True) as port:
        accepted = 0
        slowest_s = 0.0
        for _ in range(2000):
            started = time.perf_counter()
            accepted += port.write(telegram)
            slowest_s = max(slowest_s, time.perf_counter() - started)
        assert accepted < 2000
        assert slowest_s < 0.1
        received = await wire.receive(lambda data: len(data) >= 100 * accepted)
        assert received == telegram * accepted
        assert port.write(b"again\r\n")
        assert await wire.receive(lambda data: data == b"again\r\n")


async def test_a_hang_up_raises(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True) as port:
        reading = asyncio.ensure_future(port.read())
        await asyncio.sleep(0.01)
        wire.hang_up()
        with pytest.raises(OSError, match=GONE):
            await reading
        with pytest.raises(OSError, match=GONE):
            port.write(b"x")


async def test_a_hang_up_with_output_waiting_raises(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100_000, fresh=True) as port:
        while port.write(b"x" * 1000):
            pass
        wire.hang_up()
        with pytest.raises(OSError, match=GONE):
            await port.read()


def exclusive(wire: Wire) -> bool:
    """Whether the kernel refuses to let anybody else open the device (TIOCGEXCL of asm-generic/ioctls.h)."""
    return fcntl.ioctl(wire.near, 0x80045440, b"\0" * 4) != b"\0" * 4


async def test_a_second_program_is_kept_out_until_the_port_is_closed(wire: Wire) -> None:
    async with opened(wire.settings(), limit=100, fresh=True):
        with pytest.raises(OSError, match="another program uses the port") as caught:
            open_serial(wire.device, 9600)
        assert caught.value.errno == errno.EBUSY
        with pytest.raises(serial.SerialException):
            serial.Serial(str(wire.device), exclusive=True)
        assert exclusive(wire)
    assert not exclusive(wire)
    async with opened(wire.settings(), limit=100, fresh=True):
        pass


@pytest.mark.parametrize(
    ("device", "number"), [("/dev/none", errno.ENOENT), ("/dev/null", errno.ENOTTY), ("/tmp", errno.EISDIR)]
)
async def test_a_port_that_cannot_be_opened_is_named(device: str, number: int) -> None:
    with pytest.raises(OSError, match=device) as caught:
        open_serial(Path(device), 9600)
    assert caught.value.errno == number
    assert type(caught.value) is not serial.SerialException


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_no_descriptor_is_left_open(wire: Wire) -> None:
    before = open_descriptors()
    for _ in range(3):
        async with opened(wire.settings(), limit=100, fresh=True) as port:
            port.write(b"x")
    assert open_descriptors() == before


def test_the_time_on_the_line_counts_start_parity_and_stop_bits() -> None:
    port = SerialPort(device=Path("/dev/ttyS1"), speaks="telegram", parity="even", stop_bits=2)
    assert seconds_on_line(port, 96) == pytest.approx(0.12)
    assert describe(port) == "/dev/ttyS1, 9600 baud 8E2"
