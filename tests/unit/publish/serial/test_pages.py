"""The pages in docs are what the code says."""

from __future__ import annotations

import pytest
from support.places import DOCS

from altd.publish.serial.telegram import SENTENCES
from tools.pages import console as console_page
from tools.pages import telegram as telegram_page


@pytest.mark.parametrize(("name", "page"), [("telegram", telegram_page.page), ("console", console_page.page)])
def test_the_page_is_generated_from_the_code(name: str, page: object) -> None:
    assert callable(page)
    assert (DOCS / f"{name}.md").read_text() == page(), f"run python -m altd.publish.serial.{name}_page"


def test_every_field_of_the_telegram_is_on_its_page() -> None:
    page = telegram_page.page()
    assert all(f"`{field.name}`" in page for sentence in SENTENCES for field in sentence.fields)
