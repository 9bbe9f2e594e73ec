"""Keys become lines, whatever the terminal sends."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from altd.publish.serial.keys import Key, KeyReader
from altd.publish.serial.lines import MAX_LINE_CHARACTERS, MAX_RECALLED_LINES, BadLine, LineEditor

UP, DOWN, RIGHT, LEFT = (b"\x1b[" + final for final in (b"A", b"B", b"C", b"D"))


def typed(data: bytes) -> tuple[bytes, list[str | BadLine]]:
    """The echo and the lines that result from some keys."""
    reader, editor = KeyReader(), LineEditor()
    taken = [editor.take(key) for byte in data for key in reader.take(byte)]
    echo = b"".join(piece for piece in taken if isinstance(piece, bytes))
    return echo, [piece for piece in taken if not isinstance(piece, bytes)]


def screen(data: bytes) -> tuple[str, int]:
    """The line on a terminal that knows only backspace after some keys, and the place of its cursor."""
    cells: list[str] = []
    at = 0
    for shown in typed(data)[0].decode("ascii"):
        if shown == "\b":
            at -= 1
            assert at >= 0
        else:
            cells[at : at + 1] = [shown]
            at += 1
    return "".join(cells).rstrip(), at


@pytest.mark.parametrize(
    ("keys", "echo", "lines"),
    [
        (b"help\r", b"help", ["help"]),
        (b"help\n", b"help", ["help"]),
        (b"help\r\nstatus\r\n", b"helpstatus", ["help", "status"]),
        (b"help\r\0status\r\0", b"helpstatus", ["help", "status"]),  # Enter as telnet sends it
        (b"\r\r\n\n", b"", ["", "", ""]),
        (b"hx\x7felp\r", b"hx\b \belp", ["help"]),
        (b"\x08\x08a\x08\x08\r", b"a\b \b", [""]),
        (b"stat\x15help\r", b"stat" + b"\b \b" * 4 + b"help", ["help"]),
        (b"stat\x03help\r", b"stat" + b"\b \b" * 4 + b"help", ["help"]),
        (b"\x1b[" + b"1" * 40 + b"\rhelp\r", b"help", ["", "help"]),
        (
            b"a" * (MAX_LINE_CHARACTERS + 5) + b"\rhelp\r",
            b"a" * MAX_LINE_CHARACTERS + b"help",
            [BadLine.TOO_LONG, "help"],
        ),
        (b"\xff\xfe\x80\xe6\x80\rhelp\r", b"help", [BadLine.NO_TEXT, "help"]),
        (b"\xff\x15help\r", b"help", ["help"]),
        ("hölp\r".encode(), b"h?lp", ["hölp"]),
        ("hö\x7felp\r".encode(), b"h?\b \belp", ["help"]),
        ("hölp\rhelp\r".encode("latin-1"), b"hlphelp", [BadLine.STRAY, "help"]),
        ("ö\r".encode("latin-1"), b"", [BadLine.STRAY]),
        ("größe 5 µm\r".encode("latin-1"), b"gre 5 m", [BadLine.STRAY]),
    ],
)
def test_keys_become_lines(keys: bytes, echo: bytes, lines: list[str | BadLine]) -> None:
    assert typed(keys) == (echo, lines)


@pytest.mark.parametrize(
    ("keys", "line", "cursor"),
    [
        (b"staus" + LEFT + LEFT + b"t", "status", 4),
        (b"tatus\x1b[Hs", "status", 1),
        (b"tatus\x01s\x05!", "status!", 7),
        (b"statusx\x1b[D\x1b[3~", "status", 6),
        (b"xstatus\x1b[1~\x1b[3~\x1b[4~", "status", 6),
        (b"watch 10\x17" + b"5", "watch 5", 7),
        (b"watch  10  \x17", "watch", 7),
        (b"watch 10\x1b\x7f2", "watch 2", 7),
        (b"watch 10" + LEFT * 2 + b"\x15", "10", 0),
        (b"watch 10" + LEFT * 3 + b"\x0b", "watch", 5),
        (b"watch 10" + LEFT * 3 + b"\x7f\x7fX", "watX 10", 4),
        (b"abc" + LEFT * 9 + RIGHT * 9 + b"d", "abcd", 4),
        (b"abc\x02\x02\x06d\x04", "abd", 3),
        (b"help" + UP + DOWN + b"!", "help!", 5),
    ],
)
def test_a_line_is_edited_where_the_cursor_stands(keys: bytes, line: str, cursor: int) -> None:
    assert screen(keys) == (line, cursor)
    (read,) = typed(keys + b"\r")[1]
    assert isinstance(read, str)
    assert read.rstrip() == line


def test_earlier_lines_come_back_and_can_be_edited() -> None:
    typed_before = b"status\rmeasure\rmeasure\r \r"
    assert typed(typed_before + UP + b"\r")[1][-1] == "measure"
    assert typed(typed_before + UP + UP + b"\r")[1][-1] == "status"
    assert typed(typed_before + UP * 9 + DOWN + b"\r")[1][-1] == "measure"
    assert typed(typed_before + b"wat" + UP * 2 + DOWN * 9 + b"ch\r")[1][-1] == "watch"
    assert typed(typed_before + b"\x10 x\r" + UP + b"\x15\r")[1][-2:] == ["measure x", ""]
    assert typed(b"".join(b"%d\r" % n for n in range(99)) + UP * 99 + b"\r")[1][-1] == str(
        99 - MAX_RECALLED_LINES
    )


SENT = {
    "xterm": (
        b"\x1b[A",
        b"\x1b[1;5C",
        b"\x1bOP",
        b"\x1b[15~",
        b"\x1b[24~",
        b"\x1b[2~",
        b"\x1b[5;2~",
        b"\x1b[Z",
    ),
    "VT100": (b"\x1bOA", b"\x1bOD", b"\x1bOP", b"\x1bOM", b"\x1bOp", b"\x1bOl"),
    "VT220 in 8 bits": (b"\x9bA", b"\x9b3~", b"\x8fP"),
    "PuTTY": (b"\x1b[1~", b"\x1b[4~", b"\x1b[11~", b"\x1b\x1b[A", b"\x1bOA", b"\x1b[G"),
    "minicom": (b"\x1b[H", b"\x1b[F", b"\x1bOS", b"\x1b[6~", b"\x7f"),
    "Linux console": (b"\x1b[[A", b"\x1b[[E", b"\x1b[17~", b"\x1b[1~"),
    "screen and rxvt": (b"\x1b[7~", b"\x1b[8~", b"\x1bOa", b"\x1b[a", b"\x1b[11^"),
    "what terminals report": (
        *(b"\x1b[?62;22c", b"\x1b[24;80R", b"\x1b[I", b"\x1b[O", b"\x1b[0n", b"\x1b[<0;10;12M", b"\x1b[M !!"),
        *(
            b"\x1b]11;rgb:0/0/0\x1b\\",
            b"\x1b]0;measure\x07",
            b"\x1bP1$r0m\x1b\\",
            b"\x1b_help\x1b\\",
        ),
    ),
    "telnet": (b"\xff\xfb\x01", b"\xff\xfd\x1f", b"\xff\xf1", b"\xff\xfa\x18\x00xterm\xff\xf0"),
    "control keys": tuple(bytes([code]) for code in b"\0\7\t\f\x0f\x11\x12\x13\x14\x16\x18\x19\x1a\x1c\x1f"),
    "Alt": (b"\x1bh", b"\x1bx", b"\x1b(B"),
    "kitty": (b"\x1b[27u", b"\x1b[57442;5u"),
}


@pytest.mark.parametrize(("terminal", "sent"), [(name, key) for name, keys in SENT.items() for key in keys])
def test_a_key_is_no_text_and_no_error_however_it_is_split(terminal: str, sent: bytes) -> None:
    for parts in ([sent], [bytes([byte]) for byte in sent]):
        reader = KeyReader()
        keys = [key for part in parts for byte in part for key in reader.take(byte)]
        assert len(keys) <= 1, terminal
        assert all(isinstance(key, Key) and key not in (Key.JUNK, Key.ENTER) for key in keys)
        assert reader.waiting_s is None
        assert [*reader.take(ord("x"))] == ["x"]


def test_keys_mean_the_same_on_every_terminal() -> None:
    for key, ways in {
        Key.UP: (b"\x1b[A", b"\x1bOA", b"\x9bA", b"\x10", b"\x1b[1A"),
        Key.LEFT: (b"\x1b[D", b"\x1bOD", b"\x02"),
        Key.HOME: (b"\x1b[H", b"\x1bOH", b"\x1b[1~", b"\x1b[7~", b"\x01"),
        Key.END: (b"\x1b[F", b"\x1bOF", b"\x1b[4~", b"\x1b[8~", b"\x05"),
        Key.DELETE: (b"\x1b[3~", b"\x04", b"\x9b3~"),
        Key.BACKSPACE: (b"\x7f", b"\x08"),
        Key.ERASE_WORD: (b"\x17", b"\x1b\x7f", b"\x1b\x08"),
        Key.OTHER: (b"\x1b[1;5D", b"\x1b[5~", b"\x1bOP", b"\x1bx"),
    }.items():
        for way in ways:
            reader = KeyReader()
            assert [key for byte in way for key in reader.take(byte)] == [key], way


def test_an_escape_alone_is_a_key_once_nothing_follows() -> None:
    reader = KeyReader()
    assert [*reader.take(0x1B)] == []
    assert reader.waiting_s is not None
    assert reader.waiting_s < 0.2
    assert [*reader.rest()] == [Key.OTHER]
    assert [*reader.take(ord("["))] == ["["]


@pytest.mark.parametrize(
    "begun",
    [
        *(b"\x1b[", b"\x1b[1;", b"\x1bO", b"\x1b]0;title", b"\x1b[M ", b"\x1b(", b"\x1b."),
        *(b"\xff", b"\xff\xfb", b"\xc3"),
    ],
)
def test_what_was_begun_is_given_up_after_a_while_and_is_no_text(begun: bytes) -> None:
    reader = KeyReader()
    keys = [key for byte in begun for key in reader.take(byte)]
    assert reader.waiting_s is not None
    keys += reader.rest()
    assert all(isinstance(key, Key) for key in keys)
    assert reader.waiting_s is None
    assert [key for byte in b"help" for key in reader.take(byte)] == [*"help"]


@pytest.mark.parametrize("begun", [b"\x1b[1;", b"\x1b]0;title", b"\xff\xfa\x18", b"\x1bP", b"\x1bO", b"\x1b"])
def test_enter_ends_what_was_begun(begun: bytes) -> None:
    assert typed(begun + b"\rhelp\r")[1] == ["", "help"]


def test_a_paste_in_brackets_is_text_of_one_line_and_waits_for_enter() -> None:
    echo, lines = typed(b"\x1b[200~measure\r\nhelp\tall\x03\x15\x1b[A\n\x1b[201~")
    assert (echo, lines) == (b"measure  help all ", [])
    assert typed(b"\x1b[200~measure\n\x1b[201~\r")[1] == ["measure "]


def test_a_paste_whose_end_is_lost_ends_with_silence() -> None:
    reader = KeyReader()
    assert [key for byte in b"\x1b[200~a\r" for key in reader.take(byte)] == ["a", " "]
    assert reader.waiting_s is not None
    assert [*reader.rest()] == []
    assert [*reader.take(ord("\r"))] == [Key.ENTER]


def test_a_sequence_that_never_ends_keeps_nothing() -> None:
    reader = KeyReader()
    for begin in (b"\x1b[", b"\x1b]", b"\xff\xfa", b"\x1b[200~\x1b[", b"\x1bP"):
        for byte in begin + b"1;" * 5_000:
            assert not isinstance(next(reader.take(byte), None), Key)
        kept = [value for value in vars(reader).values() if isinstance(value, str)]
        assert max(map(len, kept)) < 32
        [*reader.rest()]


_KEYS = [UP, DOWN, LEFT, RIGHT, "ü".encode(), *(bytes([code]) for code in b"ab c\1\5\x7f\4\x17\x15\x0b\3")]


@given(st.lists(st.sampled_from(_KEYS), max_size=60))
def test_what_the_screen_shows_is_the_line(keys: list[bytes]) -> None:
    shown, _ = screen(b"".join(keys))
    (line,) = typed(b"".join(keys) + b"\r")[1]
    assert isinstance(line, str)
    assert shown == line.replace("ü", "?").rstrip()
