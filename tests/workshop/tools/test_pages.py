"""Generated pages: those out of date are named at once; the form of decisions; states and their causes."""

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from altd.reasons import Reason, Signal
from altd.status.conditions import Condition
from tools.pages import __main__ as pages
from tools.pages.decisions import page as index
from tools.pages.reasons import page as reasons_page
from tools.pages.states_picture import WIDTH_PX, picture


def test_all_stale_pages_are_named_at_once_and_only_they_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def page_of_wrong_files() -> str:
        raise ValueError("0007-x.md: lacks the form")

    made = {"a.md": lambda: "new a", "b.svg": lambda: "b", "c.md": lambda: "c"}
    monkeypatch.setattr(pages, "PAGES", {"bad.md": page_of_wrong_files, **made})
    (tmp_path / "a.md").write_text("old a")
    (tmp_path / "b.svg").write_text("b")
    bad = "docs/bad.md cannot be made: 0007-x.md: lacks the form\n"
    assert pages.main(["--check"], tmp_path) == 1
    assert capsys.readouterr() == ("", f"{bad}out of date (make pages): docs/a.md, docs/c.md\n")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.md": "old a", "b.svg": "b"}

    assert pages.main([], tmp_path) == 1
    assert capsys.readouterr() == ("written: docs/a.md, docs/c.md\n", bad)
    monkeypatch.setattr(pages, "PAGES", made)
    assert pages.main(["--check"], tmp_path) == 0
    assert capsys.readouterr().out == "all 3 generated pages are up to date\n"


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
    assert index(tmp_path).splitlines()[-1] == "- [0001](0001-pencils.md) Pencils, not pens"


def test_a_superseded_decision_names_its_successor(tmp_path: Path) -> None:
    (tmp_path / "0001-pencils.md").write_text(DECISION.replace("accepted", "superseded by 0002"))
    last = index(tmp_path).splitlines()[-1]
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
        index(tmp_path)
    assert name in str(caught.value)


def test_two_of_one_number_are_refused(tmp_path: Path) -> None:
    (tmp_path / "0001-pencils.md").write_text(DECISION)
    (tmp_path / "0001-pens.md").write_text(DECISION)
    with pytest.raises(ValueError, match=r"0001-pens\.md.*must have the number 0002"):
        index(tmp_path)


_SVG = "{http://www.w3.org/2000/svg}"


def test_the_picture_names_every_state_and_every_cause_once() -> None:
    root = ET.fromstring(picture())
    texts = [text.text or "" for text in root.iter(f"{_SVG}text")]
    for kind in (*Reason, *Condition):
        assert texts.count(str(kind)) == 1
    for signal in Signal:
        assert texts.count(f"{str(signal).replace('_', ' ')} ({signal.number})") == 1
    assert all(0 <= float(text.get("x", "-1")) < WIDTH_PX for text in root.iter(f"{_SVG}text"))


def test_each_cause_stands_in_the_box_of_its_signal() -> None:
    root = ET.fromstring(picture())
    frames = [rect for rect in root.iter(f"{_SVG}rect") if rect.get("stroke")]
    expected = ("failure", "check_function", "out_of_specification", "maintenance_required", "good")
    spans = [(float(rect.get("y", "0")), float(rect.get("height", "0"))) for rect in frames]
    assert spans == sorted(spans)
    boxes = dict(zip(expected, spans, strict=True))
    place = {text.text: float(text.get("y", "0")) for text in root.iter(f"{_SVG}text")}
    for kind in (*Reason, *Condition):
        top, height = boxes[str(kind.signal)]
        assert top < place[str(kind)] < top + height


def test_the_page_has_an_entry_for_every_cause_that_begins_with_its_remedy() -> None:
    page = " ".join(reasons_page().split())
    for kind in (*Reason, *Condition):
        remedy = kind.remedy[0].upper() + kind.remedy[1:]
        heading = f'#### <a id="{kind}"></a>{kind.brief} (`{kind}`)'
        assert f"{heading} **{remedy}.** Meaning: {kind.meaning}. State: `{kind.signal}`." in page
