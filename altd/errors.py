"""What a person did wrong, said in one line that names the place."""

from __future__ import annotations


class BadInputError(Exception):
    """A file, a setting or an argument that cannot be used; the command line ends with status 2.

    ``place`` names the file and, where there is one, the row, key or field in it.
    """

    def __init__(self, place: object, message: str) -> None:
        super().__init__(f"{place}: {message}")
        self.place = str(place)
        self.message = message
