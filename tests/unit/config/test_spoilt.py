"""Each fault of a config is answered by its line and key, by `altd run` as by `altd check-config`."""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from altd.app.settings import load_settings
from altd.cli.main import main
from altd.config import InclinometerSettings, Maintenance, SelfCheckSettings, Table
from altd.devices.hwmon import HwmonThermometerSettings
from altd.errors import BadInputError

from .spoilt import NO_TOML, OTHERS, TABLE
from .whole_config import BASE


def with_lines(settings: str, table: str, lines: str) -> str:
    """The settings with lines of ``TABLE`` in a table."""
    header = ".".join(name for name in table.split(".") if not name.isdigit())
    number = next((int(name) for name in table.split(".") if name.isdigit()), 0)
    begin = [found.end() for found in re.finditer(rf"^\[+{header}\]+\n", settings, re.MULTILINE)][number]
    end = (settings + "\n[").index("\n[", begin - 1)
    content = {line.partition(" =")[0]: line for line in settings[begin:end].strip("\n").split("\n")}
    for line in lines.split("; "):
        if line.startswith("-"):
            del content[line[1:]]
        elif "=" in line:
            content[line.partition(" =")[0]] = line
    return settings[:begin] + "\n".join([*content.values(), ""]) + settings[end:]


def of_table() -> Iterator[tuple[str, str, str, str]]:
    """The table and the lines of each fault, the key that is wrong, words of the complaint."""
    table = ""
    for row in TABLE.strip().splitlines():
        if row.startswith("["):
            table = row.strip("[]")
            continue
        lines, words = (part.strip() for part in row.split(" #"))
        key = f"{table}.{re.split(' =|; ', lines)[0].lstrip('«-')}"
        inside, _, of_inside = words.partition(": ") if words.startswith(".") else ("", "", words)
        yield table, lines, key + inside, of_inside


def replaced(old: str, new: str) -> str:
    assert old in BASE, old
    return BASE.replace(old, new, 1)


ROWS = tuple(of_table())
CASES = tuple((with_lines(BASE, table, lines), key, words) for table, lines, key, words in ROWS)
CASES += tuple((replaced(old, new), key, words) for old, new, key, words in OTHERS)


def spoilt(marked: str) -> tuple[str, str]:
    """The text without its mark, and the place of the mark; without one the fault is of another key."""
    before, mark, after = marked.partition("«")
    line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
    return before + after, f"line {line}, column {column}: " if mark else ""


def complaints(path: Path) -> list[str]:
    with pytest.raises(BadInputError) as caught:
        load_settings(path)
    return [line.removeprefix(f"{path}: ") for line in caught.value.lines]


def test_the_base_is_good(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    path.write_text(BASE)
    load_settings(path)


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
    spoilt_keys = {key.rpartition(".")[2] for _, key, _ in CASES if key.startswith(table)}
    assert set(model.model_fields) <= spoilt_keys


@pytest.mark.parametrize(
    ("marked", "key", "words"), CASES, ids=[f"{key}-{n}" for n, (_, key, _) in enumerate(CASES)]
)
def test_a_fault_is_answered_by_its_line_and_its_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], marked: str, key: str, words: str
) -> None:
    path = tmp_path / "altd.toml"
    text, place = spoilt(marked)
    path.write_text(text)
    said = complaints(path)
    found = [line for line in said if f": {key}: " in f": {line}"]
    assert len(found) == 1, said
    assert found[0].startswith(f"{place}{key}: ") or (not place and f": {key}: " in found[0])
    assert words in found[0]
    follow_ups = [line for line in said if line != found[0]]
    assert all("is missing" in line for line in follow_ups), follow_ups  # of a tag that chooses the table
    for command in (["check-config", str(path)], ["run", "--config", str(path)]):
        assert main(command) == 2
        shown = capsys.readouterr()
        assert shown.out == ""
        assert shown.err.splitlines() == [f"altd {command[0]}: {path}: {line}" for line in said]


@pytest.mark.parametrize(("old", "new", "words"), NO_TOML)
def test_what_is_no_toml_is_one_line_with_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "altd.toml"
    text, place = spoilt(replaced(old, new))
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
    """One case a key: none of them hides another."""
    text = BASE
    keys: list[str] = []
    for table, line, key, words in ROWS:
        follows = (
            "; " in line or line.startswith(("«", "-")) or "already" in words or table.startswith("targets")
        )
        if not follows and key not in keys and key.count(".") == 1:
            keys.append(key)
            text = with_lines(text, table, line.replace("«", ""))
    path = tmp_path / "altd.toml"
    path.write_text(text)
    said = [line.partition(": ")[2].partition(": ")[0] for line in complaints(path)]
    assert set(keys) <= set(said)
    assert len(keys) > 12
    lines = [int(line.split()[1].rstrip(",")) for line in complaints(path) if line.startswith("line ")]
    assert all(before <= after for before, after in itertools.pairwise(lines))
