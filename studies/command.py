"""``python -m studies``: run the studies, print their tables, write their pages."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from altd.errors import BadInputError

if TYPE_CHECKING:
    from studies.result import Progress, Result

STUDIES = {
    "table-2.1": "table_2_1",
    "table-3.1": "table_3_1",
    "table-3.2": "table_3_2",
    "table-3.3": "table_3_3",
    "table-3.4": "table_3_4",
    "fig-3.5": "fig_3_5",
    "fig-3.17": "fig_3_17",
    "fig-3.19": "fig_3_19",
    "averaging": "averaging",
    "sigma-now": "sigma_now",
    "output-now": "output_now",
    "ambient": "ambient",
    "laser": "laser",
    "beam": "beam",
    "chessboard": "chessboard",
    "budget": "budget",
    "kinematics": "kinematics",
    "chain": "chain",
    "switched": "switched",
}
"""Names and modules, imported when they are run: not all need the same libraries."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the studies on the command line."""
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(STUDIES)}; default all")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write pages and plots there too")


def run(arguments: argparse.Namespace) -> int:
    """Run the studies one after the other; raises BadInputError."""
    names: list[str] = arguments.names or list(STUDIES)
    for name in names:
        if name not in STUDIES:
            raise BadInputError("NAME", f"unknown study {name!r}; known are {', '.join(STUDIES)}")
    try:
        importlib.import_module("matplotlib")
    except ImportError as error:
        raise BadInputError("matplotlib", "is not installed: pip install 'altd[report]'") from error
    if arguments.output is not None and arguments.output.exists() and not arguments.output.is_dir():
        raise BadInputError(arguments.output, "is not a folder")
    from studies.plot import style
    from studies.result_table import table
    from studies.study_page import verdict, write_index, write_page

    for name in names:
        study = _module(name)
        with style():
            result = study.run(_show)
        _show("")
        print(f"{study.TITLE}\n\n{table(result)}\n{result.headline}")
        if said := verdict(result):
            print(said)
        print(flush=True)
        if arguments.output is not None:
            write_page(arguments.output, name, study.TITLE, study.QUESTION, result)
            write_index(arguments.output, [(known, _module(known).TITLE) for known in STUDIES])
    return 0


class _Study(Protocol):
    TITLE: str
    QUESTION: str

    def run(self, progress: Progress, /) -> Result: ...


def _module(name: str) -> _Study:
    return cast("_Study", importlib.import_module(f"studies.{STUDIES[name]}"))


def _show(what: str) -> None:
    """One line on standard error while it is a terminal; silence otherwise."""
    if sys.stderr.isatty():
        print(f"\r\033[K{what}", end="", file=sys.stderr, flush=True)
