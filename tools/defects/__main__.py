"""``python -m tools.defects``: run the tests of ``make test`` on a copy of altd with one defect at a time."""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from altd.process.endings import run_to_end
from tools.defects.catalogue import DEFECTS, Defect

ROOT = Path(__file__).resolve().parents[2]
_PYTEST = [sys.executable, "-m", "pytest", "-q", "-n", "auto", "--maxfail=3", "-m", "not long"]
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


def main() -> int:
    """Print the tests that caught each defect; return 1 if a defect was not caught."""
    parser = argparse.ArgumentParser(prog="python -m tools.defects", description=__doc__)
    parser.add_argument("rooms", nargs="*", help="only defects of these rooms; without: all")
    rooms = parser.parse_args().rooms
    missed = 0
    for defect in DEFECTS:
        if rooms and defect.room not in rooms:
            continue
        caught = _caught_by(defect)
        missed += not caught
        print(f"{defect.room}: {defect.what}\n    {', '.join(caught) or 'NOT CAUGHT'}", flush=True)
    return int(bool(missed))


def _caught_by(defect: Defect) -> list[str]:
    """Return the unit tests that fail with the defect: of its own package if any, else of all."""
    with tempfile.TemporaryDirectory(prefix="altd-defect-", dir=ROOT.parent) as name:
        copy = Path(name)  # next to the project, so that the tests find ../shared
        ignored = shutil.ignore_patterns(".*", "__pycache__", "build", "dist")
        shutil.copytree(ROOT, copy, ignore=ignored, dirs_exist_ok=True)
        file = copy / defect.file
        text = file.read_text(encoding="utf-8")
        if text.count(defect.old) != 1:
            raise SystemExit(f"{defect.file}: the defect of {defect.room} has no place there any more")
        file.write_text(text.replace(defect.old, defect.new), encoding="utf-8")
        caught: list[str] = []
        for tests in (f"tests/unit/{Path(defect.file).parts[1]}", "tests/unit"):
            command = [*_PYTEST, tests]
            ran = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)  # noqa: S603
            caught = caught or _FAILED.findall(ran.stdout)
            if caught:
                break
        return caught


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "tools.defects"))
