"""A study's page and plot, and the index over all pages: made, written, compared with what is stored."""

import re
import statistics
import textwrap
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path

from altd.errors import BadInputError
from studies.plot import as_svg
from studies.result import Result
from studies.result_table import table
from tools.markdown import wrapped

MAX_LINE = 120
MAX_SHIFT_PT = 0.05
_COORDINATE = re.compile(r"\d+\.\d+")
FURTHER = (
    ("peers.md", "altd compared with other libraries", "none today"),
    ("campaign.md", "Disturbed measurements, judged by truth", "`make campaign`"),
    ("faults.md", "The whole daemon, disturbed and judged on its interfaces", "`make faults`"),
    ("wire-errors.md", "Errors on wires to a reader", "none today"),
    ("load.md", "Clients of all interfaces at once", "none today"),
    ("page.md", "The page in Chromium", "none today"),
    ("cameras.md", "Cameras: forged packets, automatic exposure, bit depth", "`make bench-spray`"),
)
"""Pages of other programs: file, title and the command that measures it."""

INDEX = """\
# Studies

This page lists the studies: experiments of the thesis on simulated parts, and measurements of altd itself.

Each study of the table repeats an experiment with simulated parts (`hw_sim`) and altd's own commands, and
compares its figures with those of the thesis ([all its items](../source.md)). `make studies` runs all and
writes these pages; `python -m studies NAME` runs one and prints its table. All seeds are fixed: the same
code gives the same pages, and `make studies-check` fails if a page differs from what the code prints.

The parts are simulated, with lenses, print, speckle, noise and stage errors. Rows that end with *hard* are
from the [harder simulator](../decisions/0005-simulator.md). Each page names what is worse than in the thesis,
and by how much figures are worse on the harder simulator.

"""


def files_of(name: str, title: str, question: str, result: Result) -> dict[str, str]:
    """The texts of ``name``.md and ``name``.svg, by these names."""
    return {f"{name}.md": page(name, title, question, result), f"{name}.svg": as_svg(result.figure, name)}


def write(folder: Path, files: Mapping[str, str]) -> None:
    """Write files, by their names, into a folder; raises BadInputError when that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text)
    except OSError as error:
        raise BadInputError(folder, f"cannot be written: {error.strerror or error}") from error


def differences(folder: Path, files: Mapping[str, str]) -> list[str]:
    """For each file that a folder does not hold as it was made, its first line that differs.

    The last digit of a plot's coordinates does not count, because it depends on the processor.
    """
    found = []
    for name, made in files.items():
        path = folder / name
        stored = path.read_text() if path.is_file() else ""
        is_same = _is_same_drawing if path.suffix == ".svg" else str.__eq__
        lines = zip_longest(stored.split("\n"), made.split("\n"), fillvalue="(the end)")
        for number, (before, now) in enumerate(lines, 1):
            if not is_same(before, now):
                shown = f"stored: {before[:MAX_LINE]}\n    made:   {now[:MAX_LINE]}"
                found.append(f"{path}:{number} differs\n    {shown}")
                break
    return found


def _is_same_drawing(before: str, now: str) -> bool:
    coordinates = zip(_COORDINATE.findall(before), _COORDINATE.findall(now), strict=False)
    is_near = all(abs(float(one) - float(other)) < MAX_SHIFT_PT for one, other in coordinates)
    return is_near and _COORDINATE.sub("", before) == _COORDINATE.sub("", now)


def page(name: str, title: str, question: str, result: Result) -> str:
    """The page: its second paragraph is the headline, which the index repeats."""
    parts = [
        f"# {title}",
        result.headline,
        f"*{question}*",
        f"Thesis: {result.thesis_source}.",
        f"Different here: {result.differs}." if result.differs else "",
        table(result).rstrip(),
        verdict(result),
        f"![{title}]({name}.svg)",
        f"*{result.caption}*",
        _reflow(result.text),
        f"Made by `python -m studies {name}`; all studies: [index](README.md).",
    ]
    return wrapped("\n\n".join(part for part in parts if part) + "\n")


def _reflow(text: str) -> str:
    """Paragraphs with lines of even length, whatever numbers were put in."""
    paragraphs = text.strip().split("\n\n")
    return "\n\n".join(textwrap.fill(paragraph, MAX_LINE, break_on_hyphens=False) for paragraph in paragraphs)


def verdict(result: Result) -> str:
    """The figures that are worse than in the thesis or on the harder simulator; empty where none are."""
    said = []
    if result.compared():
        worse = "; ".join(f"{column} ({row})" for row, column in result.worse()) or "nothing"
        said.append(f"Worse than {'the thesis' if result.beside == 'thesis' else result.beside}: {worse}.")
    if ratios := sorted(result.hardened(), key=lambda ratio: ratio[2]):
        row, column, most = ratios[-1]
        median = statistics.median(ratio for _, _, ratio in ratios)
        count = sum(ratio > 1 for _, _, ratio in ratios)
        said.append(
            f"Harder simulator: {count} of {len(ratios)} figures are worse than on the ordinary one; the "
            f"median is {median:.1f} times as large, the worst {most:.1f} times ({column}; {row})."
        )
    return "\n\n".join(said)


def index(folder: Path, studies: Iterable[tuple[str, str]]) -> str:
    """README.md over the pages (name, title) that are in the folder, each with its headline."""
    lines = ["| study | in short |", "|---|---|"]
    for name, title in studies:
        path = folder / f"{name}.md"
        if path.is_file():
            headline = " ".join(path.read_text().split("\n\n")[1].split("\n"))
            lines.append(f"| [{title}]({name}.md) | {headline} |")
    further = [
        f"| [{title}]({name}) | {command} |" for name, title, command in FURTHER if (folder / name).is_file()
    ]
    if further:
        lines += ["", "| further study | command |", "|---|---|", *further]
    return INDEX + "\n".join(lines) + "\n"
