"""GigE Vision and USB3 Vision cameras that implement the camera port.

Aravis detects a dead GigE Vision camera only after six seconds, and each request to one takes 2.5 s. The
driver therefore checks the camera itself, by single packets, as soon as frames are missing. A camera that has
dropped us or has restarted is given up and opened again at once. For one that does not answer the driver
waits, with the stream open, as long as it may still regard us as its controller, because then frames resume
automatically.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress

from altd.devices.aravis import AravisCameraSettings, gvcp
from altd.devices.aravis.binding import Device, GigeDevice, UsbCameraName, UsbDevice, usb_cameras
from altd.devices.aravis.blocks import Block
from altd.devices.aravis.device_clock import DeviceClock
from altd.devices.aravis.gvcp import DiscoveredCamera, is_address
from altd.devices.aravis.open_camera import OpenCamera, Start, frames_held, release, set_up, start_stream
from altd.devices.counting import FrameCounter
from altd.devices.pixels import PIXEL_FORMATS
from altd.devices.trigger_times import TriggerTimes
from altd.ports import (
    CameraBusyError,
    CameraError,
    CameraLostError,
    CameraMistimedError,
    CameraNotFoundError,
    CameraRefusedError,
    CameraTimeoutError,
    ExposureRange,
)
from altd.records import CameraIdentity, Frame, Origin

log = logging.getLogger("altd")

_ANSWER_TIMEOUT_S = 0.1
_MAX_DISCOVERY_TRIES = 2
_DISCOVERY_TIMEOUT_S = 0.25
_POLL_INTERVAL_S = 0.1
_SILENCE_TIMEOUT_S = 0.3
_SILENCE_TIMEOUT_PERIODS = 2.5
_FRAMELESS_TIMEOUT_S = 1.0
"""Time after which a camera that answers without sending a frame is opened again."""
_HEARTBEAT_TIMEOUT_S = 3.0
_HEARTBEAT_MARGIN_S = 0.5
_MAX_BLOCK_ID = 65535
_MAX_CAMERAS_NAMED = 8
_EXPOSURE_SETTLING_PERIODS = 2
_SIMULATED_NAMES = ("Aravis", "altd hw_sim")


class AravisCamera:
    """See ``altd.ports.Camera``; only ``switch_output`` and ``celsius`` may be called from another thread."""

    waits = False

    def __init__(
        self, name: str, settings: AravisCameraSettings, triggers: TriggerTimes | None = None
    ) -> None:
        """``triggers`` is shared by all cameras that software triggers; None: this camera has its own."""
        self.name = name
        self.origin = Origin.CAMERA
        self.playback = False
        self.identity: CameraIdentity | None = None
        self._settings = settings
        self._period_ns = round(1e9 / settings.fps)
        self._triggers = triggers or TriggerTimes(self._period_ns, round(1e6 * settings.busy_ms))
        self._opened: OpenCamera | None = None
        self._address: str | None = None
        self._outputs: dict[str, bool] = {}
        self._counter = FrameCounter(1, _MAX_BLOCK_ID)
        self._clock = DeviceClock()
        self._heartbeat_timeout_s = _HEARTBEAT_TIMEOUT_S
        self._answers = True
        self._frame_ns = 0
        self._answering_since_ns: int | None = None
        self._trigger_due_ns = 0
        self._changed_ns = self._settled_ns = 0

    @property
    def exposure_range(self) -> ExposureRange | None:
        """Range of exposure and gain; gain in dB, as SFNC requires of a camera's ``Gain``."""
        return None if self._opened is None else self._opened.exposure_range

    @property
    def automatic(self) -> tuple[str, ...]:
        """Names of automatic modes that stay on although the config does not ask for them."""
        return () if self._opened is None else self._opened.automatic

    def open(self) -> None:
        """Find the camera, take control of it, set it up and start its stream."""
        self._opened = self._connect()
        for line, on in self._outputs.items():
            self._opened.switch_output(line, on)
        self._counter.reopened()
        self._clock = DeviceClock()
        self._answers = True
        self._answering_since_ns = None
        self._frame_ns = time.monotonic_ns()
        self._trigger_due_ns = self._triggers.after(self._frame_ns)
        self._changed_ns = self._settled_ns = 0

    def _connect(self) -> OpenCamera:
        camera = self._find()
        try:
            own_address = gvcp.own_address_towards(camera.address)
        except OSError as error:
            raise CameraNotFoundError(f"{camera.address}: {error.strerror}") from None
        device = GigeDevice(own_address, camera.address)
        ours = device.controlled
        try:
            if not ours:
                raise CameraBusyError(f"{camera.id} at {camera.address}: another program controls it")
            addresses = own_address, camera.address
            opened = self._set_up(
                device, camera, lambda form: start_stream(form, device, self._settings, self.name, addresses)
            )
        except BaseException:
            release(device, None, threading.Lock(), stop=False, wait=ours)
            raise
        self._address = camera.address
        self._heartbeat_timeout_s = (
            gvcp.heartbeat_timeout_s(camera.address, _ANSWER_TIMEOUT_S) or _HEARTBEAT_TIMEOUT_S
        )
        return opened

    def _set_up(self, device: Device, camera: DiscoveredCamera | UsbCameraName, start: Start) -> OpenCamera:
        self.origin = _origin(camera, device)
        self.identity = CameraIdentity(camera.serial or None, camera.model or None, "aravis")
        opened = set_up(device, self._settings, start)
        if self._settings.trigger == "software" and (rates := device.frame_rate_limits()) is not None:
            self._triggers.lengthen(round(1e9 / rates[1]))
        return opened

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the next whole frame. Frames that lost packets are missing in ``sequence``.

        The first frames of a newly opened camera are dropped, because their times are not known yet.
        """
        opened = self._open_camera()
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            now_ns = time.monotonic_ns()
            left_s = min((deadline_ns - now_ns) * 1e-9, _POLL_INTERVAL_S)
            if self._settings.trigger == "software":
                left_s = min(left_s, self._trigger_when_due(opened, now_ns))
            try:
                block = opened.stream.pop(left_s)
            except OSError as error:
                raise CameraLostError(f"the stream's socket: {error.strerror}") from None
            if block is not None and not block.fault:
                self._frame_ns = time.monotonic_ns()
                self._answering_since_ns = None
                self._answers = True
                t_ns = self._middle_ns(block, round((opened.exposure_ms or 0.0) * 1e6))
                if self._clock.known:
                    return self._frame(opened, block, t_ns)
            if not opened.device.controlled:
                raise CameraLostError("control of the camera is lost")
            self._check_controlled(opened)
            if time.monotonic_ns() >= deadline_ns:
                raise CameraTimeoutError(f"no complete frame within {timeout_s:g} s")

    def set_exposure(self, exposure_ms: float, gain_db: float) -> None:
        """Set exposure and gain, and read back the camera's actual values."""
        opened = self._open_camera()
        if opened.exposure_range is None:
            raise CameraRefusedError("the camera has no exposure to set")
        self._changed_ns = time.monotonic_ns()
        opened.set_exposure(exposure_ms, gain_db)
        self._settled_ns = time.monotonic_ns() + _EXPOSURE_SETTLING_PERIODS * self._period_ns

    def switch_output(self, line: str, on: bool) -> None:
        """Set an output line of the camera; it is set again after each re-opening.

        From any thread; raises CameraError and, for a line that the camera does not have, CameraRefusedError.
        A camera that has just died blocks the call for 2.5 s.
        """
        self._outputs[line] = on
        self._open_camera().switch_output(line, on)

    def celsius(self) -> float | None:
        """Temperature inside the camera, °C; from any thread. None: the camera does not measure it.

        Raises CameraError. A camera that sends no frames is not read, because that might take 2.5 s.
        """
        opened = self._open_camera()
        if not self._answers or self._silent_s(time.monotonic_ns()):
            raise CameraLostError("no frames come")
        return opened.celsius()

    def close(self) -> None:
        """Stop and release the camera; takes at most a second, even if it is dead."""
        opened, self._opened = self._opened, None
        if opened is not None:
            ours = self._answers and opened.device.controlled
            release(opened.device, opened.stream, opened.lock, stop=ours, wait=ours)

    def _open_camera(self) -> OpenCamera:
        opened = self._opened
        if opened is None:
            raise CameraLostError("the camera is not open")
        return opened

    def _find(self) -> DiscoveredCamera:
        wanted = self._settings.device
        address = wanted if is_address(wanted) else self._address
        for _ in range(_MAX_DISCOVERY_TRIES):
            camera = None if address is None else gvcp.discover_at(address, _ANSWER_TIMEOUT_S)
            if camera is not None and (address == wanted or camera.has_name(wanted)):
                return camera
        if address == wanted:
            raise CameraNotFoundError(f"{wanted}: no GigE Vision camera answers there")
        there = gvcp.discover(_DISCOVERY_TIMEOUT_S)
        claims = [camera for camera in there if camera.has_name(wanted)]
        found = [camera for camera in claims if gvcp.discover_at(camera.address, _ANSWER_TIMEOUT_S) == camera]
        if len(found) > 1:
            raise CameraRefusedError(
                f"{wanted}: {len(found)} cameras have this name; use the address instead"
            )
        if not found:
            others = [f"{camera.serial} at {camera.address}" for camera in there[:_MAX_CAMERAS_NAMED]]
            if len(there) > _MAX_CAMERAS_NAMED:
                others.append(f"{len(there) - _MAX_CAMERAS_NAMED} more")
            only = f"only {', '.join(others)}" if others else "nor any other"
            raise CameraNotFoundError(f"no camera {wanted} answers, {only}")
        return found[0]

    def _check_controlled(self, opened: OpenCamera) -> None:
        """Check a camera that sends no whole frames; raises CameraLostError if it must be opened again."""
        now_ns = time.monotonic_ns()
        silent_s = self._silent_s(now_ns)
        if not silent_s or self._address is None:
            return
        privilege = gvcp.control_privilege(self._address, _ANSWER_TIMEOUT_S)
        self._answers = privilege is not None
        if privilege is None:
            self._answering_since_ns = None
            if silent_s > self._heartbeat_timeout_s + _HEARTBEAT_MARGIN_S:
                raise CameraLostError(f"the camera at {self._address} does not answer any more")
        elif privilege == 0:
            self._answers = False  # not to us: acquisition must not be stopped
            raise CameraLostError("the camera has restarted, or dropped us")
        elif self._answering_since_ns is None or opened.stream.quarantined:
            self._answering_since_ns = now_ns
        elif now_ns - self._answering_since_ns > _FRAMELESS_TIMEOUT_S * 1e9:
            self._give_up_frameless(opened, silent_s)

    def _give_up_frameless(self, opened: OpenCamera, silent_s: float) -> None:
        remark = opened.stream.remark
        if self._settings.trigger == "line" and (self._clock.known or not remark):
            return  # a signal may pause; frames of which none was ever right are said
        raise CameraLostError(
            f"the camera answers, but sent no frame for {silent_s:.1f} s{remark and f': {remark}'}"
        )

    def _silent_s(self, now_ns: int) -> float:
        """Time without a frame, s, where it is longer than expected; else 0."""
        silent_s = (now_ns - self._frame_ns) * 1e-9
        longest_s = max(_SILENCE_TIMEOUT_S, _SILENCE_TIMEOUT_PERIODS * self._period_ns * 1e-9)
        return 0.0 if silent_s < longest_s else silent_s

    def _trigger_when_due(self, opened: OpenCamera, now_ns: int) -> float:
        """Trigger the camera if due; return the time until the next trigger, s.

        A camera that does not answer is not triggered, because that would take 2.5 s. No trigger falls into
        an exposure, even after a late one: most cameras would lose it.
        """
        if now_ns >= self._trigger_due_ns:
            if self._answers and now_ns - self._trigger_due_ns < self._period_ns / 2:
                opened.trigger()
            self._trigger_due_ns = self._triggers.after(now_ns + round(1e6 * (opened.exposure_ms or 0.0)))
        return max(0.0, (self._trigger_due_ns - time.monotonic_ns()) * 1e-9)

    def _frame(self, opened: OpenCamera, block: Block, t_ns: int | None) -> Frame:
        sequence = self._counter.number((block.frame_id - 1) % _MAX_BLOCK_ID + 1)
        if t_ns is None:
            late = "frames are delayed, or the camera's clock was set back"
            raise CameraMistimedError(sequence, f"exposure {sequence} came late: {late}")
        of, width = PIXEL_FORMATS[self._settings.pixel_format], self._settings.width
        return Frame(
            self.name,
            sequence,
            t_ns,
            of.pixels(block.data or b"", width, self._settings.height, of.line_bytes(width)),
            of.bits,
            exposure_ms=opened.exposure_ms,
            gain_db=opened.gain_db,
            changing=self._changed_ns <= t_ns < self._settled_ns,
            row_time_us=self._settings.row_time_us,
        )

    def _middle_ns(self, block: Block, exposure_ns: int) -> int | None:
        """Middle of the exposure: the camera stamps its start, and the first packet leaves at its end.

        A camera that stamps another instant is mapped as well: only the arrival relates its clock to ours.
        None where the time is unknown.
        """
        trusted = self._clock.trusted
        start_ns = self._clock.host_ns(block.device_ns, block.arrived_ns - exposure_ns)
        if trusted and not self._clock.trusted:
            log.warning("camera %s: its clock is not plausible; frames are stamped on arrival", self.name)
        return (
            None
            if start_ns is None
            else start_ns + (exposure_ns + round(self._settings.readout_ms * 1e6)) // 2
        )


class UsbCamera(AravisCamera):
    """A USB3 Vision camera."""

    def _connect(self) -> OpenCamera:
        there, wanted = usb_cameras(), self._settings.device
        found = [camera for camera in there if wanted in (camera.id, camera.serial)]
        if len(found) != 1:
            others = ", ".join(camera.serial or camera.id for camera in there) or "none"
            number = f"{len(found)} USB3 Vision cameras are" if found else "no USB3 Vision camera is"
            raise CameraNotFoundError(f"{number} {wanted}; connected and open to us: {others}")
        device, frames = UsbDevice(found[0].id), frames_held(self._settings)
        try:
            return self._set_up(device, found[0], lambda form: device.start(form, frames))
        except BaseException:
            release(device, None, threading.Lock(), stop=False, wait=True)
            raise

    def _check_controlled(self, opened: OpenCamera) -> None:
        if not (silent_s := self._silent_s(time.monotonic_ns())):
            return
        try:
            with opened.lock:
                opened.device.region()
        except CameraError as error:
            self._answers = False
            raise CameraLostError(f"the camera does not answer any more: {error}") from None
        if silent_s > _FRAMELESS_TIMEOUT_S:
            self._give_up_frameless(opened, silent_s)


def _origin(camera: DiscoveredCamera | UsbCameraName, device: Device) -> Origin:
    names = [f"{camera.vendor} {camera.model}"]
    with suppress(CameraError):
        names.append(f"{device.text('DeviceVendorName')} {device.text('DeviceModelName')}")
    return Origin.SIMULATED if any(name.startswith(_SIMULATED_NAMES) for name in names) else Origin.CAMERA
