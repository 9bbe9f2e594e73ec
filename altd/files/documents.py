"""Nested text formats, read strictly: content that two readers could interpret differently is refused."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from typing import Any

_MAX_DOTS = 64
"""Maximum number of dots in a TOML line. tomllib takes 9 s for a key of 30,000 parts, quadratic in their
number."""
_MAX_DIGITS = 40
_DOTTED = re.compile(rf"^(?![ \t]*#)[^.\n]*(?:\.[^.\n]*){{{_MAX_DOTS + 1}}}", re.MULTILINE)


def parse_json(content: bytes) -> Any:
    """Parse a JSON document (RFC 8259); raises ValueError that states the fault.

    Also refused: a key that occurs twice in an object, whole numbers of more than 40 digits, and nesting too
    deep for this computer. NaN and infinity, which Python accepts, are left to the document's model, which
    can name their key.
    """
    try:
        return json.loads(
            content,
            object_pairs_hook=_object,
            parse_int=_whole,
        )
    except RecursionError as error:
        raise ValueError("is nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"is not JSON: {error}") from error


def line_of(document: Mapping[str, object]) -> str:
    """Return plain JSON types as one line of JSON, without the line end; NaN raises ValueError."""
    return json.dumps(document, allow_nan=False)


def checksum_of(document: Mapping[str, object]) -> str:
    """Return SHA-256 over a document of plain JSON types, keys sorted, no spaces."""
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()


def checksummed(document: Mapping[str, object]) -> bytes:
    """Return the content of a file: a document with its checksum, as one line; NaN raises ValueError."""
    return (line_of({**document, "checksum": checksum_of(document)}) + "\n").encode()


def parse_checksummed(content: bytes, expected_format: str) -> dict[str, Any]:
    """Return the document of ``checksummed``; raises ValueError that states the fault."""
    document = parse_json(content)
    if not isinstance(document, dict) or document.get("format") != expected_format:
        raise ValueError(f"is no {expected_format}")
    if document.pop("checksum", None) != checksum_of(document):
        raise ValueError("checksum does not match: the file is damaged or was edited")
    return document


class TomlError(ValueError):
    """The text is not TOML, or TOML itself forbids it.

    ``line`` and ``column`` count from 1; None: it has no place, or ``keys`` are the path to it.
    """

    def __init__(
        self,
        message: str,
        line: int | None = None,
        column: int | None = None,
        keys: tuple[str | int, ...] = (),
    ) -> None:
        super().__init__(message)
        self.line = line
        self.column = column
        self.keys = keys


def parse_toml(content: bytes) -> dict[str, Any]:
    """Parse a TOML document; raises TomlError that states the fault."""
    for mark, encoding in _BYTE_ORDER_MARKS.items():
        if content.startswith(mark):
            raise TomlError(f"is {encoding}: save the file as UTF-8", 1, 1)
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        before = content[: error.start]
        column = len(before[before.rfind(b"\n") + 1 :].decode()) + 1
        message = "is not UTF-8 text: save the file as UTF-8"
        raise TomlError(message, before.count(b"\n") + 1, column) from error
    if dotted := _DOTTED.search(text):
        raise TomlError(f"more than {_MAX_DOTS} dots in a line", text.count("\n", 0, dotted.start()) + 1, 1)
    try:
        document = tomllib.loads(text)
    except RecursionError as error:
        raise TomlError("is nested too deeply") from error
    except ValueError as error:  # also for numbers with more digits than Python reads
        raise _syntax_error(text, str(error)) from error
    _check_values(document)
    return document


_BYTE_ORDER_MARKS = {
    b"\xef\xbb\xbf": "text that begins with a byte order mark",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
_WHERE = re.compile(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)$", re.DOTALL)
_TWICE = "is defined twice: keep one of them"
_ESCAPE = "in text in double quotes: write two of them, or put the text in single quotes"
_WORDS = (
    ("Exceeds the limit", "a number with too many digits"),
    ("Invalid statement", "neither a key nor the [name] of a table"),
    ("Expected newline", "the line should end here"),
    ("Illegal character '\\n'", "the text in quotes does not end on its line"),
    ("Illegal character '\\r'", "the text in quotes does not end on its line"),
    ("Illegal character", "a character that is not allowed here"),
    ("Found invalid character", "a character that is not allowed here"),
    ("Cannot declare", f"this table {_TWICE}"),
    ("Cannot overwrite", f"this key {_TWICE}"),
    ("Duplicate inline table key", f"this key {_TWICE}"),
    ("Cannot mutate", "this table ended further up: nothing can be added to it here"),
    ("Cannot redefine", "this table ended further up: nothing can be added to it here"),
    ("Expected ']' at", "the ] after the name of a table is missing"),
    ("Expected ']]' at", "the ]] after the name of a table is missing"),
    ("Expected '=' after", "the = after a key is missing"),
    ("Invalid initial character for a key", "the name of a key is missing"),
    ("Unclosed array", "a comma or ] is missing in a list"),
    ("Unclosed inline table", "a comma or } is missing in a table"),
    ("Unescaped", f"a backslash {_ESCAPE}"),
    ("Invalid hex value", f"a character's number after \\u or \\U is wrong, or a backslash {_ESCAPE}"),
    ("Escaped character", f"a character's number after \\u or \\U is wrong, or a backslash {_ESCAPE}"),
    ("Unterminated string", "the text in quotes does not end"),
    ("Expected", "the text in quotes does not end"),
    ("Invalid date", "there is no such date or time"),
    ("Invalid value", "no value: put text in quotes, true and false in small letters"),
)
"""First words of a message of tomllib, and ours."""
_AT_PLACE = (
    ("Expected newline", r"\d$", r",\d", "a comma in a number: the decimal sign is a point"),
    ("Expected newline", r"= *[-+]?[\d_.]+ *$", r"[^\W\d]|[%°]", "a number is written without its unit"),
    ("Invalid value", "$", "[“”„«»‘’‚]", "these quotes are not straight: write \" or '"),
    (
        "Cannot overwrite",
        "^$",
        r"\[\[",
        "[ ] further up makes one table, [[ ]] here a list of tables: write both alike",
    ),
)
"""First words of a message of tomllib, the text before and after its place in the line, and our message."""


def _syntax_error(text: str, said: str) -> TomlError:
    """Return the message of tomllib in plain words, with its place."""
    where = _WHERE.fullmatch(said)
    message = said if where is None else where[1]
    words = next((words for begin, words in _WORDS if message.startswith(begin)), message)
    if where is None:
        return TomlError(f"not TOML: {words}")
    lines = text.replace("\r\n", "\n").split("\n")
    line, column = (int(where[2]), int(where[3])) if where[2] else (len(lines), len(lines[-1]) + 1)
    if words.endswith(_TWICE):  # tomllib has read to the end of the value
        column = len(lines[line - 1]) - len(lines[line - 1].lstrip(" \t")) + 1
    before, behind = lines[line - 1][: column - 1], lines[line - 1][column - 1 :]
    for begin, ending, start, special in _AT_PLACE:
        if message.startswith(begin) and re.search(ending, before) and re.match(start, behind):
            words = special
    return TomlError(f"not TOML: {words}", line, column)


def _check_values(document: dict[str, Any]) -> None:
    """Raise for a text with NUL, invalid in names and paths, or a number over 64 bits (TOML 1.0)."""
    nodes: list[tuple[tuple[str | int, ...], Any]] = [((key,), node) for key, node in document.items()]
    while nodes:
        keys, node = nodes.pop()
        if isinstance(node, dict):
            nodes += [((*keys, name), below) for name, below in node.items()]
        elif isinstance(node, list):
            nodes += [((*keys, number), below) for number, below in enumerate(node)]
        elif isinstance(node, str) and "\0" in node:
            raise TomlError("has a NUL", keys=keys)
        elif isinstance(node, int) and not -(2**63) <= node < 2**63:
            raise TomlError("has more than 64 bits", keys=keys)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        double = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the key {double!r} occurs twice in one object")
    return content


def _whole(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"{text[:_MAX_DIGITS]}… has {len(text)} digits")
    return int(text)
