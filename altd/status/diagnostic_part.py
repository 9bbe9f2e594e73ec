"""A file for the diagnostics, made where more is known than an interface may see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DiagnosticPart:
    """``name`` is the file's, ``meaning`` says in a few words what it is.

    ``make`` gives its content, in a thread; whatever it raises costs this part only.
    """

    name: str
    meaning: str
    make: Callable[[], bytes]
