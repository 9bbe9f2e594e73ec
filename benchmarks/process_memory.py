"""Memory, descriptors and threads of processes, as counted by the kernel (proc(5))."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MAX_GROWTH_MB_PER_HOUR = 1.0
_RESIDENT = re.compile(r"^VmRSS:\s+(\d+) kB$", re.MULTILINE)


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of a process, including all shared memory; raises OSError."""
    found = _RESIDENT.search(Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) * 1024e-6 if found else 0.0


@dataclass(frozen=True, slots=True)
class ProcessSample:
    """State of a process after this number of hours."""

    hour: float
    memory_mb: float
    descriptors: int
    threads: int

    @classmethod
    def taken(cls, hour: float, pid: int | str = "self") -> ProcessSample:
        """Take a sample now; raises OSError."""
        process = Path("/proc", str(pid))
        descriptors, threads = (sum(1 for _ in (process / folder).iterdir()) for folder in ("fd", "task"))
        return cls(hour, resident_mb(pid), descriptors, threads)

    def __str__(self) -> str:
        """Sample as text."""
        numbers = f"{self.descriptors} descriptors, {self.threads} threads"
        return f"{self.hour:7.2f} h: {self.memory_mb:.1f} MB, {numbers}"


def growth_mb_per_hour(samples: Sequence[ProcessSample]) -> float:
    """Slope of memory over at least two samples."""
    return float(np.polyfit([each.hour for each in samples], [each.memory_mb for each in samples], 1)[0])


def growth_faults(samples: Sequence[ProcessSample]) -> Iterator[str]:
    """Growth over at least two samples, as text: more in the second half than ever in the first."""
    growth = growth_mb_per_hour(samples)
    if growth > MAX_GROWTH_MB_PER_HOUR:
        yield f"memory grows by {growth:.2f} MB an hour"
    for name in ("descriptors", "threads"):
        numbers = [getattr(sample, name) for sample in samples]
        if max(numbers[len(numbers) // 2 :]) > max(numbers[: len(numbers) // 2 + 1]):
            yield f"{name} grow: {numbers[0]} to {numbers[-1]}"
