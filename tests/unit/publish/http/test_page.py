"""The page in docs is what the code says."""

from __future__ import annotations

from support.places import DOCS

from altd.publish.http.paths import PATHS
from tools.pages.http import page


def test_the_page_is_generated_from_the_code() -> None:
    assert (DOCS / "http.md").read_text() == page(), "run: make pages"


def test_every_path_is_on_the_page() -> None:
    assert all(f"| `{path.path}` |" in page() for path in PATHS)
