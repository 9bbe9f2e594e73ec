"""An open camera: its set-up, its output line, its release; and discovery of cameras."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

from altd.devices.aravis import PIXEL_FORMAT_NAMES, AravisCameraSettings, gvcp
from altd.devices.aravis.binding import Device, GigeDevice, UsbDevice
from altd.devices.aravis.blocks import RETENTION_NS, Assembler, StreamFormat
from altd.devices.aravis.gvcp import DiscoveredCamera
from altd.devices.aravis.packets import PacketSocket
from altd.devices.aravis.stream import Stream
from altd.devices.pixels import PIXEL_FORMATS
from altd.ports import CameraError, CameraLostError, CameraRefusedError, ExposureRange

_MAX_RATE_ERROR = 0.02
MIN_PACKET_BYTES, MAX_PACKET_BYTES = 576, 16404
"""Limits of the packet size: GigE Vision demands 576 of every camera; Ethernet frames have little over
9000."""
_SOCKET_BUFFER_FRAMES = 4
"""Frames in the socket's buffer besides those of a stall, as far as net.core.rmem_max allows; a packet takes
twice its size there."""
_STALL_S = 0.25
"""Longest delay of the process, as by another program, that loses no frame."""
_RELEASE_TIMEOUT_S = 1.0
_TEMPERATURE = "DeviceTemperature"
_EXPOSURE_MODES, _OFF = ("ExposureAuto", "GainAuto"), "Off"


@dataclass(slots=True)
class OpenCamera:
    """Objects of an open camera. ``lock`` guards every use of the device except the stream's."""

    device: Device
    stream: Stream | UsbDevice
    exposure_range: ExposureRange | None
    has_gain: bool
    exposure_ms: float | None
    gain_db: float | None
    automatic: tuple[str, ...] = ()
    """Automatic modes that stay on although the config does not ask for them."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Set exposure and gain, and read back the camera's actual values."""
        with self.lock:
            self.device.set_exposure_us(exposure_ms * 1e3)
            self.exposure_ms = self.device.exposure_us() * 1e-3
            if self.has_gain:
                self.device.set_gain(gain_db)
                self.gain_db = self.device.gain()

    def switch_output(self, line: str, on: bool) -> None:
        """Make ``line`` an output that follows a user output, and set that output."""
        with self.lock:
            if self.device.closed:  # by the camera's thread, while this one waited
                raise CameraLostError("the camera was closed")
            _switch_output(self.device, line, on)

    def celsius(self) -> float | None:
        """``DeviceTemperature`` (SFNC, chapter 3) of the selected location, °C; None: the camera has none."""
        with self.lock:
            if self.device.closed:  # by the camera's thread, while this one waited
                raise CameraLostError("the camera was closed")
            return self.device.number(_TEMPERATURE) if self.device.has(_TEMPERATURE) else None

    def trigger(self) -> None:
        """Execute the software trigger."""
        with self.lock:
            self.device.trigger()


Start = Callable[[StreamFormat], Stream | UsbDevice]
"""Starts the stream of frames of a format."""


def set_up(device: Device, settings: AravisCameraSettings, start: Start) -> OpenCamera:
    """Set the camera up and start its stream; raises CameraRefusedError that lists what the camera offers."""
    with suppress(CameraRefusedError):  # the last controller may have died during acquisition
        device.stop()
    for name, value in settings.features.items():
        device.set(name, value)
    _set_format(device, settings.pixel_format, settings.width)
    _set_region(device, settings)
    _set_trigger(device, settings)
    for mode in automatic_modes(device, settings):
        with suppress(CameraRefusedError):
            device.set(mode, _OFF)
    automatic = automatic_modes(device, settings)
    exposure_us, gain = device.exposure_limits_us(), device.gain_limits()
    device.without_chunks()
    known = settings.exposure.control != "camera" and not {*automatic} & {*_EXPOSURE_MODES}
    exposure_ms = device.exposure_us() * 1e-3 if known and exposure_us is not None else None
    gain_db = device.gain() if known and gain is not None else None
    image_bytes = settings.height * PIXEL_FORMATS[settings.pixel_format].line_bytes(settings.width)
    size = settings.width, settings.height
    stream = start(StreamFormat(*size, device.pixel_format(), image_bytes, device.payload_bytes()))
    exposure_range = _exposure_range(exposure_us, gain)
    return OpenCamera(device, stream, exposure_range, gain is not None, exposure_ms, gain_db, automatic)


def automatic_modes(device: Device, settings: AravisCameraSettings) -> tuple[str, ...]:
    """Automatic modes (SFNC) that are on although the config does not ask for them."""
    modes: tuple[str, ...] = () if settings.exposure.control == "camera" else _EXPOSURE_MODES
    if "BalanceWhiteAuto" not in settings.features:
        modes += ("BalanceWhiteAuto",)
    return tuple(mode for mode in modes if device.has(mode) and device.text(mode) != _OFF)


def frames_held(settings: AravisCameraSettings) -> int:
    """Number of frames to hold while the process is delayed."""
    return _SOCKET_BUFFER_FRAMES + math.ceil(settings.fps * _STALL_S)


def start_stream(
    form: StreamFormat,
    device: GigeDevice,
    settings: AravisCameraSettings,
    camera: str,
    addresses: tuple[str, str],
) -> Stream:
    """Start the stream of a GigE Vision camera between ``addresses``, our own and the camera's."""
    own_address, address = addresses
    packet_bytes = device.settle_packet_size(settings.packet_bytes)
    if not MIN_PACKET_BYTES <= packet_bytes <= MAX_PACKET_BYTES:
        raise CameraRefusedError(f"packets of {packet_bytes} bytes: {MIN_PACKET_BYTES} to {MAX_PACKET_BYTES}")
    buffer_bytes = frames_held(settings) * form.image_bytes
    try:
        receiving = PacketSocket(own_address, address, packet_bytes, buffer_bytes)
    except OSError as error:
        raise CameraLostError(f"{own_address}: {error.strerror}") from None
    try:
        source_port = device.start(receiving.port)
    except BaseException:
        receiving.close()
        raise
    assembler = Assembler(
        replace(form, packet_bytes=packet_bytes, ticks_per_s=device.ticks_per_s()),
        max_open=_SOCKET_BUFFER_FRAMES + math.ceil(settings.fps * RETENTION_NS * 1e-9),
        resend=settings.resend,
        source_port=source_port,
    )
    return Stream(camera, receiving, assembler, address)


def release(
    device: Device, stream: Stream | UsbDevice | None, lock: threading.Lock, stop: bool, wait: bool
) -> None:
    """Release a camera in a thread of its own, because one that does not answer takes seven seconds.

    This returns control, without effect when it is no longer ours: a controller is identified by its port.
    ``wait`` gives a camera that answers the time to receive this.
    """

    def release() -> None:
        with lock:
            if stop:
                with suppress(CameraError):
                    device.stop()
            if stream is not None:
                stream.close()
            device.close()

    thread = threading.Thread(target=release, name="aravis-release", daemon=True)
    thread.start()
    if wait:
        thread.join(_RELEASE_TIMEOUT_S)


def _set_format(device: Device, wanted: str, width: int) -> None:
    try:
        PIXEL_FORMATS[wanted].line_bytes(width)
    except ValueError as error:
        raise CameraRefusedError(str(error)) from None
    offered = device.choices("PixelFormat")
    if wanted not in offered:
        fit = [name for name in offered if name in PIXEL_FORMAT_NAMES]
        raise CameraRefusedError(
            f"pixel_format {wanted}: the camera offers {', '.join(fit or offered) or 'none'}"
        )
    device.set("PixelFormat", wanted)


def _set_region(device: Device, settings: AravisCameraSettings) -> None:
    wanted = settings.offset_x_px, settings.offset_y_px, settings.width, settings.height
    try:
        device.set_region(*wanted)
        refused = device.region() != wanted
    except CameraRefusedError:
        refused = True
    if refused:
        device.set_region(0, 0, 0, 0)  # offsets back to zero: the limits of the size depend on them
        (w_min, w_max), (h_min, h_max) = device.integer_limits("Width"), device.integer_limits("Height")
        size = f"{settings.width} x {settings.height} at {settings.offset_x_px}, {settings.offset_y_px}"
        raise CameraRefusedError(
            f"{size}: the camera offers {w_min} to {w_max} x {h_min} to {h_max}, "
            "offset included, in its own steps"
        )


def _set_trigger(device: Device, settings: AravisCameraSettings) -> None:
    if settings.trigger == "free":
        _set_rate(device, settings.fps)
        return
    source = "Software" if settings.trigger == "software" else settings.trigger_line
    offered = device.choices("TriggerSource") if device.has("TriggerSource") else ()
    if source not in offered:
        raise CameraRefusedError(f"trigger from {source}: the camera offers {', '.join(offered) or 'none'}")
    device.set_trigger(source)


def _set_rate(device: Device, fps: float) -> None:
    limits = device.frame_rate_limits()
    if limits is not None and not limits[0] <= fps <= limits[1]:
        raise CameraRefusedError(f"fps {fps:g}: the camera offers {limits[0]:g} to {limits[1]:g}")
    actual = device.run_free(fps)
    if actual is not None and abs(actual - fps) > _MAX_RATE_ERROR * fps:
        raise CameraRefusedError(f"fps {fps:g}: the camera makes it {actual:g}")


def _exposure_range(
    exposure_us: tuple[float, float] | None, gain: tuple[float, float] | None
) -> ExposureRange | None:
    if exposure_us is None:
        return None
    smallest, largest = gain or (0.0, 0.0)
    return ExposureRange(exposure_us[0] * 1e-3, exposure_us[1] * 1e-3, smallest, largest)


def _switch_output(device: Device, line: str, on: bool) -> None:
    """Switch an output (SFNC, chapter 8, digital I/O control); cameras vary in the features they have."""
    if not device.has("UserOutputValue"):
        raise CameraRefusedError("the camera has no UserOutputValue, thus no output to switch")
    if device.has("LineSelector"):
        _set_choice(device, "LineSelector", line)
    if device.has("LineMode") and device.text("LineMode") != "Output":
        _set_choice(device, "LineMode", "Output")
    output = None
    if device.has("LineSource"):
        output = device.text("LineSource")
        if not output.startswith("UserOutput"):
            output = _user_output(device.choices("LineSource"), line)
            device.set("LineSource", output)
    if device.has("UserOutputSelector"):
        offered = device.choices("UserOutputSelector")
        device.set("UserOutputSelector", output if output in offered else _user_output(offered, line))
    device.set("UserOutputValue", on)


def _user_output(offered: tuple[str, ...], line: str) -> str:
    """User output with the line's number, else the first one."""
    outputs = [name for name in offered if name.startswith("UserOutput")]
    number = line.removeprefix("Line")
    if not outputs:
        raise CameraRefusedError(
            f"{line}: the camera offers no user output, but {', '.join(offered) or 'none'}"
        )
    return f"UserOutput{number}" if f"UserOutput{number}" in outputs else outputs[0]


def _set_choice(device: Device, feature: str, wanted: str) -> None:
    offered = device.choices(feature)
    if wanted not in offered:
        raise CameraRefusedError(f"{feature} {wanted}: the camera offers {', '.join(offered) or 'none'}")
    device.set(feature, wanted)


_DISCOVERY_TIMEOUT_S = 0.5
_ANSWER_TIMEOUT_S = 0.2


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera with its names for the config: serial number, address or id.

    ``in_use``: a program controls it, or it does not report this. Its formats are then not known, because
    they are read from an open camera, and Aravis takes control of one that it opens. ``formats`` holds those
    that altd can use; None: not known.
    """

    id: str
    vendor: str
    model: str
    serial: str
    address: str
    in_use: bool
    formats: tuple[str, ...] | None


def find_cameras() -> list[FoundCamera]:
    """Return all cameras that answer within half a second, by address; opens uncontrolled ones briefly."""
    return [_examined(camera) for camera in gvcp.discover(_DISCOVERY_TIMEOUT_S)]


def _examined(camera: DiscoveredCamera) -> FoundCamera:
    in_use = gvcp.control_privilege(camera.address, _ANSWER_TIMEOUT_S) != 0
    formats = None
    if not in_use:
        with suppress(CameraError, OSError):
            device = GigeDevice(gvcp.own_address_towards(camera.address), camera.address)
            try:
                formats = tuple(name for name in device.choices("PixelFormat") if name in PIXEL_FORMAT_NAMES)
            finally:
                device.close()
    return FoundCamera(camera.id, camera.vendor, camera.model, camera.serial, camera.address, in_use, formats)
