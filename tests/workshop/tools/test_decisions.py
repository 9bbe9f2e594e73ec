"""The index of the decisions checks their form."""

from pathlib import Path

import pytest

from tools.pages.decisions import page

DECISION = """# 1. Pencils, not pens

Status: accepted. Date: 2026-11-21.

## Context

Ink freezes.

## Decision

We write with pencils.

## Consequences

- Rubber is needed.
"""


def test_a_decision_is_an_item_with_a_link(tmp_path: Path) -> None:
    (tmp_path / "0001-pencils.md").write_text(DECISION)
    (tmp_path / "README.md").write_text("the index itself")
    assert page(tmp_path).splitlines()[-1] == "- [0001](0001-pencils.md) Pencils, not pens"


def test_a_superseded_decision_names_its_successor(tmp_path: Path) -> None:
    (tmp_path / "0001-pencils.md").write_text(DECISION.replace("accepted", "superseded by 0002"))
    last = page(tmp_path).splitlines()[-1]
    assert last == "- [0001](0001-pencils.md) Pencils, not pens (superseded by 0002)"


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("0001-pencils.md", "Status: accepted. ", "", "lacks the form"),
        ("0001-pencils.md", "Status: accepted", "Status: perhaps", "lacks the form"),
        ("0001-pencils.md", "2026-11-21", "2026-11", "lacks the form"),
        ("0001-pencils.md", "## Consequences", "## Outcome", "lacks the form"),
        ("0001-pencils.md", "## Context\n\nInk freezes.\n\n", "", "lacks the form"),
        ("0001-pencils.md", "# 1.", "# 2.", "must have the number 0001"),
        ("0002-pencils.md", "# 1.", "# 2.", "must have the number 0001"),
    ],
)
def test_one_without_the_form_or_the_next_number_is_refused(
    tmp_path: Path, name: str, old: str, new: str, words: str
) -> None:
    (tmp_path / name).write_text(DECISION.replace(old, new))
    with pytest.raises(ValueError, match=words) as caught:
        page(tmp_path)
    assert name in str(caught.value)


def test_two_of_one_number_are_refused(tmp_path: Path) -> None:
    (tmp_path / "0001-pencils.md").write_text(DECISION)
    (tmp_path / "0001-pens.md").write_text(DECISION)
    with pytest.raises(ValueError, match=r"0001-pens\.md.*must have the number 0002"):
        page(tmp_path)
