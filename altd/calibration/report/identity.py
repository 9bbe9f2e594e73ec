"""Which calibration a report is of, and where the report on a calibration file lies."""

from __future__ import annotations

import re
from pathlib import Path

PAGE_SUFFIX, SHEETS_SUFFIX = ".html", ".pdf"

HEAD_BYTES = 1024
"""What names the calibration stands within these first bytes of a report's page."""

_NAMED = re.compile(rb'<meta name="altd-calibration" content="(sha256:[0-9a-f]{64})">')


def meta_line(checksum: str) -> str:
    """The element of a page's head that names the calibration by the checksum that its file carries."""
    return f'<meta name="altd-calibration" content="{checksum}">'


def checksum_in(head: bytes) -> str | None:
    """The checksum of the calibration that a page is of, from its first bytes; None: it names none."""
    named = _NAMED.search(head[:HEAD_BYTES])
    return None if named is None else named[1].decode("ascii")


def page_beside(calibration: Path) -> Path:
    """Where the report on a calibration file is looked for: beside it, under the same name."""
    return calibration.with_suffix(PAGE_SUFFIX)
