"""The part of Aravis 0.8 that is a GigE Vision camera, by ctypes: it does control, registers and stream.

PyGObject is unsuitable: the introspection data of 0.8 state that the callback is finished when the call that
sets it returns, so it is freed.
"""

import ctypes
import functools
import threading
from collections.abc import Callable
from ctypes import POINTER, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from altd.errors import BadInputError

LIBRARIES = ("libaravis-0.8.so.0", "libgobject-2.0.so.0")
DEBIAN_PACKAGE = "libaravis-0.8-0"

MAX_SERIAL_LENGTH = 15
"""Maximum length of a serial number, bytes: the register has 16, the last of them 0."""

_G_TYPE_DOUBLE = 15 << 2
_FILL = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)


class _GValue(ctypes.Structure):
    """GObject's GValue: a type and memory for a value."""

    _fields_ = (("type", c_size_t), ("data", c_uint64 * 2))


@dataclass(frozen=True, slots=True)
class FrameBuffer:
    """A frame that Aravis is about to send: the settings of the registers, and the memory for its pixels.

    ``timestamp_ns`` is the time when Aravis began it, on the realtime clock in whole microseconds.
    """

    buffer: int
    timestamp_ns: int
    exposure_us: int
    gain_raw: int
    pixel_format: int
    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def pixels(self, dtype: type[np.uint8 | np.uint16]) -> npt.NDArray[np.uint8 | np.uint16]:
        """The memory, (rows, columns), to be written before the callback returns.

        The caller must check that ``dtype`` has the size of the pixel format and that the picture size is
        sane: Aravis multiplies width and height in 32 bits.
        """
        length = self.width_px * self.height_px * np.dtype(dtype).itemsize
        start = _aravis().arv_buffer_get_data(self.buffer, None)
        memory = memoryview((ctypes.c_char * length).from_address(start))
        return np.ndarray((self.height_px, self.width_px), dtype, memory)

    def stamp(self, timestamp_ns: int) -> None:
        """Set another timestamp for the frame."""
        _aravis().arv_buffer_set_timestamp(self.buffer, timestamp_ns)


class GvCamera:
    """A running ArvGvFakeCamera. It responds and sends from its own thread until ``close``.

    Raises BadInputError without the library or if Aravis cannot serve at ``address``.
    """

    def __init__(self, address: str, serial: str, genicam: Path) -> None:
        self._filling = threading.Lock()
        self._closing = False
        aravis = _aravis()
        self._camera: int | None = aravis.arv_gv_fake_camera_new_full(
            address.encode(), serial.encode(), str(genicam).encode()
        )
        if not aravis.arv_gv_fake_camera_is_running(self._camera):
            self.close()
            raise BadInputError(address, "Aravis cannot serve a camera there")
        self._registers: int = aravis.arv_gv_fake_camera_get_fake_camera(self._camera)

    def set_fill_callback(
        self, fill: Callable[[FrameBuffer], None], fail: Callable[[BaseException], None]
    ) -> None:
        """Let ``fill`` write each frame before it is sent, in the camera's thread.

        Exceptions cannot cross Aravis and are passed to ``fail``.
        """

        def filled(
            buffer: int, _user_data: int | None, exposure_us: int, gain_raw: int, pixel_format: int
        ) -> None:
            try:
                with self._filling:
                    if not self._closing:
                        fill(_frame_buffer(buffer, exposure_us, gain_raw, pixel_format))
            except BaseException as error:
                fail(error)

        self._callback = _FILL(filled)  # kept as long as Aravis may call it
        _aravis().arv_fake_camera_set_fill_pattern(self._registers, self._callback, None)

    def read(self, address: int) -> int:
        """Read a register, 32 bits."""
        value = c_uint32()
        _aravis().arv_fake_camera_read_register(self._registers, address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        """Write a register, 32 bits."""
        _aravis().arv_fake_camera_write_register(self._registers, address, value)

    def write_text(self, address: int, size: int, text: str) -> None:
        """Write a text of ``size`` bytes at most, the last of them 0."""
        data = text.encode()[: size - 1].ljust(size, b"\0")
        _aravis().arv_fake_camera_write_memory(self._registers, address, size, data)

    def set_trigger_poll_rate(self, times_a_second: float) -> None:
        """Set the rate at which the camera polls for a software trigger."""
        _aravis().arv_fake_camera_set_trigger_frequency(self._registers, times_a_second)

    def set_packet_loss(self, share: float) -> None:
        """Set the share of lost packets, from the frame being filled on."""
        gobject = _gobject()
        value = _GValue()
        gobject.g_value_init(ctypes.byref(value), _G_TYPE_DOUBLE)
        gobject.g_value_set_double(ctypes.byref(value), share)
        gobject.g_object_set_property(self._camera, b"gvsp-lost-ratio", ctypes.byref(value))

    def close(self) -> None:
        """Stop serving, after the frame being filled."""
        if self._camera is None:
            return
        with self._filling:  # GObject hangs if a property is set while the last reference is released
            self._closing = True
            self.set_packet_loss(1.0)  # sends no unfilled frame
        _gobject().g_object_unref(self._camera)
        self._camera = None


def _frame_buffer(buffer: int, exposure_us: int, gain_raw: int, pixel_format: int) -> FrameBuffer:
    aravis = _aravis()
    region = (c_int * 4)()
    at = (ctypes.byref(region, index * ctypes.sizeof(c_int)) for index in range(4))
    aravis.arv_buffer_get_image_region(buffer, *at)
    timestamp_ns = aravis.arv_buffer_get_timestamp(buffer)
    return FrameBuffer(buffer, timestamp_ns, exposure_us, gain_raw, pixel_format, *region)


@functools.cache
def _aravis() -> ctypes.CDLL:
    """Libaravis with its functions declared; raises BadInputError that names the Debian package."""
    library = _load(LIBRARIES[0])
    for name, result, *arguments in (
        ("gv_fake_camera_new_full", c_void_p, c_char_p, c_char_p, c_char_p),
        ("gv_fake_camera_is_running", c_bool, c_void_p),
        ("gv_fake_camera_get_fake_camera", c_void_p, c_void_p),
        ("fake_camera_set_fill_pattern", None, c_void_p, _FILL, c_void_p),
        ("fake_camera_set_trigger_frequency", None, c_void_p, c_double),
        ("fake_camera_read_register", c_bool, c_void_p, c_uint32, POINTER(c_uint32)),
        ("fake_camera_write_register", c_bool, c_void_p, c_uint32, c_uint32),
        ("fake_camera_write_memory", c_bool, c_void_p, c_uint32, c_uint32, c_char_p),
        ("buffer_get_data", c_void_p, c_void_p, POINTER(c_size_t)),
        ("buffer_get_image_region", None, c_void_p, c_void_p, c_void_p, c_void_p, c_void_p),
        ("buffer_get_timestamp", c_uint64, c_void_p),
        ("buffer_set_timestamp", None, c_void_p, c_uint64),
    ):
        function = getattr(library, f"arv_{name}")
        function.restype, function.argtypes = result, arguments
    return library


@functools.cache
def _gobject() -> ctypes.CDLL:
    """GObject, the basis of Aravis."""
    library = _load(LIBRARIES[1])
    library.g_value_init.argtypes = [POINTER(_GValue), c_size_t]
    library.g_value_init.restype = c_void_p
    library.g_value_set_double.argtypes = [POINTER(_GValue), c_double]
    library.g_object_set_property.argtypes = [c_void_p, c_char_p, POINTER(_GValue)]
    library.g_object_unref.argtypes = [c_void_p]
    return library


def _load(name: str) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise BadInputError(
            name, f"cannot be loaded; the Debian package {DEBIAN_PACKAGE} has it: {error}"
        ) from error
