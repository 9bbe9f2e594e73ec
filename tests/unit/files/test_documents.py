from __future__ import annotations

import contextlib
import re
import time

import pytest

from altd.files.documents import parse_json, parse_toml


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x = " + b"9" * 5000, "not TOML: a number with too many digits"),
        (b"x = " + b"[" * 5000, "is nested too deeply"),
        (b"x = " + b"{a=" * 5000, "is nested too deeply"),
        (b"x = 0x" + b"f" * 20_000, "has more than 64 bits"),
        (b'a.b = [{c = "x\\u0000y"}]', "has a NUL"),
        (b"a = 1\na = 2", "not TOML: this key is defined twice"),
        (b"x = 1\r\ny = \r\n", "not TOML: no value"),
        (b"\xef\xbb\xbfx = 1", "begins with a byte order mark: save the file as UTF-8"),
        (b"x = \xff", "is not UTF-8 text"),
        (b"x = \0", "not TOML: no value"),
        (b"# " + b"." * 99 + b"\n" + b"a." * 65 + b"a = 1", "more than 64 dots in a line"),
        (b'x = """', "not TOML: "),
    ],
)
def test_toml_that_is_none_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_toml(content)


def test_toml_is_read() -> None:
    assert parse_toml(b"# " + b"." * 500 + b"\nx.y = [1, 0.5]\r\n") == {"x": {"y": [1, 0.5]}}


def test_no_toml_of_a_config_s_size_takes_long() -> None:
    """A key of 30,000 parts takes tomllib 9 s."""
    line = b".".join([b"a"] * 60)
    tables = b"\n".join(b"[%s.b%d]\n%s = 1" % (line, n, line) for n in range(250))
    for content in (b".".join([b"a"] * 30_000) + b" = 1", tables, b"\n" * 60_000 + b"x = 1", b" " * 60_000):
        began = time.process_time()
        with contextlib.suppress(ValueError):
            parse_toml(content)
        assert time.process_time() - began < 5  # computing time, which a busy computer does not add to


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"a": 1, "b": 2, "a": 1}', "is not JSON: the key 'a' occurs twice in one object"),
        (b"[" * 100_000, "is nested too deeply"),
        (b'{"a":' * 100_000, "is nested too deeply"),
        (b"[" + b"9" * 5000 + b"]", "has 5000 digits"),
        (b"[-" + b"9" * 40 + b"]", "has 41 digits"),
        (b'{"a": 1', "is not JSON: Expecting"),
        (b'["\xff"]', "is not JSON: 'utf-8' codec"),
        (b"", "is not JSON: Expecting value"),
    ],
)
def test_json_that_is_none_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_json(content)


def test_json_is_read() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": [1, 0.5, {"b": null}]}') == {"a": [1, 0.5, {"b": None}]}
