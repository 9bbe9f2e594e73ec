"""Errors in the input, as lines that each name the place."""

from __future__ import annotations

import re
from collections.abc import Iterable


class BadInputError(Exception):
    """A file, a setting or an argument cannot be used; the command line ends with status 2.

    ``place`` names the file and, if there is one, the row, key or field in it. ``more`` are further faults of
    the same place: the error's own text is the first fault, ``lines`` are all of them.
    """

    def __init__(self, place: object, message: str, *more: str) -> None:
        self.lines = tuple(one_line(f"{place}: {text}") for text in (message, *more))
        super().__init__(self.lines[0])
        self.place = str(place)
        self.message = message


_MAX_LINE_CHARACTERS = 2000
_MAX_WORD_CHARACTERS = 60
_MIN_SIMILARITY = 0.6
"""Minimum similarity of two words (difflib) for one to count as a misspelling of the other."""


def did_you_mean(word: object, possible: Iterable[str]) -> str:
    """Return a suggestion for a misspelt word, as the end of a sentence; empty if no word is similar."""
    import difflib  # most commands are called without a slip

    folded = {name.casefold(): name for name in possible}
    near = difflib.get_close_matches(
        str(word)[:_MAX_WORD_CHARACTERS].casefold(), folded, n=1, cutoff=_MIN_SIMILARITY
    )
    return f"; did you mean `{folded[near[0]]}`?" if near else ""


def one_line(text: str) -> str:
    """Return one line for a terminal or a log from any text of a file or a network: escaped and cut."""
    return escaped(text if len(text) <= _MAX_LINE_CHARACTERS else f"{text[:_MAX_LINE_CHARACTERS]}…")


def escaped(text: str) -> str:
    r"""Return the text with a Python escape, such as ``\x1b``, for each non-printable character.

    Those are line ends, C0 and C1 control characters, bidirectional overrides and lone surrogates. Python
    represents bytes of a file name that are not UTF-8 as such surrogates.
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text
    )


_PLAIN = {"µ": "u", "×": "x", "–": "-", "…": "..."}


def shown_in(encoding: str, text: str) -> str:
    """Return the text with only characters that a terminal of this encoding can show: ``deg`` for °."""
    try:
        return text.encode(encoding).decode(encoding)
    except UnicodeEncodeError:
        plain = "".join(_PLAIN.get(letter, letter) for letter in re.sub(r"(?<=\d)°", " deg", text))
        return plain.replace("°", "deg").replace("±", "+/-").encode(encoding, "replace").decode(encoding)


def unwrap_group(group: BaseExceptionGroup, *kinds: type[BaseException]) -> BaseException | None:
    """Return the first error of these kinds in a task group's failure, or None.

    For ``except BaseExceptionGroup``: an error raised inside ``except*`` is wrapped again in Python 3.11.2,
    the version in Debian 12, though not in 3.11.7.
    """
    found = group.subgroup(kinds)
    if found is None:
        return None
    error: BaseException = found
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
