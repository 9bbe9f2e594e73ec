"""``make bench-load`` reads every interface and prints what came. How fast anything is belongs to no test."""

from support.cli import altd
from support.foreign import need_program

from benchmarks.load import CLIENTS


def test_each_interface_is_read_and_the_ages_of_its_messages_are_plausible() -> None:
    need_program("mosquitto")
    done = altd("--seconds", 2, module="benchmarks.load", timeout_s=470)
    assert (done.status, done.err) == (0, "")
    _, heads, *rows = (line.split() for line in done.out.splitlines())
    assert heads == ["clients", "s", "pairs", "lost", "core", "more", "MB", "stolen", "s"]
    assert [row[0] for row in rows[: len(CLIENTS) + 2]] == ["none", *CLIENTS, "all"]
    (pictures,) = (place for place, row in enumerate(rows) if row[0] == "pictures")
    for count, kind, answers, *figures in rows[len(CLIENTS) + 3 : pictures]:
        assert (int(count), bool(int(answers))) == (CLIENTS[kind], kind.startswith("modbus"))
        messages, behind_p50, _, _, age_p50, _, _ = map(float, figures[-7:])
        assert messages > 10
        assert -1.5 < behind_p50 < 1000, "a clock or an age is wrong"
        assert 400 < age_p50 < 1500, "a mean of one second is half a second old"
    assert int(rows[pictures][1]) > 10
