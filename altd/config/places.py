"""The place of each key and value in a TOML file.

``tomllib`` reads the file without places; this module finds them in a text that ``tomllib`` has accepted. The
result is compared with that of ``tomllib``. If the two differ in one key or one value, there are no places at
all, because a wrong line is worse than none.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

Keys = tuple[str | int, ...]
"""Path to a value: keys of tables, and indices from 0 of list elements."""

_BLANK = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_DOT = re.compile(r"[ \t]*\.[ \t]*")
_EQUALS = re.compile(r"[ \t]*=[ \t]*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'"""(?:\\.|[^\\])*?"""(?:"{0,2})' r"|'''.*?'''(?:'{0,2})" r'|"(?:\\.|[^"\\\n])*"' r"|'[^'\n]*'",
    re.DOTALL,
)
_SCALAR = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2} [0-9][^\s,\]}#]*|[^\s,\]}#]+")


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a file, both numbers from 1."""

    line: int
    column: int

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}"


class Places:
    """Places of a document's keys and values; empty if the scan and ``tomllib`` disagree."""

    def __init__(self, text: str, document: dict[str, Any]) -> None:
        self._lines = [0, *(match.end() for match in re.finditer("\n", text))]
        self._scan = _Scan(text)
        try:
            self._scan.run()
            agree = self._scan.agrees_with(document)
        except (_UnexpectedTextError, RecursionError):
            agree = False
        if not agree:
            self._scan = _Scan("")

    def key(self, keys: Keys) -> Place | None:
        """Return the place of a key, or the header of a table, or an element of a list."""
        return self._place(self._scan.keys.get(keys))

    def value(self, keys: Keys) -> Place | None:
        """Return the place of a key's value; of a table, its header."""
        return self._place(self._scan.values.get(keys, self._scan.keys.get(keys)))

    def nearest(self, keys: Keys) -> Place | None:
        """Return the place of the innermost existing table on the path to a missing key."""
        for length in range(len(keys) - 1, 0, -1):
            if (place := self.key(keys[:length])) is not None:
                return place
        return None

    def at(self, offset: int) -> Place:
        """Return the place of the character at an offset from 0."""
        line = bisect_right(self._lines, offset)
        return Place(line, offset - self._lines[line - 1] + 1)

    def _place(self, offset: int | None) -> Place | None:
        return None if offset is None else self.at(offset)


def _same(one: Any, other: Any) -> bool:
    return type(one) is type(other) and (one == other or (one != one and other != other))  # nan != nan


class _UnexpectedTextError(Exception):
    pass


class _Scan:
    """One pass over a text; ``keys`` and ``values`` are offsets."""

    def __init__(self, text: str) -> None:
        self.keys: dict[Keys, int] = {}
        self.values: dict[Keys, int] = {}
        self._text = text
        self._at = 0
        self._tables: dict[Keys, int] = {}
        """Number of ``[[…]]`` tables so far, by key."""
        self._scalars: dict[Keys, str] = {}
        self._containers: set[Keys] = {()}

    def run(self) -> None:
        """Record every key, header, element and value; raises _UnexpectedTextError."""
        table: Keys = ()
        self._take(_BLANK)
        while self._at < len(self._text):
            begin = self._at
            if self._skip("[["):
                table = self._open(self._key(), begin, element=True)
                self._expect("]]")
            elif self._skip("["):
                table = self._open(self._key(), begin, element=False)
                self._expect("]")
            else:
                self._pair(table)
            self._take(_BLANK)

    def agrees_with(self, document: dict[str, Any]) -> bool:
        """Whether the scan found the same keys as the document, and the same value at each place."""
        nodes: list[tuple[Keys, Any]] = [((), document)]
        scalars: dict[Keys, Any] = {}
        containers: set[Keys] = set()
        while nodes:
            keys, node = nodes.pop()
            if isinstance(node, dict | list):
                containers.add(keys)
                pairs = node.items() if isinstance(node, dict) else enumerate(node)
                nodes += [((*keys, key), below) for key, below in pairs]
            else:
                scalars[keys] = node
        if containers != self._containers or scalars.keys() != self._scalars.keys():
            return False
        again = tomllib.loads("values = [\n" + ",\n".join(self._scalars[keys] for keys in scalars) + "\n]")
        return all(map(_same, again["values"], scalars.values()))

    def _open(self, parts: list[str], begin: int, *, element: bool) -> Keys:
        """Return the keys of the table that a header opens."""
        keys: Keys = ()
        for part in parts[:-1] if element else parts:
            keys = (*keys, part)
            self._note_table(keys, begin)
            if keys in self._tables:
                keys = (*keys, self._tables[keys] - 1)
        if element:
            keys = (*keys, parts[-1])
            self._note_table(keys, begin)
            number = self._tables.get(keys, 0)
            self._tables[keys] = number + 1
            keys = (*keys, number)
            self._note_table(keys, begin)
        else:
            self.keys[keys] = begin
        return keys

    def _note_table(self, keys: Keys, begin: int) -> None:
        self._containers.add(keys)
        self.keys.setdefault(keys, begin)

    def _pair(self, table: Keys) -> None:
        begin = self._at
        *above, last = self._key()
        for part in above:
            table = (*table, part)
            self._note_table(table, begin)
        keys = (*table, last)
        self.keys[keys] = begin
        self._take(_EQUALS)
        self._value(keys)

    def _value(self, keys: Keys) -> None:
        begin = self.values[keys] = self._at
        self.keys.setdefault(keys, begin)
        if self._skip("["):
            self._containers.add(keys)
            self._list(keys)
        elif self._skip("{"):
            self._containers.add(keys)
            self._take(_BLANK)
            while not self._skip("}"):
                self._pair(keys)
                self._take(_BLANK)
                self._skip(",")
                self._take(_BLANK)
        else:
            quoted = self._text.startswith(('"', "'"), self._at)
            self._scalars[keys] = self._take(_STRING if quoted else _SCALAR)

    def _list(self, keys: Keys) -> None:
        number = 0
        self._take(_BLANK)
        while not self._skip("]"):
            self._value((*keys, number))
            number += 1
            self._take(_BLANK)
            self._skip(",")
            self._take(_BLANK)

    def _key(self) -> list[str]:
        """Read a dotted key and the blanks around it; returns its parts."""
        parts: list[str] = []
        while True:
            self._take(_BLANK)
            quoted = self._text.startswith(('"', "'"), self._at)
            part = self._take(_STRING if quoted else _BARE)
            parts.append(tomllib.loads(f"key = {part}")["key"] if quoted else part)
            if not self._take(_DOT, needed=False):
                self._take(_BLANK)
                return parts

    def _take(self, pattern: re.Pattern[str], *, needed: bool = True) -> str:
        match = pattern.match(self._text, self._at)
        if match is None:
            if needed:
                raise _UnexpectedTextError
            return ""
        self._at = match.end()
        return match[0]

    def _skip(self, text: str) -> bool:
        found = self._text.startswith(text, self._at)
        self._at += len(text) * found
        return found

    def _expect(self, text: str) -> None:
        if not self._skip(text):
            raise _UnexpectedTextError
