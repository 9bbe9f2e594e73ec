"""Memory of processes, as the kernel counts it (proc(5))."""

from __future__ import annotations

import re
from pathlib import Path

_PSS = re.compile(r"^Pss:\s+(\d+) kB$", re.MULTILINE)
_RESIDENT = re.compile(r"^VmRSS:\s+(\d+) kB$", re.MULTILINE)


def resident_mb(pid: int | str = "self") -> float:
    """The memory of a process, all that it shares with others included; raises OSError."""
    return _megabytes(_RESIDENT, Path(f"/proc/{pid}/status"))


def proportional_mb(pid: int) -> float:
    """Its proportional set size: of what it shares with others only its share; raises OSError."""
    return _megabytes(_PSS, Path(f"/proc/{pid}/smaps_rollup"))


def _megabytes(line: re.Pattern[str], file: Path) -> float:
    found = line.search(file.read_text())
    return int(found[1]) * 1024e-6 if found else 0.0
