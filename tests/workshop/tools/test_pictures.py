"""The film of a terminal: its text, where, how it looks, and when."""

from __future__ import annotations

import re
from xml.etree import ElementTree

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
