"""Which phrases the language check finds, and where."""

from pathlib import Path

import pytest

from tools.plain import findings, main


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.md", "Fine.\n\nIt goes\non.", [(3, "goes on")]),
        ("a.md", "`who says so` is code.\n\n    nobody\n\n```\nanew\n```\nLoaded anew.", [(8, "anew")]),
        ("a.md", "[a page](stands.md)", []),
        ("a.md", "# What is needed\n\n## How?\n", [(1, "# What is needed")]),
        ("a.py", "a = 1  # who asked", [(1, "# who asked")]),
        ("a.py", '"""What it is.\n\nWhat follows.\n"""\n"""Why? What is it?"""', [(1, '"""What it is.')]),
        (
            "a.md",
            "A rule for who reads: Who asks, waits.",
            [(1, ": Who asks, waits."), (1, "for who"), (1, ": Who asks")],
        ),
        (
            "a.py",
            'x = 1\nnobody = """One.\n\n    It is told of it.\n    """  # by itself',
            [(4, "is told"), (5, "by itself")],
        ),
        ("a.py", 'stands = f"{nobody} whoever"', [(1, "whoever")]),
        (
            "a.py",
            'def f():\n    "Nobody."\n    x = "the bit\\nstands"\n    # anew',
            [(2, "Nobody"), (3, "stands"), (4, "anew")],
        ),
        ("a.py", 'x["stands"] = "anew"  # keys are no text', []),
        ("tests/a.py", '"""Anew."""\ndef stands():\n    ask("so anew")  # anew', [(1, "Anew"), (3, "anew")]),
        ("a.js", "let a = 'for ever';", [(1, "for ever")]),
        ("a.md", "The two faces of the instrument; the bit stands\n", [(1, "stands")]),
    ],
)
def test_phrases(name: str, text: str, expected: list[tuple[int, str]]) -> None:
    assert [(finding.line, finding.phrase) for finding in findings(name, text)] == expected


def test_the_python_files_of_a_folder_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "a.py").write_text(
        '"""A room."""\n\nx = "of no use"\n\n\ndef f():\n    """Stands."""\n'
    )
    (tmp_path / "plain.py").write_text('"""Stands."""\n')
    assert main([str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"{tmp_path}/room/a.py:7: “Stands”: is, is listed, means\n"


def test_a_finding_names_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "page.md").write_text("One.\n\nNobody knows.\n")
    assert main([str(tmp_path / "page.md")]) == 1
    assert capsys.readouterr().err == f"{tmp_path}/page.md:3: “Nobody”: do not, none, again, a person\n"
    (tmp_path / "page.md").write_text("One.\n")
    assert main([str(tmp_path / "page.md")]) == 0
