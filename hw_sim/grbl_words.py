"""The words of a line of G-code, and Grbl's complaints about them."""

from __future__ import annotations

import re

_WORD = re.compile(r"([A-Z])([^A-Z]*)")


class GrblError(Exception):
    """``error:N``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def words(line: str) -> tuple[set[int], dict[str, float]]:
    """The numbers of the G words, and the values of the others; raises GrblError."""
    if line and not line[0].isalpha():
        raise GrblError(1)
    codes: set[int] = set()
    values: dict[str, float] = {}
    for letter, digits in _WORD.findall(line):
        try:
            value = float(digits)
        except ValueError:
            raise GrblError(2) from None
        if letter == "G":
            if value != int(value) or int(value) in codes:
                raise GrblError(20 if value != int(value) else 21)
            codes.add(int(value))
        elif letter in values:
            raise GrblError(25)
        elif letter not in "XYZFPLMNST":
            raise GrblError(20)
        else:
            values[letter] = value
    return codes, values
