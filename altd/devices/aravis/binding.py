"""Aravis behind types: the one file that knows PyGObject, which has none.

What Aravis raises comes out as CameraError or one of its kinds. A camera that does not answer blocks each
call for 2.5 s. Nothing here is for two threads at once, but for ``Stream.pop`` beside one of the others.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from altd.ports import CameraBusyError, CameraError, CameraLostError, CameraNotFoundError, CameraRefusedError

try:
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis, Gio, GLib
except (ImportError, ValueError) as error:
    raise ImportError(
        f"GigE Vision needs Aravis ({error}): sudo apt-get install python3-gi gir1.2-aravis-0.8, "
        "see docs/install.md"
    ) from error

_LOST = (
    Aravis.DeviceError.TIMEOUT,
    Aravis.DeviceError.NOT_CONNECTED,
    Aravis.DeviceError.TRANSFER_ERROR,
)
_ONE_AT_A_TIME = threading.Lock()
"""Aravis 0.8.26 crashes when two threads read a camera's description (GenICam) at once. Its own way to open a
camera has a lock against that, but holds it while it looks for a camera that is not there."""

_BUSY = (Aravis.DeviceError.NOT_CONTROLLER, Aravis.DeviceError.PROTOCOL_ERROR_ACCESS_DENIED)


_FRAMES_IN_SOCKET = 4
"""As many as net.core.rmem_max allows; a packet takes twice its size there."""


@contextmanager
def _typed(what: str) -> Iterator[None]:
    try:
        yield
    except GLib.Error as error:
        kind: type[CameraError] = CameraRefusedError
        if error.matches(Aravis.device_error_quark(), Aravis.DeviceError.NOT_FOUND):
            kind = CameraNotFoundError
        elif any(error.matches(Aravis.device_error_quark(), code) for code in _LOST):
            kind = CameraLostError
        elif any(error.matches(Aravis.device_error_quark(), code) for code in _BUSY):
            kind = CameraBusyError
        raise kind(f"{what}: {error.message}") from None


@dataclass(frozen=True, slots=True)
class Block:
    """A block of the stream. ``fault`` says what is wrong with it; it then has no data to trust.

    ``device_ns`` is the camera's own timestamp, ``realtime_ns`` that of the arrival of the first packet on
    the computer's UTC clock.
    """

    fault: str
    frame_id: int
    device_ns: int = 0
    realtime_ns: int = 0
    width: int = 0
    height: int = 0
    pixel_format: int = 0
    data: bytes = b""
    exposure_us: float | None = None
    gain: float | None = None


class Stream:
    """A running stream of blocks."""

    def __init__(self, stream: Any, chunk_parser: Any | None) -> None:
        self._stream = stream
        self._chunk_parser = chunk_parser

    def close(self) -> None:
        """Let go of it. Whoever still holds this object, in a traceback for instance, holds nothing."""
        self._stream = self._chunk_parser = None

    def pop(self, timeout_s: float) -> Block | None:
        """The oldest block not yet taken; None when none came in time. Its data are a copy."""
        buffer = self._stream.timeout_pop_buffer(max(0, round(timeout_s * 1e6)))
        if buffer is None:
            return None
        try:
            return self._block(buffer)
        finally:
            self._stream.push_buffer(buffer)

    def _block(self, buffer: Any) -> Block:
        status = buffer.get_status()
        frame_id = buffer.get_frame_id()
        if status != Aravis.BufferStatus.SUCCESS:
            return Block(status.value_nick, frame_id)
        if buffer.get_n_parts() < 1:
            return Block("no image", frame_id)
        return Block(
            "",
            frame_id,
            buffer.get_timestamp(),
            buffer.get_system_timestamp(),
            buffer.get_image_width(),
            buffer.get_image_height(),
            buffer.get_image_pixel_format(),
            buffer.get_image_data(),
            self._chunk(buffer, "ChunkExposureTime"),
            self._chunk(buffer, "ChunkGain"),
        )

    def _chunk(self, buffer: Any, name: str) -> float | None:
        if self._chunk_parser is None or not buffer.has_chunks():
            return None
        try:
            return float(self._chunk_parser.get_float_value(buffer, name))
        except GLib.Error:
            return None


class Device:
    """A GigE Vision camera that was opened, and is controlled by us when nobody else does."""

    def __init__(self, own_address: str, address: str) -> None:
        with _typed(address), _ONE_AT_A_TIME:
            self._device = Aravis.GvDevice.new(
                Gio.InetAddress.new_from_string(own_address), Gio.InetAddress.new_from_string(address)
            )
            self._camera = Aravis.Camera.new_with_device(self._device)
        self._camera.set_range_check_policy(Aravis.RangeCheckPolicy.ENABLE)
        self._camera.set_access_check_policy(Aravis.AccessCheckPolicy.ENABLE)

    def close(self) -> None:
        """Give control back and let go; with a camera that does not answer that takes seven seconds."""
        self._camera = self._device = None

    @property
    def closed(self) -> bool:
        """Whether it was let go of; nothing can be asked of it then."""
        return self._device is None

    @property
    def controlled(self) -> bool:
        """Whether we have control, as far as the last heartbeat knows; asks nobody."""
        return bool(self._device.is_controller())

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature and it can be used now."""
        with _typed(feature):
            return bool(self._camera.is_feature_available(feature))

    def choices(self, feature: str) -> tuple[str, ...]:
        """What an enumeration can be set to."""
        with _typed(feature):
            return tuple(self._camera.dup_available_enumerations_as_strings(feature))

    def text(self, feature: str) -> str:
        """The value of a text or an enumeration."""
        with _typed(feature):
            return str(self._camera.get_string(feature))

    def set(self, feature: str, value: bool | int | float | str) -> None:
        """Set any feature; a command is executed by True."""
        with _typed(feature):
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

    def bounds(self, feature: str) -> tuple[int, int]:
        """The smallest and largest value of an integer."""
        with _typed(feature):
            smallest, largest = self._camera.get_integer_bounds(feature)
            return int(smallest), int(largest)

    def pixel_format(self) -> int:
        """The PFNC code of the format that is set."""
        with _typed("PixelFormat"):
            return int(self._camera.get_pixel_format())

    def region(self) -> tuple[int, int, int, int]:
        """Offset x, y, width and height, px."""
        with _typed("region"):
            x, y, width, height = self._camera.get_region()
            return int(x), int(y), int(width), int(height)

    def set_region(self, x: int, y: int, width: int, height: int) -> None:
        """Offset and size, px, in an order that fits every region that was set before."""
        with _typed(f"region {width} x {height} at {x}, {y}"):
            self._camera.set_region(x, y, width, height)

    def payload_bytes(self) -> int:
        """The size of a frame with all that comes with it."""
        with _typed("PayloadSize"):
            return int(self._camera.get_payload())

    def frame_rate_bounds(self) -> tuple[float, float] | None:
        """In frames a second; None when the camera has no rate to set."""
        with _typed("frame rate"):
            if not self._camera.is_frame_rate_available():
                return None
            slowest, fastest = self._camera.get_frame_rate_bounds()
            return float(slowest), float(fastest)

    def run_free(self, fps: float) -> float | None:
        """Without trigger, at a rate; the rate that the camera then has, None when it has none to set."""
        with _typed("frame rate"):
            if not self._camera.is_frame_rate_available():
                self._camera.clear_triggers()
                return None
            self._camera.set_frame_rate(fps)
            return float(self._camera.get_frame_rate())

    def set_trigger(self, source: str) -> None:
        """A frame for each trigger from this source, such as ``Software`` or ``Line1``."""
        with _typed(f"trigger {source}"):
            self._camera.set_trigger(source)

    def trigger(self) -> None:
        """The software trigger."""
        with _typed("TriggerSoftware"):
            self._camera.software_trigger()

    def exposure_bounds_us(self) -> tuple[float, float] | None:
        """None when there is no exposure to set."""
        with _typed("exposure"):
            if not self._camera.is_exposure_time_available():
                return None
            shortest, longest = self._camera.get_exposure_time_bounds()
            return float(shortest), float(longest)

    def gain_bounds(self) -> tuple[float, float] | None:
        """In the camera's own unit, dB for a camera that keeps to SFNC; None when there is no gain to set."""
        with _typed("gain"):
            if not self._camera.is_gain_available():
                return None
            smallest, largest = self._camera.get_gain_bounds()
            return float(smallest), float(largest)

    def exposure_us(self) -> float:
        """The exposure that is set."""
        with _typed("exposure"):
            return float(self._camera.get_exposure_time())

    def set_exposure_us(self, exposure_us: float) -> None:
        """Raises CameraRefusedError outside of the bounds."""
        with _typed(f"exposure {exposure_us:g} us"):
            self._camera.set_exposure_time(exposure_us)

    def gain(self) -> float:
        """The gain that is set."""
        with _typed("gain"):
            return float(self._camera.get_gain())

    def set_gain(self, gain: float) -> None:
        """Raises CameraRefusedError outside of the bounds."""
        with _typed(f"gain {gain:g}"):
            self._camera.set_gain(gain)

    def manual_exposure(self) -> None:
        """Switch off the camera's own control of exposure and gain, where it has one."""
        with _typed("ExposureAuto, GainAuto"):
            if self._camera.is_exposure_auto_available():
                self._camera.set_exposure_time_auto(Aravis.Auto.OFF)
            if self._camera.is_gain_auto_available():
                self._camera.set_gain_auto(Aravis.Auto.OFF)

    def with_chunks(self) -> bool:
        """Have exposure and gain sent along with each frame; whether the camera does."""
        try:
            if not self._camera.are_chunks_available():
                return False
            offered = set(self._camera.dup_available_enumerations_as_strings("ChunkSelector"))
            wanted = sorted(offered & {"ExposureTime", "Gain"})
            if wanted:
                self._camera.set_chunks(",".join(wanted))
            return bool(wanted)
        except GLib.Error:
            return False  # what was set is then taken for what a frame has

    def packet_bytes(self) -> int:
        """The size of the stream's packets."""
        with _typed("packet size"):
            return int(self._camera.gv_get_packet_size())

    def stream(
        self, buffers: int, packet_bytes: int, resend: bool, retention_s: float, chunks: bool
    ) -> Stream:
        """Start acquisition; ``packet_bytes`` 0 finds the largest packet that gets through.

        A frame with lost packets is given up ``retention_s`` after its last packet.
        """
        with _typed("stream"):
            self._camera.set_acquisition_mode(Aravis.AcquisitionMode.CONTINUOUS)
            self._camera.gv_set_packet_size_adjustment(Aravis.GvPacketSizeAdjustment.NEVER)
            if packet_bytes:
                self._camera.gv_set_packet_size(packet_bytes)
            else:
                self._camera.gv_auto_packet_size()
            # No packet socket: where one may have it, the kernel makes its ring for up to 80 ms, and all else
            # that runs on this processor waits.
            self._camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
            stream = self._camera.create_stream(None, None)
            wanted = Aravis.GvStreamPacketResend.ALWAYS if resend else Aravis.GvStreamPacketResend.NEVER
            stream.set_property("packet-resend", wanted)
            stream.set_property("frame-retention", round(retention_s * 1e6))
            payload_bytes = self._camera.get_payload()
            stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
            stream.set_property("socket-buffer-size", _FRAMES_IN_SOCKET * payload_bytes)
            for _ in range(buffers):
                stream.push_buffer(Aravis.Buffer.new_allocate(payload_bytes))
            self._camera.start_acquisition()
            return Stream(stream, self._camera.create_chunk_parser() if chunks else None)

    def stop(self) -> None:
        """Stop acquisition."""
        with _typed("AcquisitionStop"):
            self._camera.stop_acquisition()
