"""Each fault of a config is answered by its line and key, by `altd run` as by `altd check-config`."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from altd.app.settings import load_settings
from altd.cli.main import main
from altd.config import (
    HwmonThermometerSettings,
    InclinometerSettings,
    Maintenance,
    SelfCheckSettings,
    Table,
)
from altd.errors import BadInputError

from . import spoilt as spoilt_cases
from . import spoilt_checks
from .no_toml import NO_TOML
from .whole_config import BASE

CASES = spoilt_cases.CASES + spoilt_checks.CASES


def spoilt(old: str, new: str) -> tuple[str, str]:
    """The text without its mark, and the place of the mark."""
    assert BASE.count(old) >= 1, old
    text = BASE.replace(old, new, 1)
    if "«" not in text:  # the fault is where it was, and another key makes it one
        return text, ""
    before, after = text.split("«")
    line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
    return before + after, f"line {line}, column {column}: "


def complaints(path: Path) -> list[str]:
    with pytest.raises(BadInputError) as caught:
        load_settings(path)
    return [line.removeprefix(f"{path}: ") for line in caught.value.lines]


def test_the_base_is_good(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(BASE)
    load_settings(path)


def test_there_are_enough_of_them() -> None:
    assert len({(old, new) for old, new, _, _ in CASES}) == len(CASES) >= 60


@pytest.mark.parametrize(
    ("table", "model"),
    [
        ("self_check.", SelfCheckSettings),
        ("inclinometer.", InclinometerSettings),
        ("thermometers.", HwmonThermometerSettings),
        ("maintenance.", Maintenance),
    ],
)
def test_every_key_of_the_tables_that_watch_is_wrong_in_some_case(table: str, model: type[Table]) -> None:
    spoilt_keys = {key.rpartition(".")[2] for _, _, key, _ in CASES if key.startswith(table)}
    assert set(model.model_fields) <= spoilt_keys


@pytest.mark.parametrize(
    ("old", "new", "key", "words"), CASES, ids=[f"{c[2]}-{n}" for n, c in enumerate(CASES)]
)
def test_a_fault_is_answered_by_its_line_and_its_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, key: str, words: str
) -> None:
    path = tmp_path / "altd.toml"
    text, place = spoilt(old, new)
    path.write_text(text)
    found = [line for line in complaints(path) if f": {key}: " in f": {line}"]
    assert len(found) == 1, complaints(path)
    assert found[0].startswith(f"{place}{key}: ") or (not place and f": {key}: " in found[0])
    assert words in found[0]
    follow_ups = [line for line in complaints(path) if line != found[0]]
    assert all("is missing" in line for line in follow_ups), follow_ups  # of a tag that chooses the table
    for command in (["check-config", str(path)], ["run", "--config", str(path)]):
        assert main(command) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.splitlines() == [f"altd {command[0]}: {path}: {line}" for line in complaints(path)]


@pytest.mark.parametrize(("old", "new", "words"), NO_TOML)
def test_what_is_no_toml_is_one_line_with_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "altd.toml"
    text, place = spoilt(old, new)
    path.write_text(text)
    (line,) = complaints(path)
    assert line.startswith(f"{place}not TOML: ")
    assert words in line


@pytest.mark.parametrize(
    ("old", "new", "first", "count"),
    [
        ("[cameras.front]", "[camera.front]", "camera: there is no such table", 1),
        ("[[targets]]", "[[target]]", "target: there is no such table", 1),
        ('serial = "TEST-1"', 'serail = "TEST-1"', "unit.serail: there is no such key", 1),
        ("[measuring]\n", "", "cameras.rear.exposure.window: there is no such key", 6),
        ("[cameras.front]\n", "", "targets.1.driver: there is no such key", 6),
        ("[[targets]]\n", "", "unit.name: there is no such key", 3),
    ],
)
def test_what_follows_from_a_name_that_is_wrong_is_not_said_before_it(
    tmp_path: Path, old: str, new: str, first: str, count: int
) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(BASE.replace(old, new, 1))
    lines = complaints(path)
    assert first in lines[0], lines
    assert len(lines) == count, lines


def test_all_faults_are_said_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    """One case a line: none of them hides another."""
    text = BASE
    keys: list[str] = []
    for old, new, key, words in spoilt_cases.CASES:
        alone = new.count("«") == 1 and "\n" not in old + new and key.count(".") == 1
        if alone and not words.endswith("too") and text.count(old) == 1 and not key.startswith("targets"):
            keys.append(key)
            text = text.replace(old, new.replace("«", ""))
    path = tmp_path / "altd.toml"
    path.write_text(text)
    said = [line.partition(": ")[2].partition(": ")[0] for line in complaints(path)]
    assert set(keys) <= set(said)
    assert len(keys) > 12
    lines = [int(line.split()[1].rstrip(",")) for line in complaints(path) if line.startswith("line ")]
    assert all(before <= after for before, after in itertools.pairwise(lines))
