"""Check the Markdown pages: lines of at most 120 characters, whole tables, and links to files that exist.

``python -m tools.markdown FILE…`` lists the lines that violate this; with ``--wrap`` it wraps long lines.
Tables, code and headings may be longer, and only the text of a link counts. The strict build of the site
checks the anchors.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

MAX_LETTERS = 120

_ITEM = re.compile(r"\s*(?:[-*] |\d+\. )")
_MARK = re.compile(rf"(?:{_ITEM.pattern})?\s*")
_WORD = re.compile(r"(?:!?\[[^\]]*\]\([^)]*\)|`[^`]*`|\S)+")
"""Text that is never broken: a link, inline code or a word, with adjoining characters up to a blank."""
_LINK_TARGET = re.compile(r"(?<=\])\([^)]*\)")
_LINKED_FILE = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")
"""Path of a link or a picture, without its anchor; no address on the network, no anchor alone."""
_INLINE_CODE = re.compile(r"`[^`]*`")
_FENCE = "```"
_TABLE_RULE = re.compile(r"\|(?: *:?-+:? *\|)+$")
_LITERAL = ("|", "#", "<!--", ">", _FENCE)
_INDENTED_CODE = "    "


def wrapped(page: str) -> str:
    """The page with all paragraphs and list items rewrapped that contain a line over the limit."""
    lines: list[str] = []
    for is_text, block in _blocks(page.split("\n")):
        lines += _filled(block) if is_text and any(map(_is_too_long, block)) else block
    return "\n".join(lines)


def long_lines(page: str) -> Iterator[int]:
    """Yield the numbers, from 1, of lines that are too long and can be broken."""
    number = 0
    for is_text, block in _blocks(page.split("\n")):
        for line in block:
            number += 1
            if is_text and _is_too_long(line) and _filled(block) != block:
                yield number


def table_faults(page: str) -> Iterator[tuple[int, str]]:
    """Yield number, from 1, and fault of lines that browsers show otherwise than they are meant.

    A row without a heading appears as text, and text directly below a row as a row.
    """
    before, is_fenced = "", False
    for number, (line, following) in enumerate(pairwise([*page.split("\n"), ""]), 1):
        is_fenced ^= line.startswith(_FENCE)
        is_row, is_below = line.startswith("|"), before.startswith("|")
        if is_row and not is_below and not is_fenced and not _TABLE_RULE.match(following):
            yield number, "a table row without a heading"
        if is_below and not is_row and line.strip() and not is_fenced:
            yield number, "text directly below a table"
        before = line


def dead_links(page: str, folder: Path) -> Iterator[tuple[int, str]]:
    """Yield number, from 1, and target of links to files that do not exist, relative to the page's folder."""
    is_fenced = False
    for number, line in enumerate(page.split("\n"), 1):
        is_fenced ^= line.startswith(_FENCE)
        for target in [] if is_fenced else _LINKED_FILE.findall(_INLINE_CODE.sub("", line)):
            if not (folder / target).exists():
                yield number, target


def _blocks(lines: Iterable[str]) -> Iterator[tuple[bool, list[str]]]:
    """Yield paragraphs and list items whole, other lines singly; the flag marks wrappable text."""
    text: list[str] = []
    is_fenced = False
    for line in lines:
        is_code = is_fenced or (line.startswith(_INDENTED_CODE) and not text)
        if is_code or not line.strip() or line.startswith(_LITERAL):
            if text:
                yield True, text
                text = []
            yield False, [line]
            is_fenced ^= line.startswith(_FENCE)
        else:
            if text and _ITEM.match(line):
                yield True, text
                text = []
            text.append(line)
    if text:
        yield True, text


def _filled(block: list[str]) -> list[str]:
    mark = _MARK.match(block[0])
    assert mark is not None  # noqa: S101  the pattern also matches an empty string
    lines, line = [], mark[0]
    for word in _WORD.findall(" ".join(block)[mark.end() :]):
        if line.strip() and len(line) + 1 + len(word) > MAX_LETTERS and line != mark[0]:
            lines.append(line)
            line = " " * len(mark[0]) + word
        else:
            line += word if line == mark[0] else f" {word}"
    return [*lines, line]


def _is_too_long(line: str) -> bool:
    return len(_LINK_TARGET.sub("", line)) > MAX_LETTERS


def main(arguments: list[str]) -> int:
    """Wrap the files, or list each faulty line; return the exit status."""
    if arguments[:1] == ["--wrap"]:
        for path in map(Path, arguments[1:]):
            path.write_text(wrapped(path.read_text()))
        return 0
    return _check(arguments)


def _check(paths: Iterable[str]) -> int:
    faults = []
    for path in paths:
        page = Path(path).read_text()
        faults += [f"{path}:{number}: longer than {MAX_LETTERS} characters" for number in long_lines(page)]
        faults += [f"{path}:{number}: {fault}" for number, fault in table_faults(page)]
        dead = dead_links(page, Path(path).parent)
        faults += [f"{path}:{number}: links to {target}, which does not exist" for number, target in dead]
    for fault in faults:
        print(fault, file=sys.stderr)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
