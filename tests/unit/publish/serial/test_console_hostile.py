"""20,000 hostile sessions on one console: plain text comes back, and the next person is answered."""

import random
import re

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.serial.commands import COMMANDS
from altd.publish.serial.console import Console
from tools.pages.serial_examples import MEASURED

from .conftest import well

SESSIONS = 20_000
_STRANGE = tuple(
    word.decode("ascii").encode("ascii").decode("unicode_escape").encode("latin-1")
    for word in rb"""
\x1b[A \x1bOP \x1b[200~ \x1b[201~ \x1b]0;x\x07 \xff\xfb\x01 \xff\xfa\x18 \x03 \x15 \x7f\x7f \x00 \xe4 \xc3\xa4
\x8d
\x80\xfe %s%n ';-- ../.. \xf0\x9f\x92\xa5 \x1b \x1b[ \n \r \x20 y 1e400 nan -1 all now
""".split()
)
_OBEYED = re.compile(rb"[^\x20-\x7e\r\n\x08]")


def test_nothing_typed_gets_more_than_plain_text_out_of_it() -> None:
    chance = random.Random(488)
    unit, asked = well(), 0

    def ask(who: str) -> None:
        nonlocal asked
        asked += 1

    unit.self_check.open(ask)
    typed = Console(lambda: MEASURED, unit, QUANTITIES)
    names = [name.encode() for name in COMMANDS]
    for _ in range(SESSIONS):
        words = chance.choices(names, k=1) + chance.choices(_STRANGE, k=chance.randrange(4))
        keys = bytearray(b" ".join(words) + b"\r" * chance.randrange(2))
        for _ in range(chance.randrange(3)):
            keys[chance.randrange(len(keys))] = chance.randrange(256)
        shown = typed.feed(bytes(keys))
        if chance.random() < 0.1:
            shown += typed.rest() + typed.tick() + typed.drop_question()
        assert not _OBEYED.search(shown), (bytes(keys), shown)
        assert all(
            len(line.rpartition(b"\r")[2]) < 80 + 12 * line.count(b"\b") for line in shown.split(b"\r\n")
        )
    typed.rest()
    typed.feed(b"\x03q\x15\r\x15\r")
    assert typed.feed(b"version\r") == b"version\r\naltd 0.1.0, unit ALT-0007\r\n> "
    assert asked < SESSIONS / 100, "a check takes a whole `selfcheck now` and a `y`"
