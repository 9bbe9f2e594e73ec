"""``docs/states.svg``: the states, their causes and their transitions, from the code."""

from html import escape

from altd.reasons import Reason, Signal
from altd.status.cause import HOLD_S, MAINTENANCE_DELAY_S, Kind, signal_of
from altd.status.conditions import Condition

WIDTH_PX = 860
_LEFT_PX, _RIGHT_PX = 190, 670
_LINE_PX, _TITLE_PX, _GAP_PX, _TOP_PX = 17, 26, 22, 34
_COLUMNS = 3
_COLOURS = {
    Signal.FAILURE: ("#c62828", "#ffffff"),
    Signal.CHECK_FUNCTION: ("#ef8a17", "#000000"),
    Signal.OUT_OF_SPECIFICATION: ("#f6d515", "#000000"),
    Signal.MAINTENANCE_REQUIRED: ("#1565c0", "#ffffff"),
    Signal.GOOD: ("#2e7d32", "#ffffff"),
}
"""Colours of NE 107: red, orange, yellow, blue, green. Each box also shows the name of its state."""


def causes_of(signal: Signal) -> list[Kind]:
    """Causes of a signal, reasons of the measurement first."""
    kinds: list[Kind] = [*Reason, *Condition]
    return [kind for kind in kinds if signal_of(kind) is signal]


def by_severity() -> list[Signal]:
    """Signals, most severe first."""
    return sorted(Signal, key=lambda signal: -signal.severity)


def picture() -> str:
    """SVG text, with a newline at its end."""
    shapes: list[str] = []
    top_px = _TOP_PX
    middles: dict[Signal, int] = {}
    for signal in by_severity():
        box, height_px = _box(signal, top_px)
        shapes += box
        middles[signal] = top_px + height_px // 2
        top_px += height_px + _GAP_PX
    shapes += _arrows(middles)
    body = "\n".join(f"  {shape}" for shape in shapes)
    height_px = top_px - _GAP_PX + 16
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_PX}" height="{height_px}"
    viewBox="0 0 {WIDTH_PX} {height_px}" font-family="sans-serif" font-size="12" role="img">
  <title>The states of the unit, the worst on top</title>
  <defs><marker id="tip" markerWidth="10" markerHeight="10" refX="8" refY="4" orient="auto">
    <path d="M0,0 L9,4 L0,8 z"/></marker></defs>
  <rect width="{WIDTH_PX}" height="{height_px}" fill="#ffffff"/>
{body}
</svg>
"""


def _box(signal: Signal, top_px: int) -> tuple[list[str], int]:
    kinds = causes_of(signal)
    rows = -(-len(kinds) // _COLUMNS)
    height_px = _TITLE_PX + rows * _LINE_PX + (8 if rows else -4)
    fill, ink = _COLOURS[signal]
    width_px = _RIGHT_PX - _LEFT_PX
    title = f"{str(signal).replace('_', ' ')} ({signal.number})"
    box = [
        f'<rect x="{_LEFT_PX}" y="{top_px}" width="{width_px}" height="{height_px}" rx="6" fill="#fafafa" '
        f'stroke="{fill}" stroke-width="2"/>',
        f'<rect x="{_LEFT_PX}" y="{top_px}" width="{width_px}" height="{_TITLE_PX - 4}" rx="6" '
        f'fill="{fill}"/>',
        _text(_LEFT_PX + 10, top_px + 16, title, ink, 'font-weight="bold"'),
    ]
    for index, kind in enumerate(kinds):
        column, row = divmod(index, rows)
        x_px = _LEFT_PX + 10 + column * (width_px - 10) // _COLUMNS
        box.append(_text(x_px, top_px + _TITLE_PX + 12 + row * _LINE_PX, str(kind), "#000000"))
    return box, height_px


def _arrows(middles: dict[Signal, int]) -> list[str]:
    worst_px, good_px = middles[Signal.FAILURE], middles[Signal.GOOD]
    check_px, maintenance_px = middles[Signal.CHECK_FUNCTION], middles[Signal.MAINTENANCE_REQUIRED]
    left_px, near_px, right_px = _LEFT_PX - 24, _LEFT_PX - 3, _RIGHT_PX + 24
    arrows = [f'<path d="M{_LEFT_PX},{good_px} H{left_px} V{worst_px} H{near_px}" {_LINE}/>']
    arrows += [
        f'<path d="M{left_px},{middles[signal]} H{near_px}" {_LINE}/>'
        for signal in by_severity()
        if signal not in (Signal.FAILURE, Signal.GOOD)
    ]
    arrows += [
        f'<path d="M{_RIGHT_PX},{worst_px} H{right_px} V{good_px} H{_RIGHT_PX + 3}" {_LINE}/>',
        *(
            f'<path d="M{right_px},{middles[signal]} H{_RIGHT_PX + 3}" {_LINE}/>'
            for signal in by_severity()
            if signal not in (Signal.FAILURE, Signal.GOOD)
        ),
    ]
    start_px = _LEFT_PX - 96
    arrows += [
        f'<circle cx="{start_px}" cy="{check_px - 14}" r="5"/>',
        f'<path d="M{start_px},{check_px - 14} H{near_px}" {_LINE}/>',
        _text(16, check_px - 24, "the daemon starts", "#000000"),
        *_paragraph(
            16,
            (check_px + maintenance_px) // 2 + 10,
            ["a cause comes", "that is worse:", "at once"],
        ),
        *_paragraph(
            16, maintenance_px - 8, ["maintenance:", "when it is true for", f"{MAINTENANCE_DELAY_S:g} s"]
        ),
        *_paragraph(
            right_px + 10,
            (check_px + maintenance_px) // 2 - 10,
            ["its last cause was", f"not true for {HOLD_S:g} s:", "the worst of what", "is left"],
        ),
        *_paragraph(
            right_px + 10,
            maintenance_px - 8,
            ["maintenance:", f"for {MAINTENANCE_DELAY_S:g} s"],
        ),
    ]
    return arrows


_LINE = 'fill="none" stroke="#000000" stroke-width="1.3" marker-end="url(#tip)"'


def _paragraph(x_px: int, y_px: int, lines: list[str]) -> list[str]:
    return [_text(x_px, y_px + number * 15, line, "#000000") for number, line in enumerate(lines)]


def _text(x_px: int, y_px: int, text: str, ink: str, more: str = "") -> str:
    return f'<text x="{x_px}" y="{y_px}" fill="{ink}"{f" {more}" if more else ""}>{escape(text)}</text>'
