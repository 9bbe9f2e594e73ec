"""Text formats that nest, read strictly: what two readers could understand differently is refused."""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from typing import Any

_MOST_DOTS = 64
"""In a line of TOML. A key takes tomllib 9 s with 30,000 parts: it grows with the square."""
_MOST_DIGITS = 40
_DOTTED = re.compile(rf"^(?![ \t]*#)[^.\n]*(?:\.[^.\n]*){{{_MOST_DOTS + 1}}}", re.MULTILINE)


def parse_json(content: bytes) -> Any:
    """A JSON document (RFC 8259); raises ValueError that says what is wrong with it.

    Refused beside what is no JSON: a key that stands twice in an object, whole numbers of more than 40
    digits, and nesting too deep for this computer. NaN and infinity, which Python reads, are left to the
    document's model, which can name their key.
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


def parse_toml(content: bytes) -> dict[str, Any]:
    """A TOML document; raises ValueError that says what is wrong with it."""
    try:
        text = content.decode()
        if dotted := _DOTTED.search(text):
            line = text.count("\n", 0, dotted.start()) + 1
            raise ValueError(f"more than {_MOST_DOTS} dots (at line {line})")
        document = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise ValueError("is not UTF-8 text") from error
    except RecursionError as error:
        raise ValueError("is nested too deeply") from error
    except ValueError as error:  # also of numbers with more digits than Python reads
        raise ValueError(f"not TOML: {error}") from error
    _check_values(document)
    return document


def _check_values(document: dict[str, Any]) -> None:
    """No text has a NUL, which no name and no path has, and whole numbers have 64 bits (TOML 1.0)."""
    nodes: list[tuple[str, Any]] = list(document.items())
    while nodes:
        key, node = nodes.pop()
        if isinstance(node, dict):
            nodes += [(f"{key}.{name}", below) for name, below in node.items()]
        elif isinstance(node, list):
            nodes += [(f"{key}.{number}", below) for number, below in enumerate(node)]
        elif isinstance(node, str) and "\0" in node:
            raise ValueError(f"{key}: has a NUL")
        elif isinstance(node, int) and not -(2**63) <= node < 2**63:
            raise ValueError(f"{key}: has more than 64 bits")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        double = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the key {double!r} stands twice in one object")
    return content


def _whole(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"{text[:_MOST_DIGITS]}… has {len(text)} digits")
    return int(text)
