"""Lines that a Grbl controller might say, and noise makes of them."""

import math

from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st

from altd.devices.grbl.protocol import GrblSetting, StatusReport, Welcome, parse

NAME = "grbl"

LINES = (
    *(b"ok", b"error:9", b"ALARM:1", b"$110=5000.000", b"$22=1", b"[MSG:'$H'|'$X' to unlock]", b">G54:ok"),
    *(b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>", b"<Run|WPos:-12.500,3.250,0.000|Bf:15,128|FS:500,0>"),
    *(b"<Hold:0|MPos:1.000,2.000,0.000|WCO:10.000,-4.000,0.000|Ov:100,100,100|Pn:XY>",),
    *(b"Grbl 1.1h ['$' for help]", b"GrblHAL 1.1f ['$' or '$HELP' for help]"),
)
EXAMPLES = spoilt_bytes(st.sampled_from(LINES))


def check(example: bytes) -> None:
    """A number that is understood is finite: the stage is driven by it."""
    reply = parse(example.decode("ascii", "replace"))
    numbers: list[float] = []
    if isinstance(reply, StatusReport):
        points = (reply.machine_mm, reply.work_mm, reply.offset_mm)
        numbers = [value for point in points if point is not None for value in point]
        assert (reply.machine_mm is None) != (reply.work_mm is None)
    elif isinstance(reply, GrblSetting):
        numbers = [reply.value]
    elif isinstance(reply, Welcome):
        numbers = [float(part) for part in reply.version]
    assert all(math.isfinite(number) for number in numbers), reply
