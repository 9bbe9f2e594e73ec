"""The page in docs is what the code says."""

from __future__ import annotations

from pathlib import Path

from altd.publish.http.publisher import PATHS
from tools.pages.http import page

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_the_page_is_generated_from_the_code() -> None:
    assert (DOCS / "http.md").read_text() == page(), "run python -m tools.pages.http"


def test_every_path_is_on_the_page() -> None:
    assert all(f"| `{path.path}` |" in page() for path in PATHS)
