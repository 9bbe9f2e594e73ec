"""Inclinometers on a pseudo-terminal with Modbus RTU: Balluff BSI R11A0, WitMotion WT901C485, and a fine one.

They turn with ``roll_deg`` and ``pitch_deg``, have noise and a temperature, and can simulate faults.
"""

from __future__ import annotations

import math
import os
import random
import select
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Self

from hw_sim.plugged_port import PluggedPort

HOLDING, INPUT = 3, 4
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
_REQUEST_BYTES = 8
_WAIT_S = 0.05

Registers = dict[tuple[int, int], int]
"""Register values by (function, address)."""


def crc(data: bytes) -> bytes:
    """CRC-16 of Modbus, low byte first (Modbus over Serial Line V1.02, 6.2.2)."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xA001 if register & 1 else 0)
    return struct.pack("<H", register)


class Inclinometer:
    """``with Inclinometer.balluff() as sensor``: it responds on ``sensor.device``.

    ``roll_deg``, ``pitch_deg``, ``temperature_c`` and ``noise_deg`` may change at any time, as may, of the
    fine one, the directions of its ``axes`` in the unit (right, up, along) and the drift of its zeros from
    20 °C, ``deg_per_k``. Faults are ``answers`` (False: it is silent), ``frozen``, ``corrupts`` (every CRC is
    wrong), ``echoes`` (the line returns sent data), ``late_s`` (delay of its responses) and ``address``.
    ``settings`` are its holding registers.
    """

    def __init__(
        self, address: int, settings: Mapping[int, int], measure: Callable[[Inclinometer], Registers]
    ) -> None:
        self.address = address
        self.settings = dict(settings)
        self.roll_deg = self.pitch_deg = 0.0
        self.temperature_c, self.noise_deg = 21.5, 0.02
        self.axes: Sequence[Sequence[float]] = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self.deg_per_k = 0.0
        self.answers, self.frozen, self.corrupts, self.echoes = True, False, False, False
        self.late_s = 0.0
        self.requests = 0
        self.random = random.Random(1)
        self._measure = measure
        self._measured: Registers = measure(self)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="inclinometer", daemon=True)
        self._port = PluggedPort()
        self.device = self._port.device

    @classmethod
    def balluff(cls) -> Self:
        """One axis, address 1, 19200 baud, with factory settings."""
        return cls(1, {132: 1, 133: 1, 134: 0, 135: 0, 136: 0, 200: 1, 201: 192}, _balluff)

    @classmethod
    def witmotion(cls) -> Self:
        """Two axes, address 0x50, 9600 baud."""
        return cls(0x50, {0x04: 2, 0x1A: 0x50}, _witmotion)

    @classmethod
    def fine(cls) -> Self:
        """Two axes with floats in swapped words, address 1, 19200 baud; register 100 states its type."""
        sensor = cls(1, {100: 0x4711}, _fine)
        sensor.noise_deg = 0.003
        return sensor

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Unplug the USB adapter: the port disappears.

        The thread ends first; otherwise it would read from the next file that gets the descriptor of the
        closed one.
        """
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()
        self._port.unplug()

    def angle_deg(self, angle_deg: float) -> float:
        """Angle with the noise of a reading."""
        return angle_deg + self.random.gauss(0.0, self.noise_deg)

    def _serve(self) -> None:
        heard, terminal = b"", self._port.terminal
        while not self._ending.is_set():
            try:
                if not select.select([terminal], [], [], _WAIT_S)[0]:
                    heard = b""  # a silence ends a frame
                    continue
                heard += os.read(terminal, 256)
                if self.echoes:
                    os.write(terminal, heard)
                while len(heard) >= _REQUEST_BYTES:
                    request, heard = heard[:_REQUEST_BYTES], heard[_REQUEST_BYTES:]
                    self._answer(terminal, request)
            except (OSError, ValueError):  # unplugged
                return

    def _answer(self, terminal: int, request: bytes) -> None:
        if request[0] != self.address or request[-2:] != crc(request[:-2]):
            return
        self.requests += 1
        answer = self.response(request[1:-2])
        if self.late_s:
            time.sleep(self.late_s)
        if self.answers:
            frame = bytes([self.address]) + answer
            check = crc(frame)
            os.write(terminal, frame + (bytes(255 - byte for byte in check) if self.corrupts else check))

    def response(self, request: bytes) -> bytes:
        """Response to a request, both from the function code on."""
        function, first, count = struct.unpack(">BHH", request)
        if not self.frozen:
            self._measured = self._measure(self)
        known = self._measured | {(HOLDING, at): word for at, word in self.settings.items()}
        if function not in (HOLDING, INPUT):
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        if not 1 <= count <= 125:
            return bytes([function | 0x80, ILLEGAL_VALUE])
        words = [known.get((function, address)) for address in range(first, first + count)]
        if None in words:
            return bytes([function | 0x80, ILLEGAL_ADDRESS])
        return struct.pack(f">BB{count}H", function, 2 * count, *words)


def _balluff(sensor: Inclinometer) -> Registers:
    """Input registers 0, 10, 17, 18; register 0 is 55555 if a setting is invalid."""
    angle = round(sensor.angle_deg(sensor.roll_deg) * 100) % 36000
    turned = -angle if sensor.settings[135] else angle
    shown = (turned + 18000) % 36000 - 18000 if sensor.settings[136] else turned % 36000
    is_bad = not 1 <= sensor.settings[133] <= 20 or sensor.settings[135] > 1 or sensor.settings[136] > 1
    temperature = round((sensor.temperature_c + sensor.random.gauss(0.0, 0.02)) * 100)
    return {
        (INPUT, 0): 55555 if is_bad else angle,
        (INPUT, 10): temperature & 0xFFFF,
        (INPUT, 17): shown >> 16 & 0xFF,
        (INPUT, 18): shown & 0xFFFF,
    }


def _fine(sensor: Inclinometer) -> Registers:
    """Input registers 0 and 2, roll and pitch as inclinations of the axes; 4, temperature in 0.01 °C.

    The unit pitches about the horizontal first, then rolls about its own axis, clockwise.
    """
    roll, pitch = math.radians(sensor.roll_deg), math.radians(sensor.pitch_deg)
    up = (-math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch), math.sin(pitch))
    registers = {(INPUT, 4): round(sensor.temperature_c * 100 + sensor.random.gauss(0.0, 2.0)) & 0xFFFF}
    drift_deg = sensor.deg_per_k * (sensor.temperature_c - 20.0)
    for first, sign, axis in ((0, -1.0, sensor.axes[0]), (2, 1.0, sensor.axes[1])):
        sine = sum(one * other for one, other in zip(axis, up, strict=True)) / math.hypot(*axis)
        angle_deg = sensor.angle_deg(sign * math.degrees(math.asin(sine)) + drift_deg)
        high, low = struct.unpack(">HH", struct.pack(">f", angle_deg))
        registers |= {(INPUT, first): low, (INPUT, first + 1): high}
    return registers


def _witmotion(sensor: Inclinometer) -> Registers:
    """Holding registers 0x34 to 0x40: acceleration, rate, magnetic field, angles, temperature."""
    noise = [round(sensor.random.gauss(0.0, 3.0)) for _ in range(9)]
    at_rest = (0, 0, 2048, 0, 0, 0, 120, -40, 300)  # 1 g of 16 g
    angles = (sensor.angle_deg(sensor.roll_deg), sensor.angle_deg(sensor.pitch_deg), 12.0)
    words = [value + moved for value, moved in zip(at_rest, noise, strict=True)]
    words += [round(angle / 180.0 * 32768.0) for angle in angles]
    words.append(round((sensor.temperature_c + sensor.random.gauss(0.0, 0.02)) * 100))
    return {(HOLDING, 0x34 + n): word & 0xFFFF for n, word in enumerate(words)}
