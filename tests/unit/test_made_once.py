"""Parts that are kept between runs: never those of other sources, never changed or half made ones."""

import fcntl
import importlib.util
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from support import made_once as module
from support.made_once import digest, loaded_once, made_once


@pytest.fixture(autouse=True)
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    base = tmp_path / "digest"
    base.mkdir()
    monkeypatch.setattr(module, "_base", lambda: base)
    monkeypatch.setattr(module, "_whole", set())  # as in another process
    # sources may be edited while this runs
    monkeypatch.setattr(module, "digest", lambda: module.AT_START)
    monkeypatch.setattr(module, "_STARTED_S", math.inf)
    return base


def make(counted: list[int], folder: Path) -> None:
    counted.append(1)
    (folder / "made").write_text("whole")


def test_whoever_asks_at_once_gets_the_one_that_was_made() -> None:
    counted: list[int] = []
    with ThreadPoolExecutor(8) as pool:
        asked = [pool.submit(made_once, "part", partial(make, counted)) for _ in range(8)]
    folders = {one.result() for one in asked}
    assert len(folders) == len(counted) == 1
    assert (folders.pop() / "made").read_text() == "whole"


def test_what_a_function_returns_comes_back_equal() -> None:
    counted: list[int] = []

    def numbers() -> list[float]:
        counted.append(1)
        return [0.1, -0.0]

    assert [loaded_once("numbers", numbers) for _ in range(2)] == [[0.1, -0.0]] * 2
    assert len(counted) == 1


def test_one_that_was_not_made_to_its_end_is_made_again(base: Path) -> None:
    counted: list[int] = []

    def interrupted(folder: Path) -> None:
        make(counted, folder)
        if len(counted) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made_once("part", interrupted)
    assert not [path for path in base.iterdir() if path.is_dir()]
    assert list(made_once("part", interrupted).iterdir())
    assert len(counted) == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "made").write_text("whol"),
        lambda folder: (folder / "made").write_text("whole".upper()),
        lambda folder: (folder / "made").unlink(),
        lambda folder: (folder / "more").touch(),
        lambda folder: folder.parent.joinpath("part.made").write_text("["),
    ],
    ids=["cut off", "changed", "removed", "added", "mark cut off"],
)
def test_one_that_was_changed_is_made_again(
    base: Path, change: Callable[[Path], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[int] = []
    first = made_once("part", partial(make, counted))
    (mark,) = base.glob("*.made")
    mark.rename(base / "part.made")
    change(first)
    (base / "part.made").rename(mark)
    monkeypatch.setattr(module, "_whole", set())
    again = made_once("part", partial(make, counted))
    assert again != first
    assert (again / "made").read_text() == "whole"
    assert len(counted) == 2


def test_another_file_that_asks_or_other_data_make_another_one(tmp_path: Path) -> None:
    source, data, found = tmp_path / "asks.py", tmp_path / "data", set[Path]()
    for text, content in (("", "1"), ("", "1"), ("# changed\n", "1"), ("# changed\n", "2")):
        source.write_text(f"def make(folder):\n    (folder / 'made').touch()\n{text}")
        data.write_text(content)
        spec = importlib.util.spec_from_file_location("asks", source)
        assert spec is not None
        assert spec.loader is not None
        asks = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(asks)
        found.add(made_once("part", asks.make, data))
    assert len(found) == 3


@pytest.mark.parametrize(("name", "value"), [("digest", lambda: "another"), ("_STARTED_S", 0.0)])
def test_one_that_was_made_while_its_source_was_edited_is_not_kept(
    base: Path, name: str, value: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[int] = []
    monkeypatch.setattr(module, name, value)
    made = {made_once("part", partial(make, counted)) for _ in range(2)}
    assert len(made) == len(counted) == 2
    assert not list(base.glob("*.made"))


def test_the_folder_is_that_of_every_source_and_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel, library = tmp_path / "altd" / "libkernel.so", tmp_path / "site" / "numpy-1.dist-info"
    (tmp_path / "altd" / "__pycache__").mkdir(parents=True)
    library.mkdir(parents=True)
    monkeypatch.setattr(module, "_TREES", (tmp_path / "altd",))
    monkeypatch.setattr("sys.path", [str(library.parent)])
    found = [digest()]
    (tmp_path / "altd" / "__pycache__" / "made.pyc").touch()
    assert digest() == found[0]
    for change in (
        kernel.touch,
        partial(kernel.write_text, "compiled"),
        partial(kernel.rename, kernel.with_name("kernel.so")),
        partial(library.rename, library.with_name("numpy-2.dist-info")),
        partial(monkeypatch.setattr, "sys.version", "another"),
    ):
        change()
        found.append(digest())
    assert len(set(found)) == len(found)


def test_what_was_not_used_lately_and_is_not_in_use_is_removed(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    for number in range(6):
        (cache / f"{number}" / "part").mkdir(parents=True)
        (cache / f"{number}.used").touch()
        os.utime(cache / f"{number}.used", (number, number))
    with (cache / "1.used").open() as used:
        fcntl.flock(used, fcntl.LOCK_SH)
        module.remove_old(cache)
    assert sorted(path.name for path in cache.iterdir() if path.is_dir()) == ["1", "3", "4", "5"]
