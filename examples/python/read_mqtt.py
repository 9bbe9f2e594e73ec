"""Reads x, y, yaw and pitch of a laser target from an MQTT broker; docs/clients.md has the rules.
pip install paho-mqtt; python3 read_mqtt.py BROKER PORT SERIAL LIMIT_MS [--rehearsal]"""

import json
import sys
import time
from collections import deque
from datetime import datetime
from signal import SIG_BLOCK, SIGUSR1, pthread_sigmask, sigtimedwait
from zlib import crc32

from paho.mqtt.client import CallbackAPIVersion, Client, MQTTv5


class Target:
    """Values x, y in mm, yaw, pitch in degrees, or None. ``now_ms`` is ms of a monotonic clock."""

    def __init__(self, unit, limit_ms, rehearsal):
        self.unit, self.limit_ms, self.rehearsal, self.until_ms = unit, limit_ms, rehearsal, 0.0
        self.session = self.refusal = self.published = self.changed_ms = self.values = None

    def update(self, data, retained, now_ms, utc_ms, acknowledged):
        """Process a message of `measurement` or `availability`, or None; return the fault or "good"."""
        self.values = self.values if now_ms < self.until_ms and data != b"offline" else None
        if data in (None, b"online", b"offline") or retained:  # the unit never retains measurements
            return "offline" if data == b"offline" else "retained" if retained else "no answer"
        try:
            told = json.loads(data if data.endswith(b', "crc32": "%08X"}' % crc32(data[:-22])) else b"")
            message, clock_ms, published = (int(told[key]) for key in ("message", "clock_ms", "published"))
            values = [told[key] for key in ("x_mm", "y_mm", "yaw_deg", "pitch_deg")]
            unit, session, valid, status = (told[key] for key in ("unit", "session", "valid", "status"))
            live, age_ms = {"playback", "simulated", "rehearsal"}.isdisjoint(status), 1e3 * told["age_s"]
            sent_ms = 1e3 * datetime.fromisoformat(told["time"]).timestamp() + age_ms if live else utc_ms
        except (ValueError, KeyError, TypeError):
            return "corrupt"
        if unit != self.unit:
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
        old_ms = age_ms + max(self.delay_ms, utc_ms - sent_ms)
        if not self.refusal and old_ms > self.limit_ms:
            return "late"
        self.values = None  # the faults above, except offline, keep the last values until these expire
        if self.refusal or now_ms - self.changed_ms > self.limit_ms:
            return self.refusal or "stopped"
        if not (live or self.rehearsal):
            return "not live"
        if valid is not True or not all(isinstance(value, float) and abs(value) < 1e6 for value in values):
            return f"not valid: {(status or ['unknown_reason'])[0]}"
        self.values, self.until_ms = values, now_ms + self.limit_ms - old_ms
        return "good"


if __name__ == "__main__":
    broker, port, serial, limit_ms, *options = sys.argv[1:]
    target = Target(f"{crc32(serial.encode()):08X}", 0.75 * float(limit_ms), "--rehearsal" in options)
    topics, inbox = [(f"altd/{serial}/{key}", 0) for key in ("measurement", "availability")], deque(maxlen=9)
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTv5)
    client.on_connect = lambda *_: client.subscribe(topics)
    client.on_message = lambda _client, _data, message: inbox.append((message.payload, message.retain))
    client.connect_async(broker, int(port), clean_start=True)
    client.loop_start()
    pthread_sigmask(SIG_BLOCK, {SIGUSR1})  # acknowledges a unit that was restarted or silent
    while True:
        acknowledged = sigtimedwait({SIGUSR1}, 0 if inbox else 0.05)
        data, retained = inbox.popleft() if inbox else (None, False)
        fault = target.update(data, retained, time.monotonic() * 1e3, time.time() * 1e3, acknowledged)
        shown = "x {:.4f} mm, y {:.4f} mm, yaw {:.4f} deg, pitch {:.4f} deg" if target.values else "no value"
        print(shown.format(*target.values or ()), f"({fault})", flush=True)
