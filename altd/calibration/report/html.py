"""The report as one self-contained HTML page: pictures inside, no script, no font, no link."""

from __future__ import annotations

import base64
import io
from html import escape

from matplotlib.figure import Figure

from altd.calibration.report.document import (
    WIDTH_IN,
    Banner,
    Block,
    Document,
    Heading,
    Level,
    Picture,
    Row,
    Table,
    Words,
)
from altd.calibration.report.target_plots import SizedFigure, report_style
from altd.calibration.report.write import meta_line

MARKS = {Level.GOOD: "✓", Level.USABLE: "!", Level.UNDECIDED: "?", Level.BAD: "✗"}
"""Symbols in addition to colour and word, for readers who cannot see the colours."""

_NOTHING_FROM_OUTSIDE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

_CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 60rem; background: #fff; color: #1a1a1a;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  -webkit-text-size-adjust: 100%; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .3rem 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; padding-top: .7rem; border-top: 1px solid #d5d9de; }
.subtitle { color: #5f6670; margin: 0 0 1.2rem; overflow-wrap: anywhere; }
.verdict { border-left: .5rem solid; padding: .8rem 1.1rem; border-radius: .3rem; print-color-adjust: exact;
  -webkit-print-color-adjust: exact; }
.verdict + .verdict { margin-top: .6rem; }
.verdict p { margin: .5rem 0 0; }
.verdict .headline { font-size: 1.3rem; font-weight: 650; line-height: 1.3; margin: 0; }
.verdict.good { border-color: #0072b2; background: #eaf4fa; }
.verdict.usable, .verdict.undecided { border-color: #e69f00; background: #fdf5e3; }
.verdict.bad { border-color: #d55e00; background: #fcece3; }
.mark { position: fixed; inset: 0; display: grid; place-items: center; pointer-events: none; z-index: 1;
  font-size: min(17vw, 20vh); font-weight: 700; color: #d55e00; opacity: .13; rotate: -38deg;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.wide { overflow-x: auto; margin-top: .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .32rem .8rem .32rem 0;
  border-bottom: 1px solid #e6e9ec; overflow-wrap: anywhere; }
th { font-weight: 600; color: #5f6670; border-bottom-color: #9aa1a9; }
td.level { white-space: nowrap; font-weight: 600; background: none; }
td.level.good { color: #005a8c; }
td.level:is(.usable, .undecided) { color: #8a5a00; } td.level.bad { color: #a84300; }
figure { margin: 1rem 0 0; }
.pictures { display: flex; flex-wrap: wrap; gap: .6rem 1.2rem; }
.pictures img { flex: 1 1 20rem; min-width: 0; width: 100%; max-width: 29rem; height: auto;
  align-self: flex-start; }
figcaption { color: #444b54; font-size: .9rem; margin-top: .4rem; max-width: 46rem; }
@media (max-width: 34rem) {
  body { padding: .8rem .8rem 2rem; }
  .pictures img { flex-basis: 100%; }
  table, tbody, tr, td { display: block; }
  tr.columns { display: none; }
  tr { padding: .45rem 0; border-bottom: 1px solid #d5d9de; }
  td { border: 0; padding: .05rem 0; }
  td:first-child { font-weight: 600; }
  td[data-of]::before { content: attr(data-of) " "; color: #5f6670; }
}
@page { size: A4; margin: 14mm 15mm; }
@media print {
  html { font-size: 9.5pt; }
  body { padding: 0; max-width: none; }
  h2 { break-after: avoid; margin-top: 1.4rem; }
  figure, tr, .verdict { break-inside: avoid; }
  .pictures img { flex: 0 0 calc(50% - .6rem); max-width: calc(50% - .6rem); }
  .wide { overflow: visible; }
}
"""


def html_page(document: Document) -> bytes:
    """Render the document as HTML, UTF-8."""
    with report_style():
        body = "\n".join(_block(block) for block in document.blocks)
    title, subtitle = escape(document.title), escape(document.subtitle)
    mark = f'<div class="mark" aria-hidden="true">{escape(document.mark)}</div>\n' if document.mark else ""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
{meta_line(document.checksum)}
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_NOTHING_FROM_OUTSIDE}">
<title>{title}</title>
<style>{_CSS}</style>
</head>
<body>
{mark}<h1>{title}</h1>
<p class="subtitle">{subtitle}</p>
{body}
</body>
</html>
""".encode()


def svg(picture: Picture) -> bytes:
    """Render one drawing as SVG; call it within ``report_style()``."""
    figure = Figure(figsize=(WIDTH_IN, picture.height_in))
    picture.draw(SizedFigure(figure, WIDTH_IN, picture.height_in))
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return file.getvalue()


def _block(block: Block) -> str:
    match block:
        case Heading(text):
            return f"<h2>{escape(text)}</h2>"
        case Words(text):
            return f"<p>{escape(text)}</p>"
        case Banner(level, headline, lines):
            paragraphs = "".join(f"<p>{escape(line)}</p>" for line in lines)
            first = f'<p class="headline">{MARKS[level]} {escape(headline)}</p>'
            return f'<div class="verdict {_class(level)}">{first}{paragraphs}</div>'
        case Table():
            return _table(block)
        case Row():
            return _row(block)


def _row(row: Row) -> str:
    images = "".join(
        f'<img alt="{escape(picture.words)}" width="{96 * WIDTH_IN:.0f}" '
        f'height="{96 * picture.height_in:.0f}" '
        f'src="data:image/svg+xml;base64,{base64.b64encode(svg(picture)).decode()}">\n'
        for picture in row.pictures
    )
    caption = f"<figcaption>{escape(row.caption)}</figcaption>" if row.caption else ""
    return f'<figure><div class="pictures">\n{images}</div>{caption}</figure>'


def _table(table: Table) -> str:
    lines = []
    if any(table.columns):
        heads = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
        lines.append(f'<tr class="columns">{heads}</tr>')
    for number, row in enumerate(table.rows):
        level = table.levels[number] if table.levels else None
        cells = []
        for place, cell in enumerate(row):
            named = bool(place and table.columns and table.columns[place])
            of = f' data-of="{escape(table.columns[place])}"' if named else ""
            if level is not None and place == len(row) - 1:
                cells.append(f'<td class="level {_class(level)}">{MARKS[level]} {escape(cell)}</td>')
            else:
                cells.append(f"<td{of}>{escape(cell)}</td>")
        lines.append(f"<tr>{''.join(cells)}</tr>")
    widths = "".join(f'<col style="width: {100 * share:.0f}%">' for share in table.shares)
    rows = "\n".join(lines)
    return f'<div class="wide"><table><colgroup>{widths}</colgroup><tbody>\n{rows}\n</tbody></table></div>'


def _class(level: Level) -> str:
    return level.name.lower()
