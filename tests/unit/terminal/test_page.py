"""The page of the terminal is what the code draws."""

from __future__ import annotations

from support.places import DOCS

from tools.pages import terminal


def test_the_page_is_generated_from_the_code() -> None:
    assert (DOCS / "terminal.md").read_text() == terminal.page(), "run python -m tools.pages.terminal"
