"""The pages in docs are what the code says."""

import re

import pytest
from support.places import DOCS

from tools.pages import console as console_page
from tools.pages import telegram as telegram_page


@pytest.mark.parametrize(("name", "page"), [("telegram", telegram_page.page), ("console", console_page.page)])
def test_the_page_is_generated_from_the_code(name: str, page: object) -> None:
    assert callable(page)
    assert (DOCS / f"{name}.md").read_text() == page(), "run: make pages"


def test_the_shortest_interval_is_the_time_of_the_longest_telegram_at_each_baud_rate() -> None:
    head, _, *rows = re.findall(r"^\|.*\|$", telegram_page.page().split("8N1:\n\n")[1], re.MULTILINE)[:6]
    bauds = [int(text) for text in head.split("|")[2:-1]]
    assert (bauds[0], bauds[-1], len(bauds)) == (1200, 230400, 9)
    for sentences, row in zip((2, 3, 3, 4), rows, strict=True):
        for baud, text in zip(bauds, row.split("|")[2:-1], strict=True):
            takes_s = sentences * 82 * 10 / baud  # 82 characters of a start bit, 8 data bits and a stop bit
            assert max(takes_s, 0.05) <= float(text) < max(takes_s, 0.05) + 0.01
