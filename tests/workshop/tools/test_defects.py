"""Each defect of ``python -m tools.defects`` has its place in the current code, and the runner reports it."""

import ast
import threading
import time
from pathlib import Path

import pytest

from tools.defects.__main__ import report
from tools.defects.catalogue import DEFECTS, EXPLAINED
from tools.defects.copies import Copies
from tools.defects.defect import Defect
from tools.defects.draw import defects_of, drawn

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def of_seed_1() -> list[Defect]:
    return drawn(ROOT, 48, 1)


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_defect_has_one_place_and_changes_it(defect: Defect) -> None:
    assert (ROOT / defect.file).read_text(encoding="utf-8").count(defect.old) == 1
    assert defect.new != defect.old


def test_the_drawn_defects_are_python_in_all_rooms_and_the_same_each_time(of_seed_1: list[Defect]) -> None:
    for defect in of_seed_1:
        text = (ROOT / defect.file).read_text(encoding="utf-8")
        assert ast.dump(ast.parse(defect.put_into(text))) != ast.dump(ast.parse(text)), defect.what
    assert len({defect.what for defect in (*DEFECTS, *of_seed_1)}) == len(DEFECTS) + 48 >= 60
    rooms = {path.stem for path in (ROOT / "altd").iterdir() if path.suffix in ("", ".py")}
    assert rooms - {defect.room for defect in (*DEFECTS, *of_seed_1)} <= {"__init__", "__pycache__", "ports"}
    assert drawn(ROOT, 48, 1) == of_seed_1


def test_another_seed_draws_others_and_modules_bounds_their_files(of_seed_1: list[Defect]) -> None:
    others = drawn(ROOT, 6, 2, modules=3)
    assert not {defect.what for defect in others} & {defect.what for defect in of_seed_1}
    files = [defect.file for defect in others]
    assert sorted(files.count(file) for file in set(files)) == [2, 2, 2]


def test_only_drawn_defects_are_explained(of_seed_1: list[Defect]) -> None:
    assert set(EXPLAINED) <= {defect.what for defect in of_seed_1}


@pytest.mark.parametrize(
    ("source", "texts"),
    [
        ("x = a + b", ["x = a", "x = (a - b)"]),
        ("x = -a", ["x = a"]),
        ("x = a < 3", ["x = (a >= 3)", "x = (a < 2 * 3)", "x = (a <= 3)", "x = a < 4"]),
        ("x = a and b", ["x = (a or b)", "x = a", "x = b"]),
        ("if not a:\n    return", ["if a:\n    return", "if False:\n    return"]),
        ("x = (é, f(a, b.c))", ["x = (é, f(b.c, a))"]),
        ("x = min(a, 2.5)", ["x = max(a, 2.5)", "x = min(a, 5.0)"]),
        ("a.clear()", ["pass"]),
        ("n += m", ["n = m"]),
        ("log.info('%s', a + 1)", []),
        ("raise ValueError(f'{a + 1}')", []),
        ("def f(a: Literal[1] = 3):\n    'Text of 2.'", ["def f(a: Literal[1] = 4):\n    'Text of 2.'"]),
        ("class A(Protocol):\n    def f(self) -> int:\n        return 1", []),
        ("@overload\ndef f() -> int:\n    return 1", []),
    ],
)  # fmt: skip
def test_a_node_is_mutated_and_no_text_or_type(source: str, texts: list[str]) -> None:
    found = [defect.put_into(source) for _, defect in defects_of("altd/x.py", source)]
    assert sorted(found) == sorted(texts)


CAUGHT = Defect("a term is lost", "altd/room/sums.py", "a + b", "a")
MISSED = Defect("a constant is wrong", "altd/room/sums.py", "SPARE = 3", "SPARE = 4")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    files = {
        "altd/__init__.py": "",
        "altd/room/__init__.py": "",
        "altd/room/sums.py": "SPARE = 3\n\n\ndef total(a, b):\n    return a + b\n",
        "tests/unit/room/test_sums.py": "from altd.room.sums import total\n\n\n"
        "def test_a_sum():\n    assert total(2, 3) == 5\n",
    }
    for name, text in files.items():
        (tmp_path / "project" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "project" / name).write_text(text)
    return tmp_path / "project"


def test_the_runner_tells_what_is_caught_from_what_is_not(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copies = Copies(project, project.parent / "copies", 1)
    assert report([CAUGHT, MISSED], copies) == 1
    assert capsys.readouterr().out.splitlines() == [
        "a term is lost",
        "    tests/unit/room/test_sums.py::test_a_sum",
        "a constant is wrong",
        "    NOT CAUGHT",
        "1 of 2 defects caught, 0 explained, 1 NOT CAUGHT",
    ]
    for root in (project, project.parent / "copies/0"):
        assert "SPARE = 3" in (root / MISSED.file).read_text()
        assert "a + b" in (root / CAUGHT.file).read_text()


def test_a_test_that_fails_without_the_defect_too_catches_nothing(project: Path) -> None:
    test = project / "tests/unit/room/test_sums.py"
    test.write_text(test.read_text().replace("== 5", "== 6"))
    assert Copies(project, project.parent / "copies", 1).caught_by(CAUGHT, "room") == ""


def test_an_end_ends_running_tests_and_leaves_no_defect(project: Path) -> None:
    begun = project.parent / "begun"
    test = project / "tests/unit/room/test_sums.py"
    test.write_text(
        "import signal\nfrom pathlib import Path\n\n\n"
        f"def test_it_waits():\n    Path({str(begun)!r}).touch()\n    signal.pause()\n"
    )
    copies = Copies(project, project.parent / "copies", 1)
    run = threading.Thread(target=copies.caught_by, args=(CAUGHT, "unit"))
    run.start()
    while run.is_alive() and not begun.exists():
        time.sleep(0.01)
    copies.end()
    run.join()
    assert begun.exists()
    assert "a + b" in (project.parent / "copies/0" / CAUGHT.file).read_text()
