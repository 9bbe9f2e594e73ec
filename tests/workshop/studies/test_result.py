import argparse
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from altd.errors import BadInputError
from altd.instruments.beam import solver
from studies import command
from studies.__main__ import main
from studies.bench import pooled_std
from studies.plot import as_svg, panels, round_below
from studies.result import HARDER, Column, Progress, Result, Row
from studies.result_table import table
from studies.study_page import differences, files_of, index, page, verdict, write
from studies.sweep import Point, rows


def result(
    *rows: Row, columns: tuple[Column, ...] = (Column("error, mm", 3), Column("count", 0, judged=False))
) -> Result:
    figure, (axis,) = panels()
    axis.plot([0, 1], [1, 0])
    return Result("lens", "Table 0.0", columns, rows, "It is so.", "one\ntwo\n\nthree", figure, "A line")


def test_the_thesis_stands_over_ours() -> None:
    lines = table(result(Row("f = 8", (0.01, 3), (0.02, None)), Row("f = 5.7", (0.5, None)))).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert cells[0] == ["lens", "", "error, mm", "count"]
    assert cells[2:] == [
        ["f = 8", "thesis", "0.020", "–"],
        ["", "ours", "0.010", "3"],
        ["f = 5.7", "ours", "0.500", "–"],
    ]
    assert len({len(line) for line in lines}) == 1


def test_without_the_thesis_there_is_no_column_for_it() -> None:
    lines = table(result(Row("f = 8", (0.01, 3)))).splitlines()
    assert [cell.strip() for cell in lines[2].strip("|").split("|")] == ["f = 8", "0.010", "3"]


def test_what_is_worse_is_marked_and_said() -> None:
    bad = result(Row("f = 8", (0.021, 9), (0.020, 3)), Row("f = 12", (0.0204, 3), (0.0200, 3)))
    assert table(bad).count("**worse:** 0.021") == 1
    assert table(bad).count("worse") == 1  # 0.0204 is printed as 0.020; the count is not judged
    assert verdict(bad) == "Worse than the thesis: error, mm (f = 8)."
    both = [Row("a", (0.1, 3)), Row("a, hard", (0.2, 9)), Row("b", (0.4, 1)), Row("b, hard", (0.36, 1))]
    assert verdict(result(*both, Row("c", (None, 1)), Row("c, hard", (0.1, 1)))) == (
        "Harder simulator: 1 of 2 figures are worse than on the ordinary one; the median is 1.4 times as "
        "large, the worst 2.0 times (error, mm; a, hard)."
    )


def test_a_verdict_needs_something_to_compare() -> None:
    assert verdict(result(Row("a", (0.1, 3)))) == ""
    assert verdict(result(Row("a", (0.1, 3), (None, 2)))) == ""
    assert verdict(result(Row("a", (0.1, 3), (0.2, 2)))) == "Worse than the thesis: nothing."


def test_pages_and_plots_are_the_same_every_time() -> None:
    first, second = (files_of("one", "One", "Is it?", result(Row("a", (0.1, 3), (0.2, 2)))) for _ in range(2))
    assert first == second
    assert set(first) == {"one.md", "one.svg"}


def test_the_index_repeats_the_headlines_of_the_pages_that_are_there(tmp_path: Path) -> None:
    write(tmp_path, files_of("one", "One", "Is it?", result(Row("a", (0.1, 3)))))
    text = index(tmp_path, [("one", "One"), ("two", "Two")])
    assert "| [One](one.md) | It is so. |" in text
    assert "two.md" not in text


def test_no_line_of_a_page_is_too_long_and_the_index_has_a_long_headline_in_one(tmp_path: Path) -> None:
    headline = "It is so, " + "and so, " * 20 + "and no other way."
    shown = replace(result(Row("a", (0.1, 3))), headline=headline)
    write(tmp_path, files_of("one", "One", "Is it?", shown))
    assert max(map(len, (tmp_path / "one.md").read_text().splitlines())) <= 120
    assert f"| [One](one.md) | {headline} |" in index(tmp_path, [("one", "One")])


def test_a_page_holds_table_plot_and_text() -> None:
    text = page("one", "One", "Is it?", result(Row("a", (0.1, 3))))
    assert text.startswith("# One\n\nIt is so.\n\n*Is it?*\n")
    assert "![One](one.svg)" in text
    assert "\none two\n\nthree\n" in text


def test_a_page_states_how_its_study_differs_from_the_thesis() -> None:
    same = result(Row("a", (0.1, 3)))
    assert "Different here" not in page("one", "One", "Is it?", same)
    other = page("one", "One", "Is it?", replace(same, differs="one lens, not four"))
    assert f"\nThesis: {same.thesis_source}.\n\nDifferent here: one lens, not four.\n" in other


def test_a_plot_has_no_date_and_changes_with_what_it_shows() -> None:
    figures = []
    for height in (1.0, 2.0, 1.0):
        figure, (axis,) = panels()
        axis.bar([0], [height])
        figures.append(as_svg(figure, "salt"))
    assert figures[0] == figures[2] != figures[1]
    assert "dc:date" not in figures[0]


def test_a_sweep_names_the_specification() -> None:
    specified = replace(result(Row("5 mW", (0.3, 3), (0.2, 2))), beside="specified")
    assert "specified" in table(specified)
    assert "thesis" not in table(specified)
    assert verdict(specified) == "Worse than specified: error, mm (5 mW)."
    easy, hard = ([Point(f"{lux} lx{end}", lux, (0.1,) * 6) for lux in (0, 1000)] for end in ("", HARDER))
    table_rows = rows(easy, hard, lambda point: point.value == 1000)
    assert [row.name for row in table_rows] == ["0 lx", "0 lx, hard", "1000 lx", "1000 lx, hard"]
    assert [row.thesis is not None for row in table_rows] == [False, False, True, True]


@pytest.mark.parametrize(
    ("value", "below"),
    [(0.0199, 0.01), (0.02, 0.02), (7.3, 5.0), (1.0, 1.0), (0.0005, 0.0005), (430.0, 200.0)],
)
def test_a_key_has_a_round_length(value: float, below: float) -> None:
    assert round_below(value) == pytest.approx(below)


def test_repeats_are_pooled_over_the_places_and_a_gap_does_not_count() -> None:
    rng = np.random.default_rng(1)
    readings = rng.normal(0.0, [0.5, 2.0], size=(400, 4, 2)) + rng.normal(0.0, 50.0, size=(400, 1, 2))
    readings[7, 2, 1] = math.nan
    assert pooled_std(readings) == pytest.approx([0.5, 2.0], rel=0.05)


def test_the_command_prints_the_table_and_writes_the_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(_progress: Progress) -> Result:
        return result(Row("a", (0.3, 3), (0.2, 2)))

    monkeypatch.setattr(command, "STUDIES", {"one": 1})
    monkeypatch.setattr(
        command, "module_of", lambda _name: SimpleNamespace(TITLE="One", QUESTION="Is it?", run=run)
    )
    assert main(["one", "-o", str(tmp_path / "pages")]) == 0
    printed = capsys.readouterr()
    assert "**worse:** 0.300" in printed.out
    assert printed.err == ""
    assert {path.name for path in (tmp_path / "pages").iterdir()} == {"one.md", "one.svg", "README.md"}


def test_an_unknown_study_is_one_line_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fig-9.9"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("studies: NAME: unknown study 'fig-9.9'; known are conic, ")
    assert printed.err.count("\n") == 1


def test_an_output_that_is_a_file_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").write_text("precious")
    assert main(["fig-3.5", "-o", str(tmp_path / "mine")]) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", f"studies: {tmp_path / 'mine'}: is not a folder\n")


def test_without_matplotlib_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(BadInputError, match=r"altd\[report\]"):
        command.run(argparse.Namespace(names=["fig-3.5"], output=None, check=False))


def test_every_study_has_its_module() -> None:
    for name in command.STUDIES:
        assert command.module_of(name).TITLE


def test_four_turns_make_each_dear_study_once_and_the_cheap_ones_each_time() -> None:
    cheap = {name for name, cpu_s in command.STUDIES.items() if cpu_s <= command.MAX_CHEAP_CPU_S}
    turns = [command.in_turn(number, 4) for number in range(3, 7)]
    dear = sorted(name for turn in turns for name in turn if name not in cheap)
    assert dear == sorted(set(command.STUDIES) - cheap)
    assert all(cheap <= set(turn) for turn in turns)
    costs = [sum(command.STUDIES[name] for name in turn) for turn in turns]
    assert max(costs) - min(costs) <= max(command.STUDIES.values())
    assert command.in_turn(0, 1) == list(command.STUDIES)
    assert main(["--check", "--turn", "3/0"]) == 2


def test_the_check_names_all_pages_that_differ_with_their_first_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def module(name: str) -> SimpleNamespace:
        def run(_progress: Progress) -> Result:
            if name == "lost":
                raise BadInputError(tmp_path / "data", "is not there")
            return result(Row("a", (0.3, 3)))

        return SimpleNamespace(TITLE=name, QUESTION="Is it?", run=run)

    monkeypatch.setattr(command, "STUDIES", {"one": 1, "two": 1})
    monkeypatch.setattr(command, "module_of", module)
    assert main(["-o", str(tmp_path)]) == 0
    assert main(["--check", "-o", str(tmp_path)]) == 0
    assert re.findall(r"^(.+): as stored; \d+ s of CPU$", capsys.readouterr().out, re.MULTILINE) == [
        "one",
        "two",
    ]

    monkeypatch.setattr(command, "STUDIES", {"one": 1, "lost": 1, "two": 1})
    page = (tmp_path / "one.md").read_text().replace("0.300", "0.301")
    (tmp_path / "one.md").write_text(page)
    (tmp_path / "two.svg").unlink()
    assert main(["--check", "-o", str(tmp_path)]) == 1
    line = 1 + page.split("\n").index("|a   |    0.301|    3|")
    assert capsys.readouterr().err.splitlines()[:4] == [
        f"{tmp_path}/one.md:{line} differs",
        "    stored: |a   |    0.301|    3|",
        "    made:   |a   |    0.300|    3|",
        f"lost cannot be made: {tmp_path}/data: is not there",
    ]
    assert (tmp_path / "one.md").read_text() == page


def test_a_plot_may_shift_by_its_last_digit_and_a_page_may_not(tmp_path: Path) -> None:
    write(tmp_path, {"a.svg": "L 1.25 7.00\nz", "a.md": "0.1250"})
    assert differences(tmp_path, {"a.svg": "L 1.26 7.00\nz", "a.md": "0.1250"}) == []
    for made in (
        {"a.svg": "L 1.31 7.00\nz"},
        {"a.svg": "L 1.25 7.00"},
        {"a.svg": "M 1.25 7.00\nz"},
        {"a.md": "0.1251"},
    ):
        assert len(differences(tmp_path, made)) == 1


def test_the_check_fails_for_a_sigma_that_is_two_per_cent_larger(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--check", "fig-3.5"]) == 0
    gain = solver.line_gain
    monkeypatch.setattr(solver, "line_gain", lambda *given: (gain(*given)[0], 1.02**2 * gain(*given)[1]))
    assert main(["--check", "fig-3.5"]) == 1
    assert "    made:   |sigma that altd states|ours  |     0.0295|" in capsys.readouterr().err
