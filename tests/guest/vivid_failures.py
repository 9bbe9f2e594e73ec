"""A vivid camera asked for what it has not, taken, broken, pulled out and put back elsewhere."""

import threading
from pathlib import Path

from cameras import camera, nodes, outcome, plug_in, v4l2_ctl
from support.guest import leave_results

FIRST, SECOND = nodes("vid-cap")


def main() -> None:
    leave_results(
        {
            "absent": opened(Path("/dev/video-none")),
            "no camera": opened(Path("/dev/null")),
            "an output": opened(nodes("vid-out")[0]),
            "pixel format": opened(FIRST, pixel_format="Y12", controls={}),
            "size": opened(FIRST, width=752, height=480),
            "rate": opened(FIRST, fps=20),
            "no such control": opened(FIRST, controls={"exposure_time": 3}),
            "control out of range": opened(FIRST, controls={"brightness": 256}),
            "control": opened(FIRST, controls={"brightness": 200}),
            "brightness": v4l2_ctl(FIRST, "-C", "brightness").strip(),
            "busy": busy(),
            "set_exposure": set_exposure(),
            "broken": broken(),
            "re-plugged": re_plugged(),
        }
    )


def opened(device: Path, **settings: object) -> dict[str, object]:
    one = camera(device, **settings)
    try:
        return outcome(one.open)
    finally:
        one.close()


def busy() -> list[dict[str, object]]:
    holder = camera(FIRST)
    holder.open()
    refused = opened(FIRST)
    undisturbed = outcome(lambda: holder.next_frame(1.0))
    holder.close()
    return [refused, undisturbed, opened(FIRST)]


def set_exposure() -> dict[str, object]:
    one = camera(FIRST)
    one.open()
    try:
        return outcome(lambda: one.set_exposure(2.0, 0.0))
    finally:
        one.close()


def broken() -> list[dict[str, object]]:
    """The driver's stream ends with a fatal error while a frame is waited for."""
    one = camera(FIRST)
    one.open()
    one.next_frame(1.0)
    breaking = threading.Timer(0.3, v4l2_ctl, (FIRST, "-c", "inject_fatal_streaming_error=1"))
    breaking.start()
    lost = outcome(lambda: [one.next_frame(2.0) for _ in range(300)])
    breaking.join()
    one.close()
    again = outcome(lambda: (one.open(), one.next_frame(1.0)))
    one.close()
    return [lost, again]


def re_plugged() -> list[dict[str, object]]:
    """Pulled out while a frame is waited for; away; back under another number at the same place."""
    path = plug_in("a-socket-of-this-pc", FIRST)
    one = camera(path)
    one.open()
    one.next_frame(1.0)
    pulling = threading.Timer(0.3, v4l2_ctl, (FIRST, "-c", "disconnect=1"))
    pulling.start()
    lost = outcome(lambda: [one.next_frame(2.0) for _ in range(300)])
    pulling.join()
    path.unlink()
    one.close()
    away = outcome(one.open)
    plug_in("a-socket-of-this-pc", SECOND)
    back = outcome(lambda: (one.open(), one.next_frame(1.0)))
    one.close()
    return [lost, away, back]


main()
