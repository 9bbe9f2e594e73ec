"""The screen of ``altd watch``: the knowledge of a unit, drawn into the available rows and columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from altd.reasons import Reason
from altd.records import counted
from altd.status.health import duration
from altd.terminal.canvas import Canvas, PlotCells, Style, draw_target, draw_trend, limits_of, rows_for
from altd.terminal.documents import Shown, StatusDocument
from altd.terminal.knowledge import Knowledge, Moment
from altd.terminal.lines import (
    availability_text,
    cause_text,
    hanging,
    number_text,
    of_desk,
    self_check_text,
    state_text,
    verdict_text,
)

MIN_ROWS, MIN_COLUMNS = 16, 60
"""Minimum size; a smaller screen reports it and shows only the numbers."""

_NUMBER_COLUMNS = 46
_SCALE_COLUMNS = 12
_MAX_STEP_S = 2.0
_TREND_S = 60.0
_MIN_CAUSE_ROWS = 3
_MAX_WHY_ROWS = 6
_STYLES = {"good": Style.GOOD, "failure": Style.BAD}
_KEYS = "tab, arrows: {pages}  h: help  q: quit"


@dataclass(frozen=True, slots=True)
class ScreenView:
    """The view: number of the page, number of its lines above the screen, help or not."""

    page: int = 0
    above: int = 0
    help: bool = False

    def pressed(self, key: str) -> ScreenView:
        """Return the view after a key: ``tab``, ``left``, ``right``, ``up``, ``down`` or a character."""
        if self.help or key in ("h", "?"):
            return replace(self, help=not self.help)
        match key:
            case "tab" | "right":
                return ScreenView((self.page + 1) % len(PAGES))
            case "left":
                return ScreenView((self.page - 1) % len(PAGES))
            case "up":
                return replace(self, above=max(self.above - 1, 0))
            case "down":
                return replace(self, above=self.above + 1)
        return self


def draw(knowledge: Knowledge, now_s: float, view: ScreenView, canvas: Canvas) -> ScreenView:
    """Draw the whole screen; return the view, with ``above`` limited to what its page has."""
    moment = knowledge.at(now_s)
    _head(canvas, moment)
    if canvas.rows < MIN_ROWS or canvas.columns < MIN_COLUMNS:
        if not moment.lost:
            canvas.put(2, 0, f"make the window larger: {MIN_COLUMNS} x {MIN_ROWS} at least", Style.WARNING)
            for row, number in enumerate(moment.numbers, start=3):
                _number(canvas, row, moment, number, canvas.columns)
        return view
    if view.help:
        _lines(canvas, list(_HELP), 0)
    elif not moment.lost:
        above = PAGES[view.page][1](canvas, knowledge, moment, now_s, view)
        view = replace(view, above=above)
    names = " ".join(f"[{name}]" if page == view.page else name for page, (name, _) in enumerate(PAGES))
    canvas.put(canvas.rows - 1, 0, _KEYS.format(pages=names), Style.DIM)
    return view


def _head(canvas: Canvas, moment: Moment) -> None:
    """Draw the unit with its state, and whether it measures."""
    status = moment.status
    if moment.lost:
        canvas.put(0, 0, "NO CONNECTION: nothing is known of the unit now", Style.BAD)
        why = hanging("", f"{moment.lost}; it is asked again and again", max(canvas.columns - 1, 1), 0)
        for offset, line in enumerate(why[:_MAX_WHY_ROWS]):
            canvas.put(1 + offset, 0, line, Style.BAD)
        return
    if status is None:
        canvas.put(0, 0, "the unit's state is not known", Style.BAD)
    else:
        state = status.state
        text = f"{status.serial}{of_desk(status)}  {state_text(state.signal)} for {duration(state.for_s)}"
        canvas.put(0, 0, text, _STYLES.get(status.state.signal, Style.WARNING))
        version = f"altd {status.version}"
        if len(text) + 2 + len(version) <= canvas.columns:
            canvas.put(0, canvas.columns - len(version), version, Style.DIM)
    canvas.put(1, 0, *_verdict(moment))


def _verdict(moment: Moment) -> tuple[str, Style]:
    reading = moment.reading
    if reading is None:
        return "NOT VALID: nothing has been measured yet", Style.BAD
    codes, verdict = ", ".join(reading.status), verdict_text(reading)
    if not reading.valid:
        return f"{verdict}: {codes}", Style.BAD
    age = "of unknown age" if moment.age_s is None else f"{moment.age_s:.1f} s old"
    text = f"{verdict}, {age}, mean of {counted(reading.frames, 'exposure')}" + (
        f"; {codes}" if codes else ""
    )
    return text, Style.GOOD if verdict == "VALID" else Style.WARNING


def _number(canvas: Canvas, row: int, moment: Moment, number: Shown, width: int) -> None:
    text = number_text(number, moment.reading is not None and moment.reading.valid, width)
    canvas.put(row, 0, text, Style.BOLD if number.value is not None else Style.DIM, width)


def _targets_page(canvas: Canvas, knowledge: Knowledge, moment: Moment, now_s: float, _: ScreenView) -> int:
    """Draw both targets, the numbers with their trends, and as many causes as fit."""
    numbers = moment.numbers
    causes = _cause_lines(moment.status, canvas.columns)
    below = 1 + max(len(numbers), 4) + 1
    room = canvas.rows - 2 - 1 - below - 1
    cause_rows = min(len(causes), max(_MIN_CAUSE_ROWS, room // 3))
    picture_rows = _pictures(canvas, knowledge, moment, now_s, room - cause_rows)
    row = 3 + picture_rows + 1
    width = canvas.columns - _NUMBER_COLUMNS
    step_s = min(max(_TREND_S / width, 1.0), _MAX_STEP_S) if width > 0 else 1.0
    for offset, number in enumerate(numbers):
        _number(canvas, row + offset, moment, replace(number, also=None), _NUMBER_COLUMNS)
        trend = knowledge.trend(number.key, now_s, width, step_s)
        draw_trend(canvas, row + offset, _NUMBER_COLUMNS, 1, trend, number.sigma)
    row += max(len(numbers), 4)
    if numbers:
        canvas.put(row, _NUMBER_COLUMNS, f"trend of the last {width * step_s:.0f} s", Style.DIM)
    left = canvas.rows - 1 - (row + 1)
    for offset, (line, style) in enumerate(causes[:left]):
        canvas.put(row + 1 + offset, 0, line, style)
    if len(causes) > left:
        canvas.put(canvas.rows - 2, 0, f"{'... more on the page of causes':<{canvas.columns}}", Style.WARNING)
    return 0


def _pictures(canvas: Canvas, knowledge: Knowledge, moment: Moment, now_s: float, rows: int) -> int:
    """Draw the targets next to each other from row 3 on; return the number of rows used."""
    targets = moment.targets
    if targets is None or not targets.targets or rows < 1:
        return 0
    columns = canvas.columns // len(targets.targets) - 1
    if columns < 1:
        return 0
    rows = min(rows, rows_for(targets, columns))
    frame = PlotCells.holding(targets, 3, 0, rows, columns)
    for number, target in enumerate(targets.targets):
        column = number * (columns + 1)
        spot = None if moment.reading is None else moment.reading.spots.get(target.name)
        place = _why_no_spot(moment, target.name) if spot is None else f"x {spot[0]:.2f}  y {spot[1]:.2f} mm"
        canvas.put(2, column, f"{target.name}: {place}", Style.PLAIN if spot else Style.DIM, columns)
        path = knowledge.path(target.name, now_s)
        draw_target(canvas, replace(frame, column=column), targets, target.name, path, spot)
    return rows


def _why_no_spot(moment: Moment, target: str) -> str:
    """Return the target's own reason, or the state of its camera; never another target's reason."""
    codes = () if moment.reading is None else moment.reading.status
    own = [reason.brief for reason in Reason if f"{target}_{reason}" in codes and not reason.is_warning]
    camera = None if moment.status is None else moment.status.components.get(f"camera {target}")
    if own or camera is None:
        return "; ".join(own) or "no spot known"
    return "camera ok, not measured" if camera.state == "ok" else f"camera {camera.state}: {camera.message}"


def _trends_page(canvas: Canvas, knowledge: Knowledge, moment: Moment, now_s: float, _: ScreenView) -> int:
    """Draw each number as large as possible, one column per second."""
    rows = (canvas.rows - 4) // max(len(moment.numbers), 1) - 1
    width = canvas.columns - _SCALE_COLUMNS
    for place, number in enumerate(moment.numbers):
        row = 2 + place * (rows + 1)
        _number(canvas, row, moment, number, canvas.columns)
        trend = knowledge.trend(number.key, now_s, width, 1.0)
        if rows > 0:
            draw_trend(canvas, row + 1, _SCALE_COLUMNS, rows, trend, number.sigma)
            _scale(canvas, row + 1, rows, number, limits_of(trend, number.sigma))
    canvas.put(canvas.rows - 2, _SCALE_COLUMNS, f"trend of the last {width} s", Style.DIM)
    return 0


def _scale(canvas: Canvas, row: int, rows: int, number: Shown, limits: tuple[float, float] | None) -> None:
    if limits is None:
        return
    low, high = limits
    canvas.put(row, 0, f"{high:>11.{number.decimals}f}", Style.DIM, _SCALE_COLUMNS)
    if rows > 1:
        canvas.put(row + rows - 1, 0, f"{low:>11.{number.decimals}f}", Style.DIM, _SCALE_COLUMNS)


def _causes_page(canvas: Canvas, _: Knowledge, moment: Moment, __: float, view: ScreenView) -> int:
    """Draw every cause with its remedy."""
    lines = _cause_lines(moment.status, canvas.columns)
    if moment.status is not None and not lines:
        lines = [("nothing is wrong", Style.GOOD)]
    return _lines(canvas, lines, view.above)


def _parts_page(canvas: Canvas, _: Knowledge, moment: Moment, __: float, view: ScreenView) -> int:
    """Draw availability, the last self-check and the components."""
    status, lines = moment.status, list[tuple[str, Style]]()
    if status is None:
        return 0
    facts = {"available": availability_text(status), "calibration": status.calibration}
    if moment.check is not None:
        facts["self-check"] = self_check_text(moment.check)
    for name, text in facts.items():
        lines += [(line, Style.PLAIN) for line in hanging(name, text, canvas.columns - 1, 13)]
    lines.append(("", Style.PLAIN))
    for name, component in status.components.items():
        style = Style.PLAIN if component.state == "ok" else Style.WARNING
        lines.append((f"{name:<40} {component.state:<10}{duration(component.for_s)}", style))
        if component.message:
            lines += [(line, Style.DIM) for line in hanging("", component.message, canvas.columns - 1, 4)]
    return _lines(canvas, lines, view.above)


def _cause_lines(status: StatusDocument | None, columns: int) -> list[tuple[str, Style]]:
    """The causes, the worst first, wrapped."""
    return [
        (line, Style.BAD if cause.signal == "failure" else Style.WARNING)
        for cause in (status.state.causes if status else ())
        for line in hanging("-", cause_text(cause), columns - 1, 2)
    ]


def _lines(canvas: Canvas, lines: list[tuple[str, Style]], above: int) -> int:
    """Draw a list that may be longer than the screen, from line ``above`` on; return that, limited."""
    rows = canvas.rows - 4
    above = min(above, max(len(lines) - rows, 0))
    for offset, (line, style) in enumerate(lines[above : above + rows]):
        canvas.put(3 + offset, 0, line, style)
    if len(lines) > rows:
        shown = f"lines {above + 1} to {min(above + rows, len(lines))} of {len(lines)}: up, down"
        canvas.put(2, canvas.columns - len(shown) - 1, shown, Style.DIM)
    return above


Page = Callable[[Canvas, Knowledge, Moment, float, ScreenView], int]
"""Draws a page; returns the number of its lines above the screen."""

PAGES: tuple[tuple[str, Page], ...] = (
    ("targets", _targets_page),
    ("trends", _trends_page),
    ("causes", _causes_page),
    ("parts", _parts_page),
)

_HELP = tuple(
    (line, Style.PLAIN)
    for line in """\
tab, right, left   the next page, the one before
up, down           move in a list that is longer than the screen
h, ?               this help; any key leaves it
q, Ctrl-C          quit

targets  where the laser spots are, as seen along the beam, to scale: O is the
         spot, the dots are its path of the last 10 s; + are the middle and the
         corners of the unit's area; the line is around what is valid
trends   how each number went
causes   causes and remedies, the worst first
parts    availability, the last self-check, the parts of the unit

+/- is the standard uncertainty (1 sigma) of the mean, "now" that of the value as
a statement about the beam at this moment. Unknown values are not shown.""".splitlines()
)
