"""``docs/coordinates.svg``, the unit frame and its signs.

Every point is projected from unit-frame coordinates in mm (``docs/conventions.md``), so the drawing cannot
contradict the signs that it shows.
"""

import math
from collections.abc import Callable, Iterable

Point = tuple[float, float, float]
Projection = Callable[[Point], tuple[float, float]]

WIDTH_PX, HEIGHT_PX = 960, 760
DISTANCE_MM = 280.0
HALF_X_MM, HALF_Y_MM = 70.0, 55.0
SX, SY = 0.10, 0.09
"""Slopes of the drawn beam: yaw 5.7°, pitch 5.1°, exaggerated so that they are visible."""
X_MM, Y_MM = 18.0, 14.0

_ARROW, _DASHED = 'marker-end="url(#a)"', 'stroke-dasharray="4 4"'
BEAM, AXIS, GLASS, METAL, TEXT, GREY = "#d0342c", "#2f7d4f", "#8fb6d6", "#8a949e", "#1f2a33", "#6b7785"


def picture() -> str:
    """Drawing as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" '
        'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="14">',
        "<title>The unit frame: axes, targets, cameras and the signs of x, y, yaw and pitch</title>",
        f'<rect width="{WIDTH_PX}" height="{HEIGHT_PX}" fill="#ffffff"/>',
        '<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0 L10 5 L0 10 Z" fill="context-stroke"/></marker></defs>',
        *_unit(),
        *_front(),
        *_plane("From above", (355, 690), 0, "x", "yaw positive:", "the beam points to the right"),
        *_plane("From the right side", (700, 640), 1, "y", "pitch positive:", "the beam points up"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _beam(z_mm: float) -> Point:
    return X_MM + SX * z_mm, Y_MM + SY * z_mm, z_mm


def _axonometric(point: Point) -> tuple[float, float]:
    """Project a point as viewed from the right, from behind and from above."""
    azimuth, elevation, scale = math.radians(24), math.radians(16), 1.15
    x, y, z = point
    u = x * math.sin(azimuth) + z * math.cos(azimuth)
    v = y * math.cos(elevation) + (z * math.sin(azimuth) - x * math.cos(azimuth)) * math.sin(elevation)
    return 410 + scale * u, 250 - scale * v


def _unit() -> Iterable[str]:
    at = _axonometric
    yield _text((20, 30), "The unit frame", TEXT, 18)
    for z, fill, stroke in ((DISTANCE_MM, "#dfe3e7", METAL), (0.0, "#e3eef7", GLASS)):
        yield _polygon(at, _rectangle(z), fill, stroke)
    for i in range(-6, 7):
        for j in range(-4, 5):
            u, v = at((10.0 * i, 12.0 * j, 0.0))
            yield f'<circle cx="{u:.1f}" cy="{v:.1f}" r="1" fill="#5d86a8"/>'
    yield from (_line(at, _beam(-330), _beam(-240), BEAM, 3), _line(at, _beam(-225), _beam(0), BEAM, 3))
    yield _line(at, _beam(0), _beam(DISTANCE_MM), BEAM, 3)
    for z in (0.0, DISTANCE_MM):
        u, v = at(_beam(z))
        yield f'<ellipse cx="{u:.1f}" cy="{v:.1f}" rx="5" ry="7" fill="{BEAM}"/>'
    origin = (0.0, 0.0, 0.0)
    for name, end in (("x", (105.0, 0.0, 0.0)), ("y", (0.0, 85.0, 0.0)), ("z", (0.0, 0.0, 190.0))):
        yield _line(at, origin, end, AXIS, 2, _ARROW)
        u, v = at(end)
        yield _text((u + 6, v + (14 if name == "x" else -6)), name, AXIS, 17)
    for z, name in ((85.0, "front camera"), (190.0, "rear camera")):
        height = -92.0
        towards = _rectangle(0.0 if name.startswith("front") else DISTANCE_MM)
        lens = (0.0, height, z)
        for corner in towards[:2]:
            yield _line(at, lens, corner, GREY, 0.7, _DASHED)
        u, v = at(lens)
        yield f'<rect x="{u - 13:.1f}" y="{v - 8:.1f}" width="26" height="16" rx="3" fill="#2b3a48"/>'
        yield _text((u, v + 26), name, TEXT, anchor="middle")
    u, v = at((0, -HALF_Y_MM, 0))
    yield _text((u - 60, v + 62), "front target, z = 0", TEXT, anchor="middle")
    yield _text((u - 60, v + 79), "glass window with printed dots", GREY, 12, anchor="middle")
    u, v = at((0, HALF_Y_MM, DISTANCE_MM))
    yield _text((u + 30, v - 30), "rear target, z = D = 280 mm", TEXT, anchor="middle")
    yield _text((u + 30, v - 14), "plate", GREY, 12, anchor="middle")
    u, v = at(_beam(-330))
    yield _text((u - 10, v - 70), "beam", BEAM)
    yield _text((u - 10, v - 53), "from the total station, 10 to 100 m away", BEAM, 12)
    yield _text((20, 52), "Origin: middle of the printed side of the front target.", GREY, 13)
    yield _text((20, 70), "x to the right and y up, as seen along the beam; z along the beam.", GREY, 13)
    yield _text((20, 88), "The front camera looks against the beam: its raw picture is mirrored.", GREY, 13)


def _front() -> Iterable[str]:
    def at(point: Point) -> tuple[float, float]:
        return 150 + 1.15 * point[0], 600 - 1.15 * point[1]

    yield _text((20, 475), "Along the beam, from the total station", TEXT, 16)
    yield _polygon(at, _rectangle(0.0), "#e3eef7", GLASS)
    yield _line(at, (-90, 0, 0), (100, 0, 0), AXIS, 2, _ARROW)
    yield _line(at, (0, -65, 0), (0, 80, 0), AXIS, 2, _ARROW)
    yield _text(at((104, -4, 0)), "x", AXIS, 17)
    yield _text(at((6, 74, 0)), "y", AXIS, 17)
    spot = (35.0, 27.0, 0.0)
    yield _line(at, (35, 0, 0), spot, BEAM, 1, _DASHED)
    yield _line(at, (0, 27, 0), spot, BEAM, 1, _DASHED)
    u, v = at(spot)
    yield f'<circle cx="{u:.1f}" cy="{v:.1f}" r="7" fill="{BEAM}"/>'
    yield _text((u - 35, v - 24), "x = +35 mm", BEAM, 11)
    yield _text((u - 35, v - 11), "y = +27 mm", BEAM, 11)
    yield _text((20, 712), "x positive: the beam is to the right", TEXT, 13)
    yield _text((20, 731), "y positive: the beam is higher", TEXT, 13)


def _plane(title: str, origin: tuple[float, float], axis: int, name: str, *meaning: str) -> Iterable[str]:
    """Draw the plane of an axis and z; z points up in the view from above, right in the side view."""
    from_above = axis == 0

    def at(point: Point) -> tuple[float, float]:
        across, along = 0.9 * point[axis], 0.62 * point[2]
        return (
            (origin[0] + 70 + across, origin[1] - along)
            if from_above
            else (origin[0] + along, origin[1] - across)
        )

    def on(across: float, z: float) -> Point:
        return (across, 0.0, z) if from_above else (0.0, across, z)

    slope = math.tan(math.radians(12))
    yield _text((origin[0], 475), title, TEXT, 16)
    for z, colour in ((0.0, GLASS), (DISTANCE_MM, METAL)):
        yield _line(at, on(-60, z), on(60, z), colour, 5)
    yield _line(at, on(0, -40), on(0, 330), AXIS, 1.5, _ARROW)
    yield _line(at, on(0, 0), on(90, 0), AXIS, 2, _ARROW)
    u, v = at(on(0, 330))
    yield _text((u - 16, v + 6) if from_above else (u + 2, v + 16), "z", AXIS, 17)
    u, v = at(on(90, 0))
    yield _text((u + 6, v + 5) if from_above else (u - 16, v + 4), name, AXIS, 17)
    yield _line(at, on(-40 * slope, -40), on(DISTANCE_MM * slope, DISTANCE_MM), BEAM, 3)
    start, end = at(on(0, 150)), at(on(150 * slope, 150))
    sweep = 1 if from_above else 0
    radius = 0.62 * 150
    yield (
        f'<path d="M{start[0]:.1f} {start[1]:.1f} '
        f'A{radius:.1f} {radius:.1f} 0 0 {sweep} {end[0]:.1f} {end[1]:.1f}" '
        f'fill="none" stroke="{TEXT}" stroke-width="1.5" marker-end="url(#a)"/>'
    )
    words = (origin[0] + 122, 590) if from_above else (origin[0] - 10, 712)
    for i, text in enumerate(meaning):
        yield _text((words[0], words[1] + 19 * i), text, TEXT, 13)


def _rectangle(z_mm: float) -> list[Point]:
    return [(sx * HALF_X_MM, sy * HALF_Y_MM, z_mm) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def _polygon(at: Projection, points: Iterable[Point], fill: str, stroke: str) -> str:
    corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in map(at, points))
    return (
        f'<polygon points="{corners}" fill="{fill}" fill-opacity="0.8" stroke="{stroke}" stroke-width="2"/>'
    )


def _line(at: Projection, start: Point, end: Point, stroke: str, width: float, more: str = "") -> str:
    (u0, v0), (u1, v1) = at(start), at(end)
    ends = f'x1="{u0:.1f}" y1="{v0:.1f}" x2="{u1:.1f}" y2="{v1:.1f}"'
    return f'<line {ends} stroke="{stroke}" stroke-width="{width}" {more}/>'


def _text(at: tuple[float, float], text: str, fill: str, size: int = 14, anchor: str = "start") -> str:
    place = f'x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}"'
    return f'<text {place} fill="{fill}" font-size="{size}">{text}</text>'
