"""``docs/desk.svg``, a unit on a desk with its dimensions, and ``docs/desk-dots.svg``, its print.

All lengths are mm and drawn to one scale; the angles and the field of view follow from them.
"""

import math
from collections.abc import Iterable

from hw_sim.targets import DOT_DIAMETER_MM, DOT_PITCH_MM

DISTANCE_MM = 280.0
"""Between the sheets, as z_mm in ``config/desk.toml``."""
WIDTH_MM, HEIGHT_MM = 160.0, 120.0
"""Of a sheet."""
LENS_Z_MM, LENS_Y_MM = 130.0, -80.0
"""A lens, along the beam from the sheet that it looks at, and up from the beam."""
LASER_MM, BOARD_MM, BOARD_Y_MM = 120.0, 560.0, -125.0

_SCALE, _LEFT, _TOP = 1.5, 250.0, 190.0
_BEAM, _METAL, _TEXT, _GREY, _SHEET = "#d0342c", "#8a949e", "#1f2a33", "#6b7785", "#8fb6d6"


def view_mm() -> float:
    """Distance of a lens from the middle of its sheet."""
    return math.hypot(LENS_Z_MM, LENS_Y_MM)


def angle_of_view_deg() -> float:
    """Least horizontal angle of view that holds the width of a sheet."""
    return math.degrees(2 * math.atan(WIDTH_MM / 2 / view_mm()))


def picture() -> str:
    """Drawing as SVG."""
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 960 530" '
        'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="13">',
        "<title>A unit on a desk from the side: laser, two sheets, two webcams and their dimensions</title>",
        '<rect width="960" height="530" fill="#ffffff"/>',
        '<defs><marker id="d" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0 L10 5 L0 10 Z" fill="context-stroke"/></marker></defs>',
        _text(20, 30, "A unit on a desk, from the side; mm", 17),
        *_bench(),
        *_dimensions(),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _at(z_mm: float, y_mm: float) -> tuple[float, float]:
    return _LEFT + _SCALE * z_mm, _TOP - _SCALE * y_mm


def _bench() -> Iterable[str]:
    half = HEIGHT_MM / 2
    yield _line((-LASER_MM - 40, BOARD_Y_MM), (BOARD_MM - LASER_MM - 40, BOARD_Y_MM), _METAL, 9)
    for z_mm, looks in ((LENS_Z_MM, 0.0), (DISTANCE_MM - LENS_Z_MM, DISTANCE_MM)):
        for edge_mm in (-half, half):
            yield _line((z_mm, LENS_Y_MM), (looks, edge_mm), _GREY, 0.8, 'stroke-dasharray="4 4"')
    yield _line((-LASER_MM, 0), (DISTANCE_MM, 0), _BEAM, 2.5)
    for z_mm in (0.0, DISTANCE_MM):
        yield _line((z_mm, BOARD_Y_MM), (z_mm, -half), _METAL, 2)
        yield _line((z_mm, -half), (z_mm, half), _SHEET, 6)
    yield _line((DISTANCE_MM + 60, BOARD_Y_MM), (DISTANCE_MM + 60, half), _TEXT, 6)
    yield _line((-LASER_MM, BOARD_Y_MM), (-LASER_MM, 0), _METAL, 3)
    yield _box(-LASER_MM - 30, 8, 60, 16, _BEAM)
    for z_mm in (LENS_Z_MM - 2, DISTANCE_MM - LENS_Z_MM + 2):
        yield _line((z_mm, BOARD_Y_MM), (z_mm, LENS_Y_MM), _METAL, 3)
        yield _box(z_mm - 9, LENS_Y_MM + 8, 18, 16, "#2b3a48")
    for z_mm, y_mm, words in (
        (-LASER_MM, 30, "laser, class 2"),
        (0, half + 22, "front sheet: clear film with printed dots"),
        (0, half + 10, "z = 0; most of the beam passes"),
        (DISTANCE_MM, half + 22, "rear sheet: tracing paper"),
        (DISTANCE_MM, half + 10, f"z = {DISTANCE_MM:g}"),
    ):
        u, v = _at(z_mm, y_mm)
        yield _text(u, v, words, anchor="middle")
    for z_mm, y_mm, words in (
        (DISTANCE_MM + 68, -half, "matt black card"),
        (DISTANCE_MM - LENS_Z_MM + 16, LENS_Y_MM - 18, "front and rear webcam"),
    ):
        u, v = _at(z_mm, y_mm)
        yield _text(u, v, words)


def _dimensions() -> Iterable[str]:
    half, low = HEIGHT_MM / 2, BOARD_Y_MM - 18
    for start, end, said in (
        ((0, low), (LENS_Z_MM, low), f"{LENS_Z_MM:g}"),
        ((DISTANCE_MM - LENS_Z_MM, low), (DISTANCE_MM, low), f"{LENS_Z_MM:g}"),
        ((0, low - 18), (DISTANCE_MM, low - 18), f"{DISTANCE_MM:g}, measured to 0.2"),
        ((-LASER_MM - 40, low - 36), (BOARD_MM - LASER_MM - 40, low - 36), f"board: {BOARD_MM:g} × 200 × 18"),
        ((-22, -half), (-22, half), f"{HEIGHT_MM:g}"),
        ((LENS_Z_MM - 30, LENS_Y_MM), (LENS_Z_MM - 30, 0), f"{-LENS_Y_MM:g}"),
    ):
        yield _line(start, end, _TEXT, 1, 'marker-start="url(#d)" marker-end="url(#d)"')
        u, v = _at((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        if start[1] == end[1]:
            yield _text(u, v - 5, said, 12, "middle")
        else:
            yield _text(u - 6, v + 24, said, 12, "end")
    for row, words in enumerate(
        (
            f"sheet: {WIDTH_MM:g} wide, {HEIGHT_MM:g} high, flat, square to the beam, both parallel",
            f"lens to the middle of its sheet: {view_mm():.0f}; "
            f"its angle of view: {angle_of_view_deg():.0f}° wide or more",
        )
    ):
        yield _text(20, 495 + 20 * row, words)


def _line(
    start: tuple[float, float], end: tuple[float, float], colour: str, width: float, more: str = ""
) -> str:
    (u0, v0), (u1, v1) = _at(*start), _at(*end)
    ends = f'x1="{u0:.1f}" y1="{v0:.1f}" x2="{u1:.1f}" y2="{v1:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width:g}" {more}/>'


def _box(z_mm: float, y_mm: float, wide_mm: float, high_mm: float, colour: str) -> str:
    u, v = _at(z_mm, y_mm)
    size = f'width="{_SCALE * wide_mm:.1f}" height="{_SCALE * high_mm:.1f}"'
    return f'<rect x="{u:.1f}" y="{v:.1f}" {size} rx="3" fill="{colour}"/>'


def _text(u: float, v: float, words: str, size: int = 13, anchor: str = "start") -> str:
    place = f'x="{u:.1f}" y="{v:.1f}" text-anchor="{anchor}"'
    return f'<text {place} fill="{_TEXT}" font-size="{size}">{words}</text>'


def dots() -> str:
    """Print of the front sheet as SVG in mm, on a hexagonal lattice, with a length to be measured."""
    pitch_mm, row_mm, radius_mm = DOT_PITCH_MM, DOT_PITCH_MM * math.sqrt(3), DOT_DIAMETER_MM / 2
    centres = [(x, y) for x in (0.0, pitch_mm) for y in (0.0, row_mm)] + [(pitch_mm / 2, row_mm / 2)]
    circles = "".join(f'<circle cx="{x:g}" cy="{y:.5f}" r="{radius_mm:g}"/>' for x, y in centres)
    high_mm = HEIGHT_MM + 12
    size = f'width="{WIDTH_MM:g}mm" height="{high_mm:g}mm" viewBox="0 0 {WIDTH_MM:g} {high_mm:g}"'
    lattice = f'width="{pitch_mm:g}" height="{row_mm:.5f}" patternUnits="userSpaceOnUse"'
    line = f"M30 {HEIGHT_MM + 3:g}v4m0 -2h100m0 -2v4"
    return f"""\
<svg xmlns="http://www.w3.org/2000/svg" {size}>
<title>Dots of {DOT_DIAMETER_MM:g} mm, {DOT_PITCH_MM:g} mm apart, for a sheet of a unit on a desk</title>
<defs><pattern id="p" {lattice}>{circles}</pattern></defs>
<rect width="{WIDTH_MM:g}" height="{HEIGHT_MM:g}" fill="url(#p)"/>
<path d="{line}" stroke="#000000" stroke-width="0.2" fill="none"/>
<text x="80" y="{HEIGHT_MM + 10:g}" font-size="4" text-anchor="middle" font-family="sans-serif">\
this line is 100 mm long</text>
</svg>
"""
