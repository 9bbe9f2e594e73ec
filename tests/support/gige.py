"""Aravis' simulated GigE Vision camera as a process, and a thread that grabs as the service does."""

from __future__ import annotations

import functools
import os
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar

from altd.devices.aravis import AravisCameraSettings
from altd.ports import CameraError, CameraTimeoutError
from altd.records import Frame

if TYPE_CHECKING:
    from altd.devices.aravis.driver import AravisCamera

HOME = "127.0.0.1"
DYING_WITH_US = ("setpriv", "--pdeathsig", "KILL")
"""A test run that crashes leaves no camera behind."""
Result = TypeVar("Result")
RETRY_S = 0.2
_LONGEST_RETRY_S = 0.5


def driver(name: str = "front", device: str = HOME, **settings: object) -> AravisCamera:
    """The driver with the config's defaults but for ``settings``."""
    from altd.devices.aravis.driver import AravisCamera  # which a bare machine cannot import

    return AravisCamera(
        name, AravisCameraSettings.model_validate({"driver": "aravis", "device": device, **settings})
    )


def register(address: str, number: int, value: int | None = None) -> int | None:
    """Read, or write, a register of a camera, independently of the code under test; None: not answered."""
    payload = struct.pack(">I", number) if value is None else struct.pack(">II", number, value)
    command = 0x80 if value is None else 0x82
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(0.5)
        asking.sendto(struct.pack(">HHHH", 0x4201, command, len(payload), 7) + payload, (address, 3956))
        try:
            return int.from_bytes(asking.recv(64)[8:12], "big")
        except (TimeoutError, ConnectionError):
            return None


def wait_for(what: Callable[[], bool], within_s: float = 20.0) -> None:
    """Until it is so; fails the test when it does not become so."""
    deadline = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < deadline, "not within time"
        time.sleep(0.005)


class Cameras:
    """Processes of ``arv-fake-gv-camera-0.8``, one an address."""

    def __init__(self) -> None:
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, address: str = HOME, serial: str = "T1", *options: str, wait: bool = True) -> None:
        command = [*DYING_WITH_US, "arv-fake-gv-camera-0.8", "-i", address, "-s", serial, *options]
        self._processes[address] = subprocess.Popen(command)
        if wait:
            wait_for(lambda: register(address, 0) is not None)

    def start_with(self, features: str, folder: Path, address: str = HOME) -> None:
        """One whose own description (GenICam) has further features, in its spare registers."""
        path = folder / "camera.xml"
        path.write_text(_described(_own_description(), features))
        self.start(address, "T1", "-g", str(path))

    def kill(self, address: str = HOME) -> None:
        process = self._processes.pop(address)
        process.kill()
        process.wait()

    def stop(self, address: str = HOME) -> None:
        os.kill(self._processes[address].pid, signal.SIGSTOP)

    def go_on(self, address: str = HOME) -> None:
        os.kill(self._processes[address].pid, signal.SIGCONT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for address in list(self._processes):
            self.kill(address)


@functools.cache
def _own_description() -> str:
    with Cameras() as cameras:
        cameras.start()
        tool = ["arv-tool-0.8", "-a", HOME, "genicam"]
        told = subprocess.run(tool, capture_output=True, text=True, check=True).stdout
    return told[told.index("<?xml") :]


def _described(description: str, features: str) -> str:
    end = '<Port Name="Device"'
    assert end in description
    grey = '<EnumEntry Name="Mono16"'
    more_greys = (
        '<EnumEntry Name="Mono10"><Value>17825795</Value></EnumEntry>'
        '<EnumEntry Name="Mono12"><Value>17825797</Value></EnumEntry>'
        '<EnumEntry Name="Mono12Packed"><Value>17563654</Value></EnumEntry>'
    )
    return description.replace(end, features + end).replace(grey, more_greys + grey)


@dataclass
class Grabbed:
    """Frames as a camera's thread in the service gets them: what fails is closed and opened again."""

    camera: AravisCamera
    frames: list[tuple[int, Frame]] = field(default_factory=list)
    """With the instant of delivery, monotonic ns."""
    errors: list[CameraError] = field(default_factory=list)
    longest_call_s: float = 0.0
    stopping: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._run, name="grabbing")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self._thread.join()

    def await_frames(self, count: int, within_s: float = 20.0) -> None:
        """Until so many further frames have come."""
        wanted = len(self.frames) + count
        wait_for(lambda: len(self.frames) >= wanted, within_s)

    def back_after_s(self, since_ns: int, within_s: float = 20.0) -> float:
        """The delay of the first frame's exposure and delivery after an instant."""
        wait_for(lambda: bool(self.frames) and self.frames[-1][1].t_ns > since_ns, within_s)
        return (next(at for at, frame in self.frames if frame.t_ns > since_ns) - since_ns) * 1e-9

    def _run(self) -> None:
        retry_s = RETRY_S
        while not self.stopping.is_set():
            try:
                self._timed(self.camera.open)
                while not self.stopping.is_set():
                    try:
                        frame = self._timed(lambda: self.camera.next_frame(0.25))
                    except CameraTimeoutError:
                        continue
                    self.frames.append((time.monotonic_ns(), frame))
                    retry_s = RETRY_S
            except CameraError as error:
                self.errors.append(error)
            finally:
                self._timed(self.camera.close)
            self.stopping.wait(retry_s)
            retry_s = min(2 * retry_s, _LONGEST_RETRY_S)

    def _timed(self, call: Callable[[], Result]) -> Result:
        began_s = time.monotonic()
        try:
            return call()
        finally:
            self.longest_call_s = max(self.longest_call_s, time.monotonic() - began_s)
