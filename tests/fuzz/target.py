"""The type of a fuzz target, and the places of the targets.

A module ``targets/<name>.py`` with ``NAME``, ``EXAMPLES`` (a hypothesis strategy of inputs, most of them
nearly valid: see ``spoil``) and ``check(example)``, which raises on a defect: an exception that is not the
documented one, a wrong answer, a number that is not finite but marked valid. Time and memory are watched from
outside (``limits``); a module that takes long to start does so in ``begin()``, which is not watched.
"""

import importlib
from pathlib import Path
from typing import Any, Protocol

from hypothesis.strategies import SearchStrategy


class Target(Protocol):
    """A module of ``targets/``."""

    NAME: str
    EXAMPLES: SearchStrategy[Any]

    def check(self, example: Any) -> None:
        """Raise on a defect."""


def names() -> list[str]:
    """All targets, in alphabetical order."""
    return sorted(path.stem for path in (Path(__file__).parent / "targets").glob("[a-z]*.py"))


def load(name: str) -> Target:
    """The target of this name."""
    module: Any = importlib.import_module(f"fuzz.targets.{name}")
    getattr(module, "begin", lambda: None)()
    target: Target = module
    return target
