"""The film of a terminal: its text, where, how it looks, and when; which pictures are written."""

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from altd.errors import BadInputError
from tools.pictures import __main__ as pictures
from tools.pictures.animation import Still, animated_svg
from tools.pictures.terminal import Run, parse_screen

SVG = "{http://www.w3.org/2000/svg}"


def test_a_screen_is_read_with_its_looks() -> None:
    shown = "\x1b[1mx  mm\x1b[0m   1.5\n\n  \x1b[1m\x1b[32mVALID\x1b[39m now\x1b[0m\n"
    first, empty, last, _ = parse_screen(shown)
    bold, plain = frozenset({"1"}), frozenset[str]()
    assert first == (Run(0, "x  mm", bold), Run(8, "1.5", plain))
    assert empty == ()
    assert [(run.column, run.text) for run in last] == [(2, "VALID"), (8, "now")]
    assert "32" in last[0].style
    assert "32" not in last[1].style


def test_looks_go_on_over_the_end_of_a_line() -> None:
    assert parse_screen("\x1b[2mone\ntwo\x1b[0m three")[1] == (
        Run(0, "two", frozenset({"2"})),
        Run(4, "three", frozenset()),
    )


def test_each_line_is_seen_while_it_stood_there() -> None:
    """4 s in all: the first line stays, the second changes after one second, and is empty for the last."""
    stills = [
        Still(parse_screen("head\n<a>"), 1.0),
        Still(parse_screen("head\nb & c"), 2.0),
        Still(parse_screen("head\n"), 1.0),
    ]
    root = ElementTree.fromstring(animated_svg(stills, columns=10, rows=2, title="A film"))
    assert root.findtext(f"{SVG}title") == "A film"
    style = root.findtext(f"{SVG}style") or ""
    assert "animation:4.00s step-end infinite" in style
    groups = {
        "".join(text.text or "" for text in group): group.get("style") for group in root.iter(f"{SVG}g")
    }
    assert groups["head"] is None
    steps = {
        text: re.search(rf"@keyframes {(name or '').removeprefix('animation-name:')}{{(.*)}}", style)
        for text, name in groups.items()
        if name
    }
    assert {text: match and match[1] for text, match in steps.items()} == {
        "<a>": "0.00%{visibility:visible}25.00%{visibility:hidden}",
        "b & c": "0%{visibility:hidden}25.00%{visibility:visible}75.00%{visibility:hidden}",
    }


def film(*seconds: str) -> bytes:
    stills = [Still(parse_screen(f"head\n{second}"), 1.0) for second in seconds]
    return animated_svg(stills, columns=20, rows=2, title="A film").encode()


def png(value: int, words: slice = slice(0)) -> bytes:
    """A grey picture with noise, a hundredth of it other numbers, and black words."""
    pixels = np.random.default_rng(value).integers(100, 120, (100, 100, 3)).astype(np.uint8)
    pixels[50, :] = value
    pixels[words] = 0
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize(
    ("file", "before", "after", "is_written"),
    [
        ("a.svg", film("x -1.5", "x 1", "not valid"), film("x 12.25", "x 12.5", "not valid"), False),
        ("a.svg", film("x -1.5", "not valid"), film("x -1.5", "no value"), True),
        ("a.png", png(10), png(200), False),
        ("a.png", png(10), png(200, words=slice(10, 12)), True),
    ],
)
def test_a_picture_is_written_when_it_shows_more_than_other_numbers_or_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, before: bytes, after: bytes, is_written: bool
) -> None:
    def take(folder: Path) -> None:
        (folder / file).write_bytes(after)

    taken: dict[tuple[str, ...], tuple[Callable[[Path], None], float]] = {(file,): (take, 0.02)}
    monkeypatch.setattr(pictures, "_TAKEN", taken)
    for names, expected in (([], after if is_written else before), (["a"], after)):
        (tmp_path / file).write_bytes(before)
        assert pictures.main(names, tmp_path) == 0
        assert (tmp_path / file).read_bytes() == expected
    taken[(file,)] = (take, 1.0)
    (tmp_path / file).write_bytes(before)
    assert pictures.main([], tmp_path) == 0
    assert (tmp_path / file).read_bytes() == before
    with pytest.raises(BadInputError, match="unknown picture 'b'; known are a"):
        pictures.main(["b"], tmp_path)
