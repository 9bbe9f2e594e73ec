"""What a person did wrong, said in one line that names the place."""

from __future__ import annotations


class BadInputError(Exception):
    """A file, a setting or an argument that cannot be used; the command line ends with status 2.

    ``place`` names the file and, where there is one, the row, key or field in it.
    """

    def __init__(self, place: object, message: str) -> None:
        super().__init__(_one_line(f"{place}: {message}"))
        self.place = str(place)
        self.message = message


_LONGEST = 2000


def _one_line(text: str) -> str:
    """The text as a terminal and a log can show it, whatever a file put into it."""
    if len(text) > _LONGEST:
        text = f"{text[:_LONGEST]}…"
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text
    )


def bare(group: BaseExceptionGroup, *kinds: type[BaseException]) -> BaseException | None:
    """The first error of these kinds in a task group's failure, or None.

    For ``except BaseExceptionGroup``: what is raised inside ``except*`` comes out wrapped again in Python
    3.11.2, the one of Debian 12, though not in 3.11.7.
    """
    found = group.subgroup(kinds)
    if found is None:
        return None
    error: BaseException = found
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
