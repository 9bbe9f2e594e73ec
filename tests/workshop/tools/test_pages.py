"""The generated pages: all that are out of date are named at once, and only those are written."""

from pathlib import Path

import pytest

from tools.pages import __main__ as pages


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
