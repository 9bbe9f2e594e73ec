"""``docs/architecture.svg``: the unit, the daemon and its clients."""

from collections.abc import Iterable
from html import escape

WIDTH_PX, HEIGHT_PX = 960, 400
BEAM, LINE, TEXT, GREY = "#d0342c", "#44515e", "#1f2a33", "#586470"
STEPS = ("pair frames", "find spots", "average 1 s", "fit the beam")
CHECKS = ("new frames, right times, calibrated camera and view,", "shape of the spot, range of the beam")
MEASUREMENT = ("values with sigma and sigma_now,", "or no number and the reason")
CLIENTS = (
    ("guidance controller", ("Modbus TCP and RTU", "serial telegram", "HTTP")),
    ("driver, technician", ("HTTP: page in the browser", "console, terminal")),
    ("plant systems", ("MQTT, Sparkplug B", "OPC UA")),
)


def picture() -> str:
    """Drawing as SVG; its white background keeps it legible on a dark page."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" '
        'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="14">',
        "<title>From the laser beam to the clients: total station, unit, daemon, interfaces</title>",
        f'<rect width="{WIDTH_PX}" height="{HEIGHT_PX}" fill="#ffffff"/>',
        '<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0 L10 5 L0 10 Z" fill="context-stroke"/></marker></defs>',
        *_unit(),
        *_daemon(),
        *_clients(),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _unit() -> Iterable[str]:
    yield _box((20, 20, 190, 54), "#f4f5f7", "Total station", ("in the finished tunnel",))
    yield _arrow("M115 74 V136", BEAM, 3)
    yield _text((126, 108), "laser beam", BEAM)
    lines = ("front target: glass window", "rear target: plate", "two cameras", "LEDs around each target")
    yield _box((20, 140, 190, 112), "#e3eef7", "Unit on the machine", lines)
    yield _box((20, 318, 190, 54), "#f4f5f7", "Inclinometer", ("roll; optional",))


def _daemon() -> Iterable[str]:
    yield _box((264, 20, 424, 360), "#f7faf7", "altd, a daemon on the unit's computer", ())
    yield _arrow("M210 170 H238 V86 H276", LINE)
    yield _text((217, 192), "frames", GREY, 12)
    for number, step in enumerate(STEPS):
        left = 280 + 102 * number
        first, rest = step.split(" ", 1)
        yield _box((left, 60, 86, 52), "#ffffff", "", ())
        yield _text((left + 43, 82), first, TEXT, 13, "middle")
        yield _text((left + 43, 100), rest, TEXT, 13, "middle")
        if number:
            yield _arrow(f"M{left - 16} 86 H{left - 2}", LINE)
    yield _box((280, 126, 392, 72), "#ffffff", "Checks", CHECKS)
    yield _box(
        (280, 212, 189, 72), "#ffffff", "Self-check", ("LEDs against their places", "in the calibration")
    )
    yield _box(
        (483, 212, 189, 72), "#ffffff", "Calibration", ("px to mm, of this unit,", "with its covariance")
    )
    yield _box((280, 298, 392, 72), "#ffe9e7", "Measurement, 20 a second", MEASUREMENT)
    yield _arrow("M210 345 H276", LINE)
    yield _arrow("M672 332 H716 V72 H746", LINE)


def _clients() -> Iterable[str]:
    for number, (name, interfaces) in enumerate(CLIENTS):
        top = 26 + 130 * number
        yield _box((750, top, 190, 92), "#f4f5f7", name[0].upper() + name[1:], interfaces)
        if number:
            yield _arrow(f"M716 {top + 46} H746", LINE)


def _box(place: tuple[int, int, int, int], fill: str, title: str, lines: Iterable[str]) -> str:
    x, y, width, height = place
    parts = [
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" fill="{fill}" stroke="{LINE}"/>',
    ]
    y += 6
    if title:
        y += 17
        parts.append(_text((x + 12, y), title, TEXT, 13, weight="bold"))
    for line in lines:
        y += 18
        parts.append(_text((x + 12, y), line, TEXT, 12))
    return "\n".join(parts)


def _arrow(path: str, stroke: str, width: float = 1.6) -> str:
    return f'<path d="{path}" fill="none" stroke="{stroke}" stroke-width="{width}" marker-end="url(#a)"/>'


def _text(
    at: tuple[int, int], text: str, fill: str, size: int = 14, anchor: str = "start", weight: str = "normal"
) -> str:
    place = f'x="{at[0]}" y="{at[1]}" text-anchor="{anchor}" font-weight="{weight}"'
    return f'<text {place} fill="{fill}" font-size="{size}">{escape(text)}</text>'
