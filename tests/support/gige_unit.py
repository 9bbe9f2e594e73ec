"""A GigE Vision client of a few lines on Aravis, and a simulated unit that is served to it.

Aravis is the judge here: nothing of altd and of hw_sim takes part in what the client sees.
"""

import ctypes
import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from support.foreign import need, need_program, need_receive_buffer

BUFFERS = 16
FOUND_WITHIN_S = 20.0
FRAME_WITHIN_US = 20_000_000
"""Long, for a busy machine loses packets of one frame after another; a camera that is silent never sends."""


class _Error(ctypes.Structure):
    _fields_ = (("domain", c_uint), ("code", c_int), ("message", c_char_p))


@dataclass(frozen=True)
class Received:
    """A frame as it came: the device's timestamp, its number, its grey values."""

    timestamp_ns: int
    number: int
    pixels: np.ndarray


class Client:
    """One camera, held; ``start`` and then ``next``, or ``take`` for a few frames."""

    def __init__(self, address: str) -> None:
        self._aravis = ctypes.CDLL("libaravis-0.8.so.0")
        self._gobject = ctypes.CDLL("libgobject-2.0.so.0")
        self._camera = self._found(address)
        self._stream: int | None = None

    def _found(self, address: str) -> Any:
        """The camera there: Aravis waits for a fraction of a second, a busy machine may be late for it."""
        end_s = time.monotonic() + FOUND_WITHIN_S
        while True:
            try:
                return self._call("camera_new", c_void_p, (c_char_p, address.encode()))
            except OSError:
                if time.monotonic() > end_s:
                    raise

    def _plain(self, name: str, result: Any, *arguments: tuple[Any, Any]) -> Any:
        function = getattr(self._aravis, f"arv_{name}")
        function.restype = result
        function.argtypes = [kind for kind, _ in arguments]
        return function(*(value for _, value in arguments))

    def _call(self, name: str, result: Any, *arguments: tuple[Any, Any]) -> Any:
        """A function that ends in a GError."""
        error = POINTER(_Error)()
        answer = self._plain(name, result, *arguments, (c_void_p, byref(error)))
        if error:
            raise OSError(f"{name}: {error.contents.message.decode()}")
        return answer

    def _feature(self, name: str, result: Any, feature: str, *value: tuple[Any, Any]) -> Any:
        held = (c_void_p, self._camera)
        return self._call(f"camera_{name}", result, held, (c_char_p, feature.encode()), *value)

    def set(self, **features: bool | int | float | str) -> None:
        for name, value in features.items():
            match value:
                case bool():
                    self._feature("set_boolean", None, name, (c_bool, value))
                case int():
                    self._feature("set_integer", None, name, (c_int64, value))
                case float():
                    self._feature("set_float", None, name, (c_double, value))
                case str():
                    self._feature("set_string", None, name, (c_char_p, value.encode()))

    def text(self, feature: str) -> str:
        text: bytes = self._feature("get_string", c_char_p, feature)
        return text.decode()

    def number(self, feature: str) -> float:
        value: float = self._feature("get_float", c_double, feature)
        return value

    def poke(self, register: int, value: int) -> int:
        """Write a register behind the features' back; what it was before."""
        device = (c_void_p, self._plain("camera_get_device", c_void_p, (c_void_p, self._camera)))
        at = (ctypes.c_uint64, register)
        before = ctypes.c_uint32()
        self._call("device_read_register", c_bool, device, at, (c_void_p, byref(before)))
        self._call("device_write_register", c_bool, device, at, (ctypes.c_uint32, value))
        return before.value

    def start(self) -> None:
        camera = (c_void_p, self._camera)
        self._stream = self._call(
            "camera_create_stream", c_void_p, camera, (c_void_p, None), (c_void_p, None)
        )
        # a frame is one burst of packets; without the right to a packet socket the socket must hold it
        self._gobject.g_object_set(
            c_void_p(self._stream), b"socket-buffer", c_int(1), b"socket-buffer-size", c_int(0), None
        )
        payload = self._call("camera_get_payload", c_uint, camera)
        for _ in range(BUFFERS):
            buffer = self._plain("buffer_new_allocate", c_void_p, (c_size_t, payload))
            self._plain("stream_push_buffer", None, (c_void_p, self._stream), (c_void_p, buffer))
        self._call("camera_start_acquisition", None, camera)

    def next(self, within_us: int = FRAME_WITHIN_US) -> Received | None:
        """The next whole frame; None where none came. A frame of which packets were lost is passed over."""
        end_s = time.monotonic() + within_us * 1e-6
        while (left_us := round(1e6 * (end_s - time.monotonic()))) > 0:
            stream = (c_void_p, self._stream)
            buffer = self._plain("stream_timeout_pop_buffer", c_void_p, stream, (ctypes.c_uint64, left_us))
            if buffer is None:
                return None
            received = self._received((c_void_p, buffer))
            self._plain("stream_push_buffer", None, stream, (c_void_p, buffer))
            if received is not None:
                return received
        return None

    def _received(self, buffer: tuple[Any, Any]) -> Received | None:
        if self._plain("buffer_get_status", c_int, buffer) != 0:
            return None
        size = c_size_t()
        start = self._plain("buffer_get_data", c_void_p, buffer, (c_void_p, byref(size)))
        width = self._plain("buffer_get_image_width", c_int, buffer)
        pixel_format = self._plain("buffer_get_image_pixel_format", c_uint, buffer)
        dtype = np.uint8 if (pixel_format >> 16) & 0xFF == 8 else np.dtype("<u2")
        return Received(
            self._plain("buffer_get_timestamp", ctypes.c_uint64, buffer),
            self._plain("buffer_get_frame_id", ctypes.c_uint64, buffer),
            np.frombuffer(ctypes.string_at(start, size.value), dtype).reshape(-1, width),
        )

    def stop(self) -> None:
        if self._stream is not None:
            self._call("camera_stop_acquisition", None, (c_void_p, self._camera))
            self._gobject.g_object_unref(c_void_p(self._stream))
            self._stream = None

    def take(self, frames: int) -> list[Received]:
        """Start, take so many frames, stop; the test fails when they do not come."""
        self.start()
        try:
            return [self.frame() for _ in range(frames)]
        finally:
            self.stop()

    def frame(self) -> Received:
        received = self.next()
        assert received is not None, "no frame came"
        return received

    def abandon(self) -> None:
        """Release the stream of a camera that is gone: to ask it to stop would wait for an answer."""
        self._gobject.g_object_unref(c_void_p(self._stream))
        self._stream = None

    def close(self) -> None:
        self.stop()
        self._gobject.g_object_unref(c_void_p(self._camera))


@contextmanager
def client(address: str) -> Iterator[Client]:
    held = Client(address)
    try:
        yield held
    finally:
        held.close()


_NUMBERS = itertools.count(1)


def new_addresses() -> dict[str, str]:
    """Two that no other test has: GigE Vision has one port, and tests may run side by side."""
    high, low = divmod(os.getpid() % (250 * 250), 250)
    return {name: f"127.{1 + high}.{1 + low}.{next(_NUMBERS)}" for name in ("front", "rear")}


def need_gige() -> None:
    """Aravis, and the right to give lo another address."""
    need_receive_buffer()
    need_program("arv-tool-0.8", "aravis-tools-cli")
    need_program("ip", "iproute2")
    need(os.geteuid() == 0, "only root may give lo the addresses that these cameras are served at")


@dataclass
class Served:
    """The server process and the addresses of its cameras."""

    process: subprocess.Popen[str]
    front: str
    rear: str
    said: str

    def end(self) -> str:
        """Ask it to end; the rest of what it said."""
        self.process.terminate()
        out, err = self.process.communicate(timeout=30)
        assert self.process.returncode == 0, err
        return out


@contextmanager
def served(*arguments: str) -> Iterator[Served]:
    """``python -m hw_sim gige`` in a process of its own, on addresses of its own, once it is ready."""
    need_gige()
    at = new_addresses()
    where = ("--front", at["front"], "--rear", at["rear"])
    process = subprocess.Popen(
        [sys.executable, "-m", "hw_sim", "gige", *where, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        said = process.stdout.readline()
        if not said:
            assert process.stderr is not None
            pytest.fail(process.stderr.read())
        yield Served(process, at["front"], at["rear"], said)
    finally:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=30)
