"""Paths of the project's files."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
CACHE = Path(
    os.environ.get("ALTD_CACHE") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "altd")
)
"""Folder of what is kept between runs; ``.ci/kernel`` keeps its kernel there, too."""
SHARED_DATA = ROOT.parent / "shared" / "data"
"""Recordings and photographs that this project did not make."""
EXAMPLES = ROOT / "examples"
