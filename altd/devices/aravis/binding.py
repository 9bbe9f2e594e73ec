"""Typed wrapper of Aravis: the only file that uses PyGObject, which has no types.

Aravis' errors are raised as CameraError or one of its subclasses. A camera that does not answer blocks each
call for 2.5 s. Nothing here is thread-safe. Frames of GigE Vision do not pass through Aravis: altd receives
them itself (stream.py).
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from altd.devices.aravis import remedy_of
from altd.devices.aravis.blocks import REMEDY, Block, StreamFormat
from altd.devices.aravis.packets import filter_new_sockets, open_sockets
from altd.ports import CameraBusyError, CameraError, CameraLostError, CameraNotFoundError, CameraRefusedError

try:
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis, Gio, GLib
except (ImportError, ValueError) as error:
    raise ImportError(
        f"this camera needs Aravis ({error}): {remedy_of(error)}, see docs/cameras.md"
    ) from error

_LOST_CODES = (
    Aravis.DeviceError.TIMEOUT,
    Aravis.DeviceError.NOT_CONNECTED,
    Aravis.DeviceError.TRANSFER_ERROR,
)
_GENICAM_LOCK = threading.Lock()
"""Aravis 0.8.26 crashes when two threads read a camera's description (GenICam) at once. Its own function to
open a camera has a lock against that, but holds it while it searches for a camera that does not exist."""

# bootstrap registers of stream channel 0 (GigE Vision 2.0, section 28): SCP0, SCDA0, SCSP0
_HOST_PORT, _DESTINATION_ADDRESS, _SOURCE_PORT = 0x0D00, 0x0D18, 0x0D1C

_MAX_AGE_NS = 1_000_000_000
"""Time since the leader above which the time of day, by which Aravis stamps it, was set meanwhile."""
_BUSY_CODES = (Aravis.DeviceError.NOT_CONTROLLER, Aravis.DeviceError.PROTOCOL_ERROR_ACCESS_DENIED)


@contextmanager
def _typed_errors(what: str) -> Iterator[None]:
    try:
        yield
    except GLib.Error as error:
        kind: type[CameraError] = CameraRefusedError
        if error.matches(Aravis.device_error_quark(), Aravis.DeviceError.NOT_FOUND):
            kind = CameraNotFoundError
        elif any(error.matches(Aravis.device_error_quark(), code) for code in _LOST_CODES):
            kind = CameraLostError
        elif any(error.matches(Aravis.device_error_quark(), code) for code in _BUSY_CODES):
            kind = CameraBusyError
        raise kind(f"{what}: {error.message}") from None


class Device:
    """An open camera with the features of GenICam, on any interface."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._camera = Aravis.Camera.new_with_device(device)
        self._camera.set_range_check_policy(Aravis.RangeCheckPolicy.ENABLE)
        self._camera.set_access_check_policy(Aravis.AccessCheckPolicy.ENABLE)

    def close(self) -> None:
        """Give up control and release the camera; this takes seven seconds if it does not answer."""
        self._camera = self._device = None

    @property
    def closed(self) -> bool:
        """Whether the camera was released; then it cannot be used."""
        return self._device is None

    @property
    def controlled(self) -> bool:
        """Whether we have control, as far as it is known without a request."""
        return True

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature that can be used now."""
        with _typed_errors(feature):
            return bool(self._camera.is_feature_available(feature))

    def choices(self, feature: str) -> tuple[str, ...]:
        """Values of an enumeration."""
        with _typed_errors(feature):
            return tuple(self._camera.dup_available_enumerations_as_strings(feature))

    def text(self, feature: str) -> str:
        """Value of a text or an enumeration."""
        with _typed_errors(feature):
            return str(self._camera.get_string(feature))

    def number(self, feature: str) -> float:
        """Value of a number with a fraction."""
        with _typed_errors(feature):
            return float(self._camera.get_float(feature))

    def set(self, feature: str, value: bool | int | float | str) -> None:
        """Set a feature of any type; True executes a command."""
        with _typed_errors(feature):
            node = self._device.get_feature(feature)
            if node is None:
                raise CameraRefusedError(f"{feature}: the camera has no such feature")
            if isinstance(node, Aravis.GcCommand):
                if value is True:
                    self._camera.execute_command(feature)
            elif isinstance(value, bool):
                self._camera.set_boolean(feature, value)
            elif isinstance(value, str):
                self._camera.set_string(feature, value)
            elif isinstance(node, Aravis.GcFloat):
                self._camera.set_float(feature, value)
            else:
                self._camera.set_integer(feature, int(value))

    def integer_limits(self, feature: str) -> tuple[int, int]:
        """Minimum and maximum of an integer."""
        with _typed_errors(feature):
            smallest, largest = self._camera.get_integer_bounds(feature)
            return int(smallest), int(largest)

    def pixel_format(self) -> int:
        """PFNC code of the current format."""
        with _typed_errors("PixelFormat"):
            return int(self._camera.get_pixel_format())

    def region(self) -> tuple[int, int, int, int]:
        """Offset x, y, width and height, px."""
        with _typed_errors("region"):
            x, y, width, height = self._camera.get_region()
            return int(x), int(y), int(width), int(height)

    def set_region(self, x: int, y: int, width: int, height: int) -> None:
        """Set offset and size, px, in an order that is valid from every previous region."""
        with _typed_errors(f"region {width} x {height} at {x}, {y}"):
            self._camera.set_region(x, y, width, height)

    def payload_bytes(self) -> int:
        """Size of a frame with all accompanying data, bytes."""
        with _typed_errors("PayloadSize"):
            return int(self._camera.get_payload())

    def frame_rate_limits(self) -> tuple[float, float] | None:
        """Minimum and maximum frame rate, frames/s; None when the camera has no rate to set."""
        with _typed_errors("frame rate"):
            if not self._camera.is_frame_rate_available():
                return None
            slowest, fastest = self._camera.get_frame_rate_bounds()
            return float(slowest), float(fastest)

    def run_free(self, fps: float) -> float | None:
        """Run without trigger at a rate; return the camera's actual rate, None when it has none to set."""
        with _typed_errors("frame rate"):
            if not self._camera.is_frame_rate_available():
                self._camera.clear_triggers()
                return None
            self._camera.set_frame_rate(fps)
            return float(self._camera.get_frame_rate())

    def set_trigger(self, source: str) -> None:
        """Take a frame for each trigger from this source, such as ``Software`` or ``Line1``."""
        with _typed_errors(f"trigger {source}"):
            self._camera.set_trigger(source)

    def trigger(self) -> None:
        """Execute the software trigger."""
        with _typed_errors("TriggerSoftware"):
            self._camera.software_trigger()

    def exposure_limits_us(self) -> tuple[float, float] | None:
        """Minimum and maximum exposure, µs; None when there is no exposure to set."""
        with _typed_errors("exposure"):
            if not self._camera.is_exposure_time_available():
                return None
            shortest, longest = self._camera.get_exposure_time_bounds()
            return float(shortest), float(longest)

    def gain_limits(self) -> tuple[float, float] | None:
        """Limits of the gain in the camera's unit (SFNC: dB); None when there is no gain to set."""
        with _typed_errors("gain"):
            if not self._camera.is_gain_available():
                return None
            smallest, largest = self._camera.get_gain_bounds()
            return float(smallest), float(largest)

    def exposure_us(self) -> float:
        """Current exposure, µs."""
        with _typed_errors("exposure"):
            return float(self._camera.get_exposure_time())

    def set_exposure_us(self, exposure_us: float) -> None:
        """Set the exposure; raises CameraRefusedError outside of the limits."""
        with _typed_errors(f"exposure {exposure_us:g} us"):
            self._camera.set_exposure_time(exposure_us)

    def gain(self) -> float:
        """Current gain, in the camera's unit."""
        with _typed_errors("gain"):
            return float(self._camera.get_gain())

    def set_gain(self, gain: float) -> None:
        """Set the gain; raises CameraRefusedError outside of the limits."""
        with _typed_errors(f"gain {gain:g}"):
            self._camera.set_gain(gain)

    def without_chunks(self) -> None:
        """Switch off chunk data in frames, which another program may have left on."""
        with _typed_errors("ChunkModeActive"):
            if self._camera.are_chunks_available():
                self._camera.set_chunk_mode(False)

    def stop(self) -> None:
        """Stop acquisition."""
        with _typed_errors("AcquisitionStop"):
            self._camera.stop_acquisition()


class GigeDevice(Device):
    """An open GigE Vision camera, controlled by us unless another program controls it."""

    def __init__(self, own_address: str, address: str) -> None:
        self._own_address = int.from_bytes(socket.inet_aton(own_address), "big")
        with _typed_errors(address), _GENICAM_LOCK:
            before = open_sockets()
            device = Aravis.GvDevice.new(
                Gio.InetAddress.new_from_string(own_address), Gio.InetAddress.new_from_string(address)
            )
            filter_new_sockets(before, own_address, address)  # its control socket accepts any sender
            super().__init__(device)

    @property
    def controlled(self) -> bool:
        """Whether we have control, according to the last heartbeat; sends nothing."""
        return bool(self._device.is_controller())

    def ticks_per_s(self) -> int:
        """Frequency of the clock that stamps frames, Hz; 0 for a camera that has none."""
        return int(self._device.get_timestamp_tick_frequency())

    def settle_packet_size(self, packet_bytes: int) -> int:
        """Set the size of the stream's packets, all headers included; 0 finds the largest that gets through.

        Returns the camera's actual size, bytes.
        """
        with _typed_errors("packet size"):
            if packet_bytes:
                self._camera.gv_set_packet_size(packet_bytes)
            else:
                self._camera.gv_auto_packet_size()
            return int(self._camera.gv_get_packet_size())

    def start(self, port: int) -> int:
        """Start acquisition, frames to our ``port``; return their source port, 0 if not reported."""
        with _typed_errors("stream"):
            self._camera.set_acquisition_mode(Aravis.AcquisitionMode.CONTINUOUS)
            self._device.write_register(_DESTINATION_ADDRESS, self._own_address)
            self._device.write_register(_HOST_PORT, port)
            try:
                source_port = self._device.read_register(_SOURCE_PORT) & 0xFFFF
            except GLib.Error:
                source_port = 0  # the register is optional
            self._camera.start_acquisition()
            return int(source_port)


class UsbCameraName(NamedTuple):
    """A connected USB3 Vision camera."""

    id: str
    vendor: str
    model: str
    serial: str


def usb_cameras() -> list[UsbCameraName]:
    """Return the connected USB3 Vision cameras that this user may open."""
    with _GENICAM_LOCK:
        Aravis.disable_interface("GigEVision")  # altd searches these itself
        Aravis.update_device_list()
        about = Aravis.get_device_id, Aravis.get_device_vendor, Aravis.get_device_model
        names = (*about, Aravis.get_device_serial_nbr)
        return [UsbCameraName(*(of(n) or "" for of in names)) for n in range(Aravis.get_n_devices())]


class UsbDevice(Device):
    """An open USB3 Vision camera, and its stream: Aravis receives the frames."""

    quarantined = False

    def __init__(self, name: str) -> None:
        self.remark = ""
        self._stream: Any = None
        with _typed_errors(name), _GENICAM_LOCK:
            super().__init__(Aravis.open_device(name))

    def start(self, form: StreamFormat, frames: int) -> UsbDevice:
        """Start acquisition of frames of this format, with space for some; return the stream."""
        with _typed_errors("stream"):
            self._camera.set_acquisition_mode(Aravis.AcquisitionMode.CONTINUOUS)
            self._format, self._stream = form, self._camera.create_stream(None, None)
            for _ in range(frames):
                self._stream.push_buffer(Aravis.Buffer.new_allocate(form.payload_bytes))
            self._camera.start_acquisition()
        return self

    def pop(self, timeout_s: float) -> Block | None:
        """Return the next frame, or None on timeout. ``arrived_ns`` is when its leader came."""
        buffer = self._stream.timeout_pop_buffer(max(0, round(timeout_s * 1e6)))
        if buffer is None:
            return None
        age_ns = time.time_ns() - buffer.get_system_timestamp()
        arrived_ns = time.monotonic_ns() - (age_ns if 0 <= age_ns < _MAX_AGE_NS else 0)
        self.remark = self._fault(buffer)
        data = None if self.remark else memoryview(buffer.get_data())[: self._format.image_bytes]
        block = Block(self.remark, buffer.get_frame_id(), buffer.get_timestamp(), arrived_ns, data)
        self._stream.push_buffer(buffer)
        return block

    def close(self) -> None:
        """End the stream and release the camera; harmless if it is closed."""
        self._stream = None
        super().close()

    def _fault(self, buffer: Any) -> str:
        if buffer.get_status() != Aravis.BufferStatus.SUCCESS:
            return f"frames are not whole ({buffer.get_status().value_nick})"
        if buffer.get_payload_type() != Aravis.BufferPayloadType.IMAGE or buffer.has_chunks():
            return f"sends other payloads than images: {REMEDY}"
        *_, width, height = buffer.get_image_region()
        form, pixel_format = self._format, buffer.get_image_pixel_format()
        is_padded = any(buffer.get_image_padding()) or len(buffer.get_data()) < form.image_bytes
        if is_padded or (pixel_format, width, height) != (form.pixel_format, form.width, form.height):
            return f"sends {width} x {height} in format {pixel_format:#x}, and was not set to that"
        return ""
