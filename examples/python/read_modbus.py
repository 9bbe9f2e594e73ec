"""Reads x, y, yaw and pitch of a laser target over Modbus TCP; docs/clients.md has the rules.
pip install pymodbus; python3 read_modbus.py ADDRESS PORT SERIAL LIMIT_MS [--rehearsal]
"""

import sys
import time
from struct import pack, unpack_from
from zlib import crc32

from pymodbus.client import ModbusTcpClient

WORDS = """spot_missing ambiguous saturated cut_by_edge wrong_size wrong_shape camera_silent implausible
exposure_changing distorted frame_repeated wrong_camera out_of_step out_of_range unsteady warming_up stale
check_failed geometry_drift geometry_unverified self_checking not_live"""
REASONS = dict(zip((*range(1, 13), *range(20, 30)), WORDS.split(), strict=True))


class Target:
    """``values``: x, y in mm, yaw, pitch in degrees, or None. Times are ms of a clock that is never set."""

    def __init__(self, unit, limit_ms, rehearsal):
        self.unit, self.limit_ms, self.rehearsal = unit, limit_ms, rehearsal
        self.session = self.published = self.values = None
        self.delay_ms = self.until_ms = 0.0

    def update(self, registers, now_ms):
        """Take the 80 registers of an answer, none if there is none; return the fault or "good"."""
        if now_ms >= self.until_ms:
            self.values = None
        if len(registers) != 80:
            return "no answer"
        data = pack(">80H", *registers)
        if crc32(data[:156]) != int.from_bytes(data[156:], "big") or registers[0] != 1:
            return "corrupt"
        unit, session, message, clock_ms, published = unpack_from(">5I", data, 4)
        age_ms, status, whole, front, rear = unpack_from(">I4H", data, 36)
        if unit != self.unit:
            return "foreign"
        if self.session is None:
            self.session, self.message, self.clock_ms, self.heard_ms = session, message - 1, clock_ms, now_ms
        if session != self.session:
            self.values = None
            return "restarted"  # until this program is started again
        if not 0 < (message - self.message) % 2**32 < 2**31:
            return "not newer"
        unit_ms = (clock_ms - self.clock_ms) % 2**32
        self.delay_ms = max(0.0, self.delay_ms + (now_ms - self.heard_ms) * 0.9998 - unit_ms)
        self.message, self.clock_ms, self.heard_ms = message, clock_ms, now_ms
        if published != self.published:
            self.published, self.changed_ms = published, now_ms
        if age_ms + self.delay_ms > self.limit_ms:
            return "late"
        self.values = None  # the faults above keep the last values until their time is over
        if now_ms - self.changed_ms > self.limit_ms:
            return "stopped"
        if status & 0x3000 and not self.rehearsal:
            return "not live"
        values = unpack_from(">4f", data, 60)
        if not status & 1 or not all(abs(value) < 1e6 for value in values):  # NaN is not below
            target, code = ("front_", front) if front else ("rear_", rear) if rear else ("", whole)
            return f"not valid: {target}{REASONS.get(code, 'unknown_reason')}"
        self.values, self.until_ms = values, now_ms + self.limit_ms - age_ms - self.delay_ms
        return "good"


if __name__ == "__main__":
    address, port, serial, limit_ms, *options = sys.argv[1:]
    target = Target(crc32(serial.encode()), 0.75 * float(limit_ms), "--rehearsal" in options)
    client = ModbusTcpClient(address, port=int(port), timeout=float(limit_ms) / 20_000, retries=0)
    while True:
        try:
            registers = client.read_input_registers(200, count=80).registers
        except Exception:  # no connection, no answer in time, or an unreadable one
            registers = ()
        if (fault := target.update(registers, time.monotonic() * 1000)) == "no answer":
            client.close()  # an answer that comes later must not be taken for the next one
        shown = "x {:.4f} mm, y {:.4f} mm, yaw {:.4f} deg, pitch {:.4f} deg" if target.values else "no value"
        print(shown.format(*target.values or ()), f"({fault})", flush=True)
        time.sleep(0.05)
