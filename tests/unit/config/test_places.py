"""Places of keys and values, against marks in texts; and none at all where the scan and tomllib disagree."""

import tomllib
from typing import Any

import pytest
from fuzz.targets.config import FULL
from hypothesis import given, settings
from hypothesis import strategies as st

from altd.config.places import Place, Places

TEXTS = {
    "a key in a table": ("[t]\nx = 1\n  «y = ‹2 # 3\n", ("t", "y")),
    "a table": ("a = 1\n[b]\n«‹[t.u]\nx = 1\n", ("t", "u")),
    "a table that only its own tables name": ("«‹[t.u]\nx = 1\n", ("t",)),
    "the second of several tables": ("[[t]]\nx = 1\n«‹[[t]]\nx = 2\n", ("t", 1)),
    "a key in it": ("[[t]]\nx = 1\n[[t]]\n«x = ‹2\n", ("t", 1, "x")),
    "a table below it": ("[[t]]\n[[t]]\n[t.u]\n«x = ‹1", ("t", 1, "u", "x")),
    "tables in tables": ("[[t]]\n[[t.u]]\n[[t.u]]\n«x = ‹1", ("t", 0, "u", 1, "x")),
    "a key with dots": ("[t]\n«a . 'b c'.\"d\" = ‹1", ("t", "a", "b c", "d")),
    "an element": ("x = [1, # ]\n  «‹2, 3]\n", ("x", 1)),
    "a list in a list": ("x = [[1], [2, «‹3]]\n", ("x", 1, 1)),
    "a table in a line": ('x = { a = "}", «b = ‹2 }\n', ("x", "b")),
    "a table in a list": ("x = [{a = 1}, {«a = ‹2}]", ("x", 1, "a")),
    "a key behind a text of many lines": ('x = """\n[t]\ny = 1\n\\""" """\n«y = ‹2', ("y",)),
    "a key behind a text that ends in quotes": ('x = """a"""""\n«y = ‹2', ("y",)),
    "a key behind one in single quotes": ("x = '''\n\\\ny = 1'''\n«y = ‹2", ("y",)),
    "a key behind a time with a blank": ("x = [1979-05-27 07:32:00]\n«y = ‹07:32:00", ("y",)),
    "lines that end as Windows ends them": ("[t]\r\n# x\r\n«x = ‹1\r\n", ("t", "x")),
    "a key with letters of two and four bytes": ('a = "ü𝄞"\nx = { "ü" = 1, «b = ‹"𝄞" }', ("x", "b")),
    "a header with blanks and quotes": ("«‹[ 'a.b' . c ]\nx = 1", ("a.b", "c")),
    "no number": ("«x = ‹nan", ("x",)),
}


@pytest.mark.parametrize(("marked", "keys"), TEXTS.values(), ids=TEXTS)
def test_it_is_where_the_mark_stands(marked: str, keys: tuple[str | int, ...]) -> None:
    def place(mark: str, other: str) -> Place:
        before = marked.replace(other, "").split(mark)[0]
        return Place(before.count("\n") + 1, len(before) - before.rfind("\n"))

    text = marked.replace("«", "").replace("‹", "")
    places = Places(text, tomllib.loads(text))
    assert places.key(keys) == place("«", "‹")
    assert places.value(keys) == place("‹", "«")


def test_a_key_that_is_not_there_has_the_place_of_its_table() -> None:
    text = "[a]\n[t.u]\nx = 1\n"
    places = Places(text, tomllib.loads(text))
    assert places.nearest(("t", "u", "y", "z")) == Place(2, 1)
    assert places.nearest(("w",)) is None
    assert places.key(("t", "u", "y")) is places.value(("t", "u", "y")) is None


@pytest.mark.parametrize(
    "document", [{"x": 2}, {"y": 1}, {}, {"x": {"y": 1}}, {"x": True}, {"x": 1.0}, {"x": "1"}]
)
def test_where_tomllib_read_it_otherwise_there_are_no_places(document: dict[str, Any]) -> None:
    assert Places("x = 1\n", {"x": 1}).value(("x",)) == Place(1, 5)
    assert Places("x = 1\n", document).value(("x",)) is None


@settings(max_examples=200)
@given(
    st.lists(st.sampled_from(FULL.decode().splitlines()), unique=True),
    st.sampled_from(("\n", "\r\n", "\n\n# [x]\n")),
)
def test_whatever_tomllib_takes_every_key_has_a_place(lines: list[str], end: str) -> None:
    text = end.join(lines)
    document = tomllib.loads(text)
    places = Places(text, document)
    for key in document:
        place = places.key((key,))
        assert place is not None
        assert text.split("\n")[place.line - 1][place.column - 1 :].startswith(key)
