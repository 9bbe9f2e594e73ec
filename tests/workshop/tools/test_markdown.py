"""Text that is wrapped at 120 characters, and text that is left alone."""

from pathlib import Path

import pytest

from tools.markdown import long_lines, main, wrapped

WORDS = " ".join(["word"] * 30)  # 149 characters
SHORT = " ".join(["word"] * 24)  # 119
REST = " ".join(["word"] * 6)


@pytest.mark.parametrize(
    ("page", "expected"),
    [
        (WORDS, f"{SHORT}\n{REST}"),
        (f"{WORDS}\nand on", f"{SHORT}\n{REST} and on"),
        (f"- {WORDS}", f"- {SHORT[:-5]}\n  word {REST}"),
        (f"12. {WORDS}", f"12. {SHORT[:-5]}\n    word {REST}"),
        (f"- one\n- {WORDS}\n- three", f"- one\n- {SHORT[:-5]}\n  word {REST}\n- three"),
        (f"{SHORT} [two words](there.md)", f"{SHORT}\n[two words](there.md)"),
        (f"{SHORT} `a b c` end", f"{SHORT}\n`a b c` end"),
    ],
)
def test_text_is_wrapped(page: str, expected: str) -> None:
    assert wrapped(page) == expected
    assert list(long_lines(wrapped(page))) == []


@pytest.mark.parametrize(
    "page",
    [
        SHORT,
        "short\nlines\nstay as they are",
        f"| {WORDS} |",
        f"# {WORDS}",
        f"<!-- {WORDS} -->",
        f"text\n\n    {WORDS}",
        f"```\n{WORDS}\n```",
        f"{SHORT[:100]} [two](https://example.org/{'x' * 60})",
        "x" * 150,
    ],
)
def test_what_is_no_text_or_cannot_be_broken_stays(page: str) -> None:
    assert wrapped(page) == page
    assert list(long_lines(page)) == []


def test_each_long_line_is_named_by_its_file_and_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "good.md", tmp_path / "bad.md"
    good.write_text(f"# Good\n\n{SHORT}\n")
    bad.write_text(f"# Bad\n\n{SHORT}\n\n```\n{WORDS}\n```\n{WORDS}\n- {WORDS}\n")
    assert main([str(good)]) == 0
    assert main([str(good), str(bad)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        f"{bad}:8: longer than 120 characters",
        f"{bad}:9: longer than 120 characters",
    ]
    assert main(["--wrap", str(bad)]) == 0
    assert main([str(bad)]) == 0


def test_broken_tables_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    table = "| a | b |\n|---|---|\n| 1 | 2 |\n"
    page.write_text(f"{table}\n{table}```\n| code |\nnot text\n```\n")
    assert main([str(page)]) == 0
    page.write_text(f"{table}\n| 3 | 4 |\n| | |\n\n{table}| 7 | broken\noff |\n| 8 | 9 |\n")
    assert main([str(page)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"{page}:5: a table row without a heading",
        f"{page}:12: text directly below a table",
        f"{page}:13: a table row without a heading",
    ]


def test_links_to_files_that_do_not_exist_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    (tmp_path / "there.py").touch()
    good = "[a](../there.py), [b](page.md#anchor), [c](#anchor), [d](https://example.org/x), `[e](gone.md)`\n"
    page.write_text(f"{good}\n```\n[f](gone.md)\n```\n")
    assert main([str(page)]) == 0
    page.write_text(f"{good}\n| [a](../gone.py) | ![b](gone.svg) |\n|---|---|\n\n- [c](gone.md#anchor)\n")
    assert main([str(page)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        f"{page}:3: links to ../gone.py, which does not exist",
        f"{page}:3: links to gone.svg, which does not exist",
        f"{page}:6: links to gone.md, which does not exist",
    ]
