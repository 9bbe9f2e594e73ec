"""One camera of the simulated unit as a GigE Vision camera."""

import struct
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from altd import __version__
from hw_sim.camera import EXPOSURE_RANGE
from hw_sim.gige.libaravis import FrameBuffer, GvCamera
from hw_sim.gige.wake_up import WakeUp
from hw_sim.lens import HEIGHT_PX, WIDTH_PX
from hw_sim.unit import EXPOSURES_MS, Unit

GENICAM = Path(__file__).with_name("genicam.xml")

PIXEL_FORMATS: Mapping[int, int] = {8: 0x01080001, 10: 0x01100003, 12: 0x01100005, 16: 0x01100007}
"""Pixel formats Mono8 to Mono16 of the Pixel Format Naming Convention, by their bits of grey."""

_BITS = {pixel_format: bits for bits, pixel_format in PIXEL_FORMATS.items()}

TRIGGER_POLL_HZ = 200.0
"""Rate at which a camera polls for a software trigger: an exposure begins up to 5 ms after it. Aravis sleeps
by whole milliseconds and spins for the rest of the last one: 10 % of a core."""

GAIN_STEPS_PER_DB = 1000

USUAL_CELSIUS = 38.0
"""Temperature inside a camera at work in a room."""

_EXPOSURES_US = round(1000 * EXPOSURE_RANGE.shortest_ms), round(1000 * EXPOSURE_RANGE.longest_ms)
_GAINS = 0, round(GAIN_STEPS_PER_DB * EXPOSURE_RANGE.largest_gain_db)

# GigE Vision's bootstrap registers: address, or address and size of a text
_VENDOR, _MODEL, _INFO, _VERSION, _USER_ID = (0x48, 32), (0x68, 32), (0xA8, 48), (0x88, 32), (0xE8, 16)

# registers of ArvFakeCamera
_WIDTH, _HEIGHT, _SENSOR_WIDTH, _SENSOR_HEIGHT = 0x100, 0x104, 0x11C, 0x118
_GAIN, _EXPOSURE_US, _PIXEL_FORMAT, _FRAME_PERIOD_US = 0x110, 0x120, 0x128, 0x138
_TRIGGER_MODE = 0x300

# registers of this camera only
_LINE1_MODE, _LINE1_SOURCE, _USER_OUTPUTS = 0x4004, 0x4014, (0x4020, 0x4024)
_TEMPERATURE = 0x4028
_OUTPUT = 1
_SOURCE_USER_OUTPUT0 = 1


class GigeCamera:
    """A camera of ``unit``, served at ``address`` until ``close``; ``fail`` is called with later errors.

    The exposure begins at the frame's timestamp and the frame is sent once it has ended. Line1 switches the
    LEDs around the camera's own target. Raises BadInputError.
    """

    def __init__(
        self, unit: Unit, name: str, address: str, bits: int, fail: Callable[[BaseException], None]
    ) -> None:
        self.serial = serial_of(unit, name)
        self.address = address
        self.frames = 0
        self._first = time.monotonic_ns() // unit.config.period_ns
        """Number of the first frame: a camera started again repeats no noise of earlier frames."""
        self._unit = unit
        self._name = name
        self._camera = GvCamera(address, self.serial, GENICAM)
        for (register, size), text in (
            (_VENDOR, "altd"),
            (_MODEL, "hw_sim"),
            (_INFO, "simulated: nothing here is live"),
            (_VERSION, __version__),
            (_USER_ID, name),
        ):
            self._camera.write_text(register, size, text)
        for register, value in (
            (_SENSOR_WIDTH, WIDTH_PX),
            (_SENSOR_HEIGHT, HEIGHT_PX),
            (_WIDTH, WIDTH_PX),
            (_HEIGHT, HEIGHT_PX),
            (_PIXEL_FORMAT, PIXEL_FORMATS[bits]),
            (_FRAME_PERIOD_US, round(unit.config.period_ns / 1000)),
            (_EXPOSURE_US, round(1000.0 * EXPOSURES_MS[name])),
            (_GAIN, 0),
            (_LINE1_MODE, _OUTPUT),
            (_LINE1_SOURCE, _SOURCE_USER_OUTPUT0),
        ):
            self._camera.write(register, value)
        self.set_temperature(USUAL_CELSIUS)
        self._camera.set_trigger_poll_rate(TRIGGER_POLL_HZ)
        self._camera.set_fill_callback(self._expose, fail)
        self._wake_up = WakeUp(address, lambda: self._camera.read(_FRAME_PERIOD_US))

    def set_temperature(self, celsius: float) -> None:
        """Set the temperature inside the camera."""
        (register,) = struct.unpack(">I", struct.pack(">f", celsius))
        self._camera.write(_TEMPERATURE, register)

    def close(self) -> None:
        """Stop serving."""
        self._wake_up.close()
        self._camera.close()

    def _expose(self, buffer: FrameBuffer) -> None:
        """Fill the frame from the unit's camera, in the time that the exposure takes."""
        unit, name = self._unit, self._name
        bits = _BITS.get(buffer.pixel_format)
        columns = slice(buffer.x_px, buffer.x_px + buffer.width_px)
        rows = slice(buffer.y_px, buffer.y_px + buffer.height_px)
        on_chip = 0 <= columns.start < columns.stop <= WIDTH_PX and 0 <= rows.start < rows.stop <= HEIGHT_PX
        if bits is None or not on_chip:
            self._camera.set_packet_loss(1.0)  # impossible on a sensor: a client wrote it into the registers
            return
        exposure_us = self._clamped(_EXPOSURE_US, buffer.exposure_us, _EXPOSURES_US)
        gain = self._clamped(_GAIN, buffer.gain_raw, _GAINS)
        unit.set_camera(
            name,
            exposure_ms=1e-3 * exposure_us,
            gain=10.0 ** (gain / GAIN_STEPS_PER_DB / 20.0),
            bits=bits,
        )
        unit.switch_leds(name, self._line1_is_high)
        begin_ns = self._begin_ns(buffer.timestamp_ns) + unit.lag_ns(name)
        buffer.stamp(begin_ns)
        begin_monotonic_ns = begin_ns - (time.time_ns() - time.monotonic_ns())
        frame = unit.expose(name, self._first + self.frames, begin_monotonic_ns + 500 * exposure_us)
        buffer.pixels(np.uint8 if bits == 8 else np.uint16)[:] = frame.pixels[rows, columns]
        lost = unit.is_silent(name) or unit.drops(name, self.frames)
        self._camera.set_packet_loss(1.0 if lost else 0.0)
        self.frames += 1
        time.sleep(max(begin_monotonic_ns + 1000 * exposure_us - time.monotonic_ns(), 0) * 1e-9)

    def _begin_ns(self, timestamp_ns: int) -> int:
        """Begin of the exposure; untriggered, it follows the sensor's crystal, not a thread's wake-up."""
        if self._camera.read(_TRIGGER_MODE):
            return timestamp_ns
        return timestamp_ns - timestamp_ns % (1000 * self._camera.read(_FRAME_PERIOD_US))

    def _clamped(self, register: int, value: int, limits: tuple[int, int]) -> int:
        """Value of a register within the camera's limits; if clamped, the register is set to it."""
        clamped = min(max(value, limits[0]), limits[1])
        if clamped != value:
            self._camera.write(register, clamped)
        return clamped

    @property
    def _line1_is_high(self) -> bool:
        camera = self._camera
        output = camera.read(_LINE1_SOURCE) - _SOURCE_USER_OUTPUT0
        return (
            camera.read(_LINE1_MODE) == _OUTPUT
            and 0 <= output < len(_USER_OUTPUTS)
            and camera.read(_USER_OUTPUTS[output]) == 1
        )


def serial_of(unit: Unit, name: str) -> str:
    """Serial number of one of a unit's cameras."""
    return f"{unit.config.serial}-{name}"
