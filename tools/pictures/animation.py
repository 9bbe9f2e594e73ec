"""Convert successive terminal screens to an animated SVG: sharp at any size, small, without a script."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from tools.pictures.terminal import Run, Screen

_LETTER_WIDTH, _LINE_HEIGHT, _MARGIN = 7.2, 16, 12
"""Sizes for a monospaced font of 12 px, px."""
_COLOURS = {"31": "#f47067", "32": "#57ab5a"}
_INK, _DIM, _GROUND = "#d6dde6", "#8b949e", "#161b22"


@dataclass(frozen=True, slots=True)
class Still:
    """A screen and its display time."""

    screen: Screen
    seconds: float


def animated_svg(stills: Sequence[Still], columns: int, rows: int, title: str) -> str:
    """The SVG, which repeats indefinitely. Unchanged lines are drawn once for their whole time."""
    whole_s = sum(still.seconds for still in stills)
    width = columns * _LETTER_WIDTH + 2 * _MARGIN
    height = rows * _LINE_HEIGHT + 2 * _MARGIN
    drawn: list[str] = []
    rules: list[str] = []
    for row in range(rows):
        for runs, begin_s, end_s in _intervals(stills, row):
            if not runs:
                continue
            if (begin_s, end_s) == (0.0, whole_s):
                drawn.append(f"<g>{_line(runs, row)}</g>")
                continue
            name = f"a{len(rules)}"
            begin, end = (100 * moment_s / whole_s for moment_s in (begin_s, end_s))
            rules.append(_rule(name, begin, end))
            drawn.append(f'<g class="t" style="animation-name:{name}">{_line(runs, row)}</g>')
    style = (
        f"text{{font:12px ui-monospace,'DejaVu Sans Mono',Menlo,Consolas,monospace;fill:{_INK};"
        f"white-space:pre}}.b{{font-weight:700}}.d{{fill:{_DIM}}}"
        f".t{{visibility:hidden;animation:{whole_s:.2f}s step-end infinite}}"
    )
    style += "".join(f".c{code}{{fill:{colour}}}" for code, colour in _COLOURS.items())
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" height="{height:.0f}" role="img"><title>{escape(title)}</title>\n'
        f"<style>{style}\n{''.join(rules)}</style>\n"
        f'<rect width="100%" height="100%" rx="8" fill="{_GROUND}"/>\n' + "\n".join(drawn) + "\n</svg>\n"
    )


def _intervals(stills: Sequence[Still], row: int) -> list[tuple[tuple[Run, ...], float, float]]:
    """Texts of a row, each with the start and end of its display, s."""
    intervals: list[tuple[tuple[Run, ...], float, float]] = []
    at_s = 0.0
    for still in stills:
        runs = still.screen[row] if row < len(still.screen) else ()
        if intervals and intervals[-1][0] == runs:
            intervals[-1] = runs, intervals[-1][1], at_s + still.seconds
        else:
            intervals.append((runs, at_s, at_s + still.seconds))
        at_s += still.seconds
    return intervals


def _rule(name: str, begin: float, end: float) -> str:
    """CSS rule that shows an element from ``begin`` to ``end``, in per cent of the animation."""
    steps = [f"{begin:.2f}%{{visibility:visible}}"]
    if begin > 0:
        steps.insert(0, "0%{visibility:hidden}")
    if end < 99.995:
        steps.append(f"{end:.2f}%{{visibility:hidden}}")
    return f"@keyframes {name}{{{''.join(steps)}}}\n"


def _line(runs: Sequence[Run], row: int) -> str:
    y = _MARGIN + (row + 0.78) * _LINE_HEIGHT
    return "".join(
        f'<text x="{_MARGIN + run.column * _LETTER_WIDTH:.1f}" y="{y:.1f}" '
        f'textLength="{len(run.text) * _LETTER_WIDTH:.1f}"{_class(run)}>{escape(run.text)}</text>'
        for run in runs
    )


def _class(run: Run) -> str:
    names = [
        {"1": "b", "2": "d"}.get(code) or (f"c{code}" if code in _COLOURS else "")
        for code in sorted(run.style)
    ]
    names = [name for name in names if name]
    return f' class="{" ".join(names)}"' if names else ""
