"""The code of ``docs/proof.md`` as who reads the page gets it: taken out of the page, and run."""

from __future__ import annotations

import re
import struct
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from support.foreign import need_program
from support.places import DOCS
from support.structured_text import FunctionBlock

FAULTS = ("", "corrupt", "foreign", "restarted", "not newer", "late", "not valid")
_MAIN = r"""
#include <stdio.h>
#include <stdlib.h>
int main(int count, char **argument)
{
    struct check c = {.unit = strtoul(argument[1], 0, 10), .limit_ms = atof(argument[2])};
    unsigned long now_ms;
    uint8_t block[160];
    while (scanf("%lu", &now_ms) == 1) {
        for (unsigned i = 0, byte; i < 160; i++)
            block[i] = scanf("%2x", &byte) == 1 ? byte : 0;
        printf("%d\n", check(&c, block, (uint32_t)now_ms));
    }
    return count != 3;
}
"""

Said = list[tuple[int, bytes]]
"""When a block came, ms of the reader's clock, and its 160 bytes."""


def code(language: str, after: str) -> str:
    """The fenced code below a heading of the page."""
    page = (DOCS / "proof.md").read_text(encoding="utf-8").split(f"\n## {after}\n")[1]
    found = re.search(rf"^```{language}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


def python() -> Any:
    """What the Python of the page defines."""
    source = code("python", "Python")
    assert "altd" not in re.findall(r"^(?:import|from) (\w+)", source, re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(source, "docs/proof.md", "exec"), names)
    return SimpleNamespace(**names)


def judged_by_python(unit: int, limit_ms: float, said: Said) -> list[str]:
    page = python()
    check = page.Check(unit, limit_ms / 1000)
    return [check.fault(page.from_block(block), now_ms / 1000) for now_ms, block in said]


def judged_by_c(unit: int, limit_ms: float, said: Said, folder: Path) -> list[str]:
    compiler = need_program("cc", "gcc")
    (folder / "check.c").write_text(code("c", "C") + _MAIN)
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
    subprocess.run([compiler, *flags, "check.c", "-o", "check"], cwd=folder, check=True, timeout=60)
    fed = "".join(f"{now_ms % 2**32} {block.hex()}\n" for now_ms, block in said)
    arguments = [folder / "check", str(unit), str(limit_ms)]
    told = subprocess.run(arguments, input=fed, check=True, capture_output=True, text=True, timeout=60)
    return [FAULTS[int(number)] for number in told.stdout.split()]


def judged_by_structured_text(unit: int, limit_ms: float, said: Said) -> list[str]:
    block = FunctionBlock(code("", "IEC 61131-3 Structured Text"))
    faults = []
    for now_ms, data in said:
        registers = struct.unpack(">80H", data)
        block(r=registers, my_unit=unit, now_ms=now_ms % 2**32, limit_ms=float(limit_ms))
        faults.append(FAULTS[block.variables["fault"]])
    return faults
