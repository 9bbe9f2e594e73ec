"""Telegrams on a bad line: a valid reading is a whole telegram, and newer than the one before."""

from itertools import pairwise

from fuzz.spoil import spoilt_bytes
from hypothesis import strategies as st
from support.telegram_cases import TABLE, Variant, read_by_python, sentence, wire

NAME = "telegram"
UNIT = "ALT-0007"
_NAMES = st.sampled_from([name for name, telegram in TABLE["telegrams"].items() if "reads" in telegram])
_ORDERS = st.sampled_from(("", "", "", ":M", ":Q", ":C", ":MQ", ":QC", ":MC"))
_WHOLE = st.builds(lambda name, order: wire(name + order), _NAMES, _ORDERS)
_SPOILT = spoilt_bytes(_WHOLE)
_FRAMED = st.builds(  # corrupted, but with the checksum of the result
    lambda data: sentence(data.decode("latin-1").partition("*")[0].lstrip("$")), spoilt_bytes(_WHOLE)
)
_NOISE = st.binary(max_size=30) | st.sampled_from((b"\r\n", b"$", b"\n"))
_PIECES = st.lists(st.tuples(st.integers(0, 2500), _WHOLE | _SPOILT | _FRAMED | _NOISE), max_size=8)
EXAMPLES = st.builds(
    lambda pieces, unit: Variant(NAME, unit, _at_their_times(pieces), [], {}, valid_only=True),
    _PIECES,
    st.sampled_from((UNIT, UNIT, None)),
)


def _at_their_times(pieces: list[tuple[int, bytes]]) -> list[tuple[int, bytes | None]]:
    now_ms, fed = 0, list[tuple[int, bytes | None]]()
    for after_ms, data in pieces:
        now_ms += after_ms
        fed.append((now_ms, data))
    return fed


def check(example: Variant) -> None:
    """Valid is only what was sent whole, in the order of the unit; pieces of any size give the same."""
    result = read_by_python(example, 1000)
    assert result == read_by_python(example, 3)
    received = b"".join(data or b"" for _, data in example.fed)
    valid = [reading for reading in result.readings if reading["valid"]]
    if example.unit is None:
        return
    for reading in valid:
        assert any(
            wire(name) in received and telegram.get("reads", {}).items() <= reading.items()
            for name, telegram in TABLE["telegrams"].items()
        )
        assert reading["age_ms"] <= 1000
    for before, after in pairwise(valid):
        assert after["session"] == before["session"]
        assert 0 < (after["message"] - before["message"]) % 0xFFFFFFFF < 2**31
