"""Plain English: find phrases of the table below in all texts for people.

``python -m tools.plain PATH…`` lists each place, with the wording to use instead. It checks pages (``.md``),
strings, docstrings and comments of Python, and files of the browser page (``.js``, ``.html``), and in a
folder all files of these three kinds. A string of one word may be a key and is ignored, as are strings of
tests, which are data.
"""

import io
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_PHRASES = (
    (r"\b(?:whoever|whosoever|whatever is)\b", "name the subject: a client, a reader, the technician"),
    (r"[.;:] (?-i:Who|Whose|Whom) (?!is\b|are\b)[^?.]*[.;]", "name the subject"),
    (r"\b(?:for|to|of|by|from|with|than|and|or|as|that|but) who\b", "name the subject"),
    (r"[,;:] who (?:reads|asks|has|wants|sends|polls|comes|knows|changes|writes|sees)\b", "name the subject"),
    (r"\b(?:nobody|no one|anew|somebody)\b", "do not, none, again, a person"),
    (r"\b(?:is|are|was|were|be|been|being) told\b(?! from)", "is reported, is configured, receives"),
    (r"\b(?:say|says|said) so\b", "reports it"),
    (r"\btold? apart\b|\btells? \w+ apart\b", "distinguish"),
    (r"\bof now\b", "current"),
    (r"\bin (?:its|their|his) own words\b", "as the program reports it"),
    (r"\bfor ever\b", "indefinitely, for an unlimited time"),
    (r"\b(?:stands?|stood)\b(?!-| still| alone)", "is, is listed, means"),
    (r"\bfaced?\b(?! of| [IV1-4])|\bfaces\b(?! of)", "interface"),
    (r"\bcall(?:s|ed)? (?:it |them |a wrong number |none of it )?valid\b", "marks valid"),
    (r"\b(?:is|are|was|were|be) let go\b|\blets? (?:\w+ )?go\b", "release"),
    (r"\bgo(?:es)? on\b", "continue"),
    (r"\b(?:by|of) (?:itself|themselves)\b", "automatically, alone"),
    (r"\b(?:to|can) be had\b", "is available"),
    (r"\bha[sd] to say\b", "reports"),
    (r"\bflatter\w*", "is optimistic"),
    (r"\b(?:is|are) (?:deaf|blind) to\b", "cannot detect"),
    (r"\b(?:upkeep|illness|trembl\w+|teller|farewell|patience|greeting)\b", "see the glossary"),
    (r"\bno matter\b", "regardless of"),
    (r"\b(?:comes?|came|becomes|became) of\b", "results from"),
    (r"\bspoil(?:s|t|ed)?\b", "wrong, corrupted, disturbed"),
    (r"\breckon\w*", "compute"),
    (r"\bat hand\b", "available"),
    (r"\bseen to\b(?! be)", "needs maintenance"),
    (
        r"(?m:^(?:#+ |\"{3})(?:what|who|how|where)\b[^?\n]*$)",
        "begin a heading, a docstring or a comment with its noun or verb",
    ),
    (r"\bto and fro\b|\bever so\b|\bhence(?:forth)?\b|\bthereof\b|\bwherefore\b", "plain wording"),
)
_RULES = [(re.compile(phrase.replace(" ", r"\s+"), re.IGNORECASE), better) for phrase, better in _PHRASES]

_FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_HIDDEN = re.compile(r"``[^`]+``|`[^`]+`|(?<=\])\([^)]*\)|<[^>]+>|https?://\S+")
_FIELD = re.compile(r"\{[^{}]*\}")  # in an f-string or a template
_INDENTED = re.compile(r"(?<=\n\n)(?: {4,}[^\n]*\n|\n)+", re.MULTILINE)
_LINE_ENDS = {tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}  # before a docstring
_SUFFIXES = {".py", ".js", ".html"}
_OWN = {"plain.py", "test_plain.py"}


class Finding(NamedTuple):
    """A phrase to replace: its line (from 1), its wording, and the advice."""

    line: int
    phrase: str
    better: str


def findings(name: str, text: str) -> Iterator[Finding]:
    """Yield the phrases in the text of a file; the suffix of ``name`` determines its language."""
    for first_line, passage in _passages(name, text):
        for rule, better in _RULES:
            for match in rule.finditer(passage):
                yield Finding(
                    first_line + passage.count("\n", 0, match.start()), " ".join(match[0].split()), better
                )


def _passages(name: str, text: str) -> Iterator[tuple[int, str]]:
    if not name.endswith(".py"):
        yield 1, _without_code(text) if name.endswith(".md") else text
        return
    is_test = "tests" in Path(name).parts
    before = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.STRING or _is_f_string(token.type):
            is_text = before in _LINE_ENDS or (" " in token.string and not is_test)
        else:
            is_text = token.type == tokenize.COMMENT
        if is_text:
            yield token.start[0], _FIELD.sub(_blank, _HIDDEN.sub(_blank, token.string.replace("\\n", "  ")))
        if token.type not in (tokenize.COMMENT, tokenize.NL):
            before = token.type


def _is_f_string(token_type: int) -> bool:
    return token_type == getattr(tokenize, "FSTRING_MIDDLE", None)


def _without_code(page: str) -> str:
    """The page with code, link targets and markup replaced by placeholders; line numbers are kept."""
    for pattern in (_FENCED, _INDENTED):
        page = pattern.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), page)
    return _HIDDEN.sub(_blank, page)


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", "_", match[0])


def _files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the files, and the files in the folders except libraries and the two that contain the phrases."""
    for path in paths:
        if path.is_dir():
            found = (
                file for file in path.rglob("*.*") if file.suffix in _SUFFIXES and "vendor" not in file.parts
            )
            yield from sorted(file for file in found if file.name not in _OWN)
        else:
            yield path


def main(arguments: list[str]) -> int:
    """Check the files; the exit status is 1 if a phrase was found."""
    count = 0
    for path in _files(map(Path, arguments)):
        for finding in findings(str(path), path.read_text()):
            count += 1
            print(f"{path}:{finding.line}: “{finding.phrase}”: {finding.better}", file=sys.stderr)
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
