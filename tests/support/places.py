"""Paths of the project's files."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SHARED_DATA = ROOT.parent / "shared" / "data"
"""Recordings and photographs that this project did not make."""
EXAMPLES = ROOT / "examples"
