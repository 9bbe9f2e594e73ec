"""``python -m studies``: run the studies, print their tables, write their pages or check them."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from altd.errors import BadInputError

if TYPE_CHECKING:
    from studies.result import Progress, Result

PAGES = Path(__file__).resolve().parents[1] / "docs" / "studies"
MAX_CHEAP_CPU_S = 10
"""Of a study that is made in each turn."""

STUDIES = {
    "conic": 8,
    "table-2.1": 80,
    "planar-errors": 190,
    "two-cameras": 28,
    "milky": 145,
    "table-3.1": 224,
    "table-3.2": 28,
    "table-3.3": 52,
    "table-3.4": 183,
    "fig-3.5": 2,
    "fig-3.17": 22,
    "fig-3.19": 80,
    "averaging": 80,
    "sigma-now": 306,
    "output-now": 103,
    "ambient": 64,
    "laser": 87,
    "beam": 318,
    "beam-forms": 300,
    "filters": 250,
    "chessboard": 59,
    "budget": 35,
    "kinematics": 10,
    "chain": 29,
    "switched": 269,
    "vibration": 15,
    "pairing": 33,
    "learnt-pattern": 126,
    "desk": 155,
}
"""Names, and about the seconds of CPU that each takes, by which they are dealt out to turns."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the studies on the command line."""
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(STUDIES)}; default all")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write pages and plots there too")
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; list pages and plots, of DIR or docs/studies, that are not as they are made now",
    )
    parser.add_argument(
        "--turn",
        type=_turn,
        default=(0, 1),
        metavar="K/N",
        help="the cheap studies and, of the others in N turns, those of turn K modulo N",
    )


def _turn(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(count)):
        raise argparse.ArgumentTypeError(f"must be two whole numbers as 3/4: {text!r}")
    return int(number), int(count)


def in_turn(number: int, count: int) -> list[str]:
    """Names of the cheap studies, and of those of one of ``count`` turns that cost about the same."""
    turns: list[list[str]] = [[] for _ in range(count)]
    for name in sorted(STUDIES, key=lambda name: -STUDIES[name]):
        if STUDIES[name] > MAX_CHEAP_CPU_S:
            min(turns, key=lambda turn: sum(STUDIES[each] for each in turn)).append(name)
    due = turns[number % count]
    return [name for name, cpu_s in STUDIES.items() if cpu_s <= MAX_CHEAP_CPU_S or name in due]


def run(arguments: argparse.Namespace) -> int:
    """Run the studies one after the other; raises BadInputError."""
    names: list[str] = arguments.names or in_turn(*arguments.turn)
    for name in names:
        if name not in STUDIES:
            raise BadInputError("NAME", f"unknown study {name!r}; known are {', '.join(STUDIES)}")
    try:
        importlib.import_module("matplotlib")
    except ImportError as error:
        raise BadInputError("matplotlib", "is not installed: pip install 'altd[report]'") from error
    folder = arguments.output
    if folder is not None and folder.exists() and not folder.is_dir():
        raise BadInputError(folder, "is not a folder")
    if arguments.check:
        return _check(folder or PAGES, names)
    from studies.result_table import table
    from studies.study_page import files_of, verdict, write

    for name in names:
        study, result = _result(name)
        print(f"{study.TITLE}\n\n{table(result)}\n{result.headline}")
        if said := verdict(result):
            print(said)
        print(flush=True)
        if folder is not None:
            write(folder, files_of(name, study.TITLE, study.QUESTION, result))
            write(folder, _index(folder))
    return 0


def _check(folder: Path, names: list[str]) -> int:
    """Make the pages and the index, and print where the stored ones differ; 1 if one does."""
    from studies.study_page import differences, files_of

    found: list[str] = []
    for name in names:
        began_s, before = time.process_time(), len(found)
        try:
            study, result = _result(name)
            found += differences(folder, files_of(name, study.TITLE, study.QUESTION, result))
        except (BadInputError, RuntimeError) as error:
            found.append(f"{name} cannot be made: {error}")
        said = "as stored" if len(found) == before else "DIFFERS"
        print(f"{name}: {said}; {time.process_time() - began_s:.0f} s of CPU", flush=True)
    found += differences(folder, _index(folder))
    print(*found, sep="\n", end="\n" if found else "", file=sys.stderr)
    return int(bool(found))


class _Study(Protocol):
    TITLE: str
    QUESTION: str

    def run(self, progress: Progress, /) -> Result: ...


def module_of(name: str) -> _Study:
    """Imported when it is run: not all need the same libraries."""
    return cast("_Study", importlib.import_module(f"studies.{re.sub(r'[-.]', '_', name)}"))


def _result(name: str) -> tuple[_Study, Result]:
    from studies.plot import style

    study = module_of(name)
    with style():
        result = study.run(_show)
    _show("")
    return study, result


def _index(folder: Path) -> dict[str, str]:
    from studies.study_page import index

    return {"README.md": index(folder, [(known, module_of(known).TITLE) for known in STUDIES])}


def _show(what: str) -> None:
    """One line on standard error while it is a terminal; silence otherwise."""
    if sys.stderr.isatty():
        print(f"\r\033[K{what}", end="", file=sys.stderr, flush=True)
