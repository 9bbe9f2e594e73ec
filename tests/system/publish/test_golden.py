"""Compare what every interface sends of fixed units, byte for byte, with ``golden.txt`` beside this file.

``ALTD_GOLDEN=FOLDER`` writes all of it into a folder, each part a file, with a new ``golden.txt``.
"""

import contextlib
import difflib
import gc
import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path

import pytest
from support.golden_cases import CASES
from support.golden_interfaces import Bench, bytes_of

KEPT = Path(__file__).with_name("golden.txt")
FIRST, *_ = CASES
WHOLE = ("valid", "spots missing")
"""Cases whose shorter parts are in the file as text, for readers and for the differences of a failure."""
MAX_WHOLE_CHARACTERS = 1300
ADVICE = (
    "To see what changed, run this test with ALTD_GOLDEN=FOLDER at both revisions and compare the folders "
    "with diff -r; if the change is meant, copy FOLDER/golden.txt over tests/system/publish/golden.txt."
)

Found = Mapping[str, Mapping[str, str]]
"""The text of each part of each case."""


def digest(text: str) -> str:
    return f"{len(text.encode())} {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def lines_of(text: str) -> list[str]:
    return [f"|{line}" for line in text.replace("\r", "␍").split("\n")]


def file_of(found: Found) -> str:
    """The content of ``golden.txt``. A case after the first one lists only parts that differ from it."""
    lines = [
        "# Bytes and beginning of SHA-256 of each part; a part that is not listed is as in the first case."
    ]
    for case, parts in found.items():
        lines.append(f"== {case}: {len(parts)} parts")
        lines += [
            f"{part} {digest(text)}"
            for part, text in parts.items()
            if case == FIRST or text != found[FIRST].get(part)
        ]
    for case in WHOLE:
        for part, text in found[case].items():
            is_new = case == FIRST or text != found[FIRST].get(part)
            if is_new and len(text) <= MAX_WHOLE_CHARACTERS:
                lines += [f"-- {case}, {part}", *lines_of(text)]
    return "\n".join(lines) + "\n"


def differences(kept: str, found: Found) -> list[str]:
    """The parts that the file has otherwise, with the lines that changed where it has their text."""
    listed, counts, texts = dict[str, dict[str, str]](), dict[str, int](), dict[str, list[str]]()
    for line in kept.splitlines():
        if head := re.fullmatch(r"== (.+): (\d+) parts", line):
            listed[head[1]], counts[head[1]] = (of_case := {}), int(head[2])
        elif line.startswith("-- "):
            texts[line.removeprefix("-- ")] = (text := [])
        elif line.startswith("|"):
            text.append(line)
        elif not line.startswith("#"):
            part, length, beginning = line.rsplit(" ", 2)
            of_case[part] = f"{length} {beginning}"
    changed = [f"{case}: the case is not in both" for case in listed.keys() ^ found.keys()]
    for case in (each for each in found if each in listed):
        parts, known = found[case], {**listed[FIRST], **listed[case]}
        changed += [f"{case}, {part}: gone" for part in listed[case] if part not in parts]
        if len(parts) != counts[case]:
            changed.append(f"{case}: {len(parts)} parts, not {counts[case]}")
        for part, now in parts.items():
            if known.get(part) != digest(now):
                of = f"{case}, {part}"
                before = texts.get(of, [])
                shown = difflib.unified_diff(before, lines_of(now), "kept", "now", lineterm="", n=0)
                changed.append("\n".join([of, *(list(shown) if before else [])]))
    return changed


def write(found: Found, folder: Path) -> None:
    for name, parts in found.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for part, text in parts.items():
            (folder / name / part.replace("/", "_")).write_bytes(text.encode())
    (folder / "golden.txt").write_text(file_of(found), encoding="utf-8")


@pytest.mark.timeout(1200)  # minutes where other programs keep the cores busy
async def test_every_interface_sends_the_bytes_that_are_kept(tmp_path: Path) -> None:
    found = dict[str, dict[str, str]]()
    try:
        async with contextlib.AsyncExitStack() as stack:
            bench = Bench(tmp_path, stack)
            for name, case in CASES.items():
                try:
                    found[name] = await bytes_of(case, bench)
                except Exception as error:
                    error.add_note(f"while reading the case {name!r}")
                    raise
    finally:
        gc.unfreeze()
    if folder := os.environ.get("ALTD_GOLDEN"):
        write(found, Path(folder))
    changed = differences(KEPT.read_text(encoding="utf-8"), found)
    assert not changed, "\n".join([f"{len(changed)} parts are not as kept. {ADVICE}", *changed])
