"""Valid inputs, corrupted a little: what a parser meets where it is weakest."""

import copy
import json
from collections.abc import Callable, Sequence
from typing import Any

from hypothesis import strategies as st

from altd.files.documents import checksum_of

EXTREME_NUMBERS: tuple[Any, ...] = (
    *(0, -0.0, -1, 0.5, 1, 2, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63),
    *(2**64, 10**30, 10**400, -(10**400), 5e-324, 1e-300, 1e-9, 1e9, 1e15, 1e200, -1e200, 1.7e308),
    *(float("nan"), float("inf"), float("-inf")),
)
EXTREME_TEXTS: tuple[str, ...] = (
    *("", " ", "\x00", "a\x00b", "\n", "\r\n", "\ud800", "\ufeff", "é", "..", "/", "../..", "/dev/null"),
    *("nan", "inf", "-inf", "1e400", "1e-400", "1_0", "٣", "0x10", '"', "'"),
    *("x" * 5000, "9" * 5000, "[" * 5000, "{" * 5000),
)
SCRAPS: tuple[bytes, ...] = (
    *(b"\x00", b"\xff", b"\n", b"\r", b"\r\n", b"\xef\xbb\xbf", b"\xc3", b"\xed\xa0\x80", b'"', b"'", b","),
    *(b"=", b"nan", b"NaN", b"Infinity", b"-inf", b"1e400", b"1e-400", b"]", b"}"),
    *(b"9" * 5000, b"[" * 2000, b"{" * 2000, b"\x00" * 64, b"\xff" * 64),
)


@st.composite
def spoilt_bytes(draw: st.DrawFn, valid: st.SearchStrategy[bytes], scraps: Sequence[bytes] = SCRAPS) -> bytes:
    """A valid message of which up to four places were flipped, cut, doubled, overwritten or filled in."""
    data = draw(valid)
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.integers(0, 64)))
        part = data[start:end]
        how = draw(st.sampled_from(("flip", "cut", "end", "double", "overwrite", "insert", "number")))
        if how == "flip" and part:
            part = bytes([part[0] ^ 1 << draw(st.integers(0, 7))]) + part[1:]
        elif how == "cut":
            part = b""
        elif how == "end":
            data = data[:end]
        elif how == "double":
            part *= draw(st.integers(2, 50))
        elif how == "overwrite":
            part = draw(st.binary(min_size=len(part), max_size=len(part)))
        elif how == "insert":
            part = draw(st.sampled_from(scraps)) + part
        elif how == "number":
            part = str(draw(st.sampled_from(EXTREME_NUMBERS[:-3]) | st.floats())).encode()[:400] + part
        data = data[:start] + part + data[end:]
    return data


@st.composite
def spoilt_document(draw: st.DrawFn, valid: st.SearchStrategy[Any]) -> Any:
    """A valid tree of dicts and lists; up to three nodes were removed, replaced, doubled or nested."""
    document = copy.deepcopy(draw(valid))
    for _ in range(draw(st.integers(0, 3))):
        if not document:
            break
        holder, key = document, _key(draw, document)
        while isinstance(holder[key], dict | list) and holder[key] and draw(st.integers(0, 7)):
            holder = holder[key]
            key = _key(draw, holder)
        if draw(st.integers(0, 5)) == 0:
            del holder[key]
        elif isinstance(holder, dict) and draw(st.integers(0, 9)) == 0:
            holder[draw(st.text(max_size=5))] = copy.deepcopy(holder[key])
        else:
            holder[key] = _replaced(draw, holder[key])
    return document


def spoilt_and_sealed(valid: Callable[[], dict[str, Any]]) -> st.SearchStrategy[bytes]:
    """Corrupted documents with a checksum that fits, and files of the valid one that are corrupted."""

    def sealed(document: dict[str, Any]) -> bytes:
        return json.dumps({**document, "checksum": checksum_of(document)}).encode()

    return st.deferred(
        lambda: spoilt_document(st.just(valid())).map(sealed) | spoilt_bytes(st.just(sealed(valid())))
    )


def _key(draw: st.DrawFn, holder: Any) -> Any:
    return draw(st.sampled_from(sorted(holder) if isinstance(holder, dict) else range(len(holder))))


def _replaced(draw: st.DrawFn, node: Any) -> Any:
    how = draw(st.sampled_from(("number", "float", "text", "other", "double", "nest")))
    if how == "double":
        return node * draw(st.integers(2, 200)) if isinstance(node, list | str) else node
    if how == "nest":
        for _ in range(draw(st.sampled_from((1, 2, 50)))):
            node = [node]
        return node
    others = {
        "number": st.sampled_from(EXTREME_NUMBERS),
        "float": st.floats() | st.integers(),
        "text": st.sampled_from(EXTREME_TEXTS) | st.text(max_size=20),
        "other": st.sampled_from((None, True, False, [], {}, [[]], {"": None}, [None])),
    }
    return draw(others[how])
