"""Reads x, y, yaw and pitch of a laser target over Modbus TCP; docs/clients.md has the rules.
pip install pymodbus; python3 read_modbus.py ADDRESS PORT SERIAL LIMIT_MS [--rehearsal]
"""

import sys
import time
from signal import SIG_BLOCK, SIGUSR1, pthread_sigmask, sigtimedwait
from struct import pack, unpack_from
from zlib import crc32

from pymodbus.client import ModbusTcpClient

WORDS = """spot_missing ambiguous saturated cut_by_edge wrong_size wrong_shape camera_silent implausible
exposure_changing distorted frame_repeated wrong_camera out_of_step out_of_range unsteady warming_up stale
check_failed geometry_drift geometry_unverified self_checking not_live"""
REASONS = dict(zip((*range(1, 13), *range(20, 30)), WORDS.split(), strict=True))


class Target:
    """Values x, y in mm, yaw, pitch in degrees, or None. Times are ms of a monotonic clock."""

    def __init__(self, unit, limit_ms, rehearsal):
        self.unit, self.limit_ms, self.rehearsal, self.until_ms = unit, limit_ms, rehearsal, 0.0
        self.session = self.refusal = self.published = self.values = None

    def update(self, registers, now_ms, acknowledged):
        """Process the 80 registers of an answer, empty if there is none; return the fault or "good"."""
        self.values = self.values if now_ms < self.until_ms else None
        if len(registers) != 80:
            return "no answer"
        data = pack(">80H", *registers)
        if crc32(data[:156]) != int.from_bytes(data[156:], "big") or registers[0] != 1:
            return "corrupt"
        unit, session, message, clock_ms, published = unpack_from(">5I", data, 4)
        age_ms, status, whole, front, rear, *values = unpack_from(">I4H12x4f", data, 36)
        if unit != self.unit or not unit:
            return "foreign"
        if session != self.session:
            self.refusal, self.delay_ms, acknowledged = self.session and "restarted", 0.0, False
            self.session, self.message, self.clock_ms, self.heard_ms = session, message - 1, clock_ms, now_ms
        if not 0 < (message - self.message) % 2**32 < 2**31:
            return "not newer"
        silent_ms, unit_ms = now_ms - self.heard_ms, (clock_ms - self.clock_ms) % 2**32
        if acknowledged or silent_ms > self.limit_ms:
            self.refusal = "silent" if silent_ms > self.limit_ms else None
        self.delay_ms = max(0.0, self.delay_ms + silent_ms * 0.9998 - unit_ms)
        self.message, self.clock_ms, self.heard_ms = message, clock_ms, now_ms
        if published != self.published:
            self.published, self.changed_ms = published, now_ms
        is_known = age_ms != 0xFFFFFFFF
        if not self.refusal and is_known and age_ms + self.delay_ms > self.limit_ms:
            return "late"
        self.values = None  # the faults above keep the last values until these expire
        if self.refusal or now_ms - self.changed_ms > self.limit_ms:
            return self.refusal or "stopped"
        if status & 0x3000 and not self.rehearsal:
            return "not live"
        if not (status & 1 and is_known and all(abs(value) < 1e6 for value in values)):  # NaN is not below
            target, code = ("front_", front) if front else ("rear_", rear) if rear else ("", whole)
            return f"not valid: {target}{REASONS.get(code, 'unknown_reason')}"
        self.values, self.until_ms = values, now_ms + self.limit_ms - age_ms - self.delay_ms
        return "good"


if __name__ == "__main__":
    address, port, serial, limit_ms, *options = sys.argv[1:]
    target = Target(crc32(serial.encode()), 0.75 * float(limit_ms), "--rehearsal" in options)
    client = ModbusTcpClient(address, port=int(port), timeout=float(limit_ms) / 20_000, retries=0)
    pthread_sigmask(SIG_BLOCK, {SIGUSR1})  # acknowledges a unit that was restarted or silent
    while True:
        acknowledged = sigtimedwait({SIGUSR1}, 0.05)
        try:
            registers = client.read_input_registers(200, count=80).registers
        except Exception:  # no connection, no answer in time, or an unreadable one
            registers = ()
        if (fault := target.update(registers, time.monotonic() * 1000, acknowledged)) == "no answer":
            client.close()  # an answer that comes later must not be taken for the next one
        shown = "x {:.4f} mm, y {:.4f} mm, yaw {:.4f} deg, pitch {:.4f} deg" if target.values else "no value"
        print(shown.format(*target.values or ()), f"({fault})", flush=True)
