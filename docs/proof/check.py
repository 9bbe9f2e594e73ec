"""Checks the messages of a unit: one Check for each unit and wire, called with every message."""

import functools
import json
import operator
import struct
import zlib
from datetime import datetime


class Check:
    """``unit``: the CRC-32 of the serial number. ``limit_s``: the oldest value that may be used."""

    def __init__(self, unit, limit_s):
        self.unit, self.limit_s, self.last, self.delay_s, self.lost = unit, limit_s, None, 0.0, 0

    def fault(self, message, now_s, utc_s=None):
        """Why a message must not be used, empty: it may. ``now_s``: a clock that is never set."""
        if message is None:
            return "corrupt"
        if message["unit"] != self.unit:
            return "foreign"
        last, last_s = self.last or (message | {"message": message["message"] - 1}, now_s)
        if message["session"] != last["session"]:
            return "restarted"
        if not 0 < (message["message"] - last["message"]) % 2**32 < 2**31:
            return "not newer"
        unit_s = (message["clock_ms"] - last["clock_ms"]) % 2**32 / 1000
        self.delay_s = max(0.0, self.delay_s + (now_s - last_s) * (1 - 0.0002) - unit_s)
        self.lost = max(0, (message["count"] - last["count"]) % 2**32 - 1)
        self.last = message, now_s
        if message["age_s"] is None:
            return "not valid"
        if message["age_s"] + self.delay_s > self.limit_s:
            return "late"
        if utc_s is not None and not -0.1 <= utc_s - (message["utc_s"] or 0) <= self.limit_s:
            return "late"
        return "" if message["valid"] else "not valid"


def from_block(data):
    """The 160 bytes of the registers 200 to 279, as they came; None when they are corrupt."""
    if len(data) != 160 or zlib.crc32(data[:156]) != int.from_bytes(data[156:]) or data[:2] != b"\0\1":
        return None
    keys = ("unit", "session", "message", "clock_ms", "count", "sequence", "utc_s")
    *numbers, utc_ms, _, age_ms, status = struct.unpack_from(">7IHHIH", data, 4)
    message = dict(zip(keys, numbers, strict=True))
    utc_s = None if message["utc_s"] == 0xFFFFFFFF else message["utc_s"] + utc_ms / 1000
    age_s = None if age_ms == 0xFFFFFFFF else age_ms / 1000
    return message | {"utc_s": utc_s, "age_s": age_s, "valid": status & 0x3001 == 1}


def from_telegram(data):
    """The three lines of a telegram with their line ends; None when they are corrupt."""
    covered, _, tail = data.rpartition(b",")
    crc, sentence = zlib.crc32(covered + b","), data.rpartition(b"$")[2].rpartition(b"*")[0]
    if tail != b"%08X*%02X\r\n" % (crc, functools.reduce(operator.xor, sentence, 0)):
        return None
    measured, _, proof = (line.split("*")[0].split(",") for line in data.decode().split("\r\n")[:3])
    utc_s = None
    if proof[5]:
        utc_s = datetime.strptime(f"{proof[5]} {measured[1]}000+0000", "%Y%m%d %H%M%S.%f%z").timestamp()
    age_s = int(proof[6]) / 1000 if proof[6] else None
    numbers = {"count": int(proof[3]), "clock_ms": int(proof[4]), "age_s": age_s}
    message = numbers | {"unit": int(proof[1], 16), "session": proof[2], "message": int(proof[3])}
    return message | {"utc_s": utc_s, "valid": measured[2] == "A"}


def from_json(line):
    """The bytes of the object as they came; None when they are corrupt."""
    covered, _, tail = line.rpartition(b', "crc32": "')
    if tail != b'%08X"}' % zlib.crc32(covered):
        return None
    told = json.loads(line)
    live = told["valid"] and not {"playback", "simulated"} & set(told["status"])
    utc_s = datetime.fromisoformat(told["time"]).timestamp() if told["time"] else None
    return told | {"unit": int(told["unit"], 16), "count": told["published"], "utc_s": utc_s, "valid": live}
