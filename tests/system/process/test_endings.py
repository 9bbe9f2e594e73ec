"""Every command, ended in each way it can end: standard error, temporary folders and exit status.

``lamps on`` is ended on a real chip in ``test_lamps.py``, ``altd scan`` killed in ``test_scan.py``, the
simulator's cameras in ``hw_sim/gige/test_command.py``, a demo that calibrates itself in
``hw_sim/test_demo.py``, a daemon on live cameras in ``test_live.py``.
"""

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.foreign import need_namespaces, need_program
from support.history import START_S, batch, event, store, write_seconds
from support.played_unit import BEAMS, PlayedUnit
from support.recordings import write_beams, write_scan
from support.warm import Warm

from altd.app.public_archive import CONSENT

from .ended_commands import COMMANDS, ENVIRONMENT, HW_SIM, SIGNALS, Command, filled, run

WITH_EVERY_SIGNAL = ("run", "replay")
"""One on a loop, one without. All commands share the two ways to take a signal, which
``tests/unit/process/test_endings.py`` tests with each of them: each other command gets the next one.
"""

DONE = {
    "calibrate": (0, "", {"cal.json"}),
    "calibrate's report": (0, "", {"cal.json", "rep"}),
    "replay": (0, "", set()),
    "replay's lines": (0, "", {"t.jsonl"}),
    "replay's csv": (
        0,
        r"altd replay: \d+ of \d+ measurements valid; against the known positions: rms x .* mm\n",
        {"t.csv"},
    ),
    "replay's parquet": (0, "", {"t.parquet"}),
    "replay's plot": (0, "", {"t.csv", "p.svg"}),
    "record --config {config} -o kept --seconds 0.4": (0, r"\d+ exposures? in kept\n", {"kept"}),
    "lamps": (1, r"altd lamps: .*\n", set()),
    "locate": (0, "", set()),
    "locate {beams}/front0000.png none.png": (2, "altd locate: none.png: No such file or directory\n", set()),
    "map": (0, "", set()),
    "axis": (0, "", set()),
    "selfcheck": (1, "", set()),
    "verify": (1, "", set()),
    "verify's page": (1, "", {"page"}),
    "selfcheck's daemon": (
        1,
        r"altd selfcheck: no daemon answers at 127\.0\.0\.1 port \d+: Connection refused\n",
        set(),
    ),
    "status": (
        1,
        r"altd status: there is no socket none.sock: the daemon is not running "
        r"\(start: `sudo systemctl start altd`\), or has no \[local\]\n",
        set(),
    ),
    "export": (0, "", {"t.csv"}),
    "export's parquet": (0, "", {"t.parquet"}),
    "export on standard output": (0, "", set()),
    "events": (0, "", set()),
    "backup": (0, "", {"b.tar.gz"}),
    "restore": (0, "", {"altd.toml", "cal.json"}),
    "diagnose": (
        0,
        "altd diagnose: .*: only its files are in the archive\n(altd diagnose: .+\n)+",
        {"d.zip"},
    ),
    "diagnose for an issue": (0, "This archive .*\n(.+\n)+", {"p.zip"}),
    "check-config": (0, "", set()),
    "devices": (0, "", set()),
    "registers": (0, "", set()),
    "refraction": (0, "", set()),
    "doctor": (0, "", set()),
    "fleet": (2, "altd fleet: database.connection: .*\n", set()),
    "hw_sim flat": (0, "", {"kept"}),
    "hw_sim plate": (0, "", {"kept"}),
    "hw_sim planar-recording": (0, "", {"kept"}),
    "hw_sim measure": (0, "", {"kept", "truth.json"}),
}
"""The ends of commands without a signal: status, standard error, contents of the working folder."""

COLD = {COMMANDS.get(name, Command(name, "")).line.split()[0]: name for name in reversed(DONE)}.values()
"""Of each command one, which is run by an interpreter of its own: it imports what it needs."""

FULL_DISK = {
    "calibrate": (16, "cal.json"),
    "calibrate's report": (900, "rep"),
    "replay's lines": (4, "t.jsonl"),
    "replay's csv": (4, "t.csv"),
    "replay's parquet": (4, "t.parquet"),
    "replay's plot": (16, "p.svg"),
    "verify's page": (16, "page"),
    "export": (4, "t.csv"),
    "export's parquet": (4, "t.parquet"),
    "backup": (4, "b.tar.gz"),
    "diagnose for an issue": (4, "p.zip"),
    "restore": (4, "unit.tar.gz"),
    "hw_sim scan": (1000, "kept"),
    "hw_sim flat": (1000, "kept"),
    "hw_sim plate": (1000, "kept"),
    "hw_sim planar-recording": (300, "kept"),
    "hw_sim measure": (1000, "kept"),
}
"""Room on the disk, kB, and what does not find any there."""


@pytest.fixture(scope="module")
def small_scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of as few nodes as a calibration takes: it is made a dozen times here."""
    return write_scan(tmp_path_factory.mktemp("small") / "scan", columns=4, rows=4)


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in which every other frame is said to have the frame LEDs on."""
    folder = write_beams(tmp_path_factory.mktemp("check") / "rec", BEAMS)
    table = folder / "frames.csv"
    head, *rows = table.read_text().splitlines()
    lit = [row.replace(",off,", ",on,") if int(row.split(",")[0]) % 2 else row for row in rows]
    table.write_text("\n".join([head, *lit]) + "\n")
    return folder


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of measurements, and more events than fit into a pipe."""
    folder = tmp_path_factory.mktemp("history")
    writing = store(folder)
    write_seconds(writing, START_S, [10.0] * 60)
    writing.write(batch(START_S + 70, [], [event(number, START_S, text="x" * 200) for number in range(1000)]))
    writing.end(None)
    return folder / "history.db"


@pytest.fixture(scope="module")
def warm() -> Iterator[Warm]:
    with Warm(ENVIRONMENT) as warm:
        yield warm


@pytest.fixture(scope="module")
def warm_with_disks() -> Iterator[Warm]:
    """In a mount namespace of its own."""
    with Warm(ENVIRONMENT, need_namespaces("--mount")) as warm:
        yield warm


@pytest.fixture
def folder(tmp_path: Path, small_scan: Path, check: Path, unit_3: Path, history: Path) -> Path:
    """A working folder; recordings, a simulated unit's calibration and temporary files lie beside it."""
    (tmp_path / "cal-3.json").symlink_to(unit_3 / "cal.json")
    (tmp_path / "scan").symlink_to(small_scan)
    (tmp_path / "check").symlink_to(check)
    shutil.copy(history, tmp_path / "history.db")
    for name in ("work", "temporary"):
        (tmp_path / name).mkdir()
    return tmp_path / "work"


@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param(name, number, id=f"{name}-{number.name}")
        for place, name in enumerate(COMMANDS)
        for number in (SIGNALS if name in WITH_EVERY_SIGNAL else [SIGNALS[place % len(SIGNALS)]])
    ],
)
def test_ended_by_a_signal(
    name: str, number: signal.Signals, played_unit: PlayedUnit, folder: Path, warm: Warm
) -> None:
    if name == "run" and number is signal.SIGHUP:
        pytest.skip("ends it only where it has a terminal: tests/system/app/test_reload.py")
    command = COMMANDS[name]
    line = filled(command.line, played_unit, folder)
    program = ["support.signalled", number.name, *command.at.split(), command.module, *line]
    cold = name == "run" or (name, number) == ("replay", signal.SIGINT)
    ended = run(folder, program, warm, cold=cold)
    assert ended.status == (128 + number if command.ends_with is None else command.ends_with), ended
    assert re.fullmatch(command.says, ended.err), ended.err
    assert ended.left == command.leaves
    assert ended.temporary == frozenset()


@pytest.mark.parametrize("name", DONE)
def test_ended_by_itself(name: str, played_unit: PlayedUnit, folder: Path, warm: Warm) -> None:
    status, says, leaves = DONE[name]
    command = COMMANDS.get(name, Command(name, ""))
    line = filled(command.line, played_unit, folder)
    ended = run(folder, [command.module, *line], warm, cold=name in COLD)
    may = (status, 1) if name == "doctor" else (status,)  # of a computer that lacks something
    assert ended.status in may, ended
    assert re.fullmatch(says, ended.err), ended.err
    assert (ended.left, ended.temporary) == (leaves, frozenset())


PRINT_ROW_BY_ROW = (
    *("replay", "replay's csv on standard output", "locate's table", "map's table"),
    *("export on standard output", "events", "axis"),
)
PRINT_AT_THE_END = (
    *("calibrate", "locate", "map", "selfcheck", "verify", "check-config", "registers", "devices", "doctor"),
    "refraction",
)
"""Here a reader that has gone is noticed by what all commands share: one of these is enough."""


@pytest.mark.parametrize(
    ("name", "is_full"),
    [
        *((name, True) for name in (*PRINT_ROW_BY_ROW, *PRINT_AT_THE_END)),
        *((name, False) for name in (*PRINT_ROW_BY_ROW, "registers")),
    ],
)
def test_ended_by_who_reads(
    name: str, is_full: bool, played_unit: PlayedUnit, folder: Path, warm: Warm
) -> None:
    if is_full:
        output = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, output = os.pipe()
        os.close(reader)
    line = filled(COMMANDS[name].line, played_unit, folder)
    ended = run(folder, ["altd.cli", *line], warm, cold=name == "replay", output=output)
    os.close(output)
    command = COMMANDS[name].line.split()[0]
    complaint = f"altd {command}: standard output: No space left on device\n" if is_full else ""
    assert (ended.status, ended.err) == (1, complaint)
    assert ended.left <= {"cal.json"}
    assert ended.temporary == frozenset()


@pytest.mark.parametrize("name", FULL_DISK)
def test_ended_by_a_full_disk(
    name: str, played_unit: PlayedUnit, folder: Path, warm_with_disks: Warm
) -> None:
    """A real one, in a mount namespace of its own, where it is looked at too."""
    room_kb, place = FULL_DISK[name]
    command = COMMANDS[name]
    line = filled(command.line, played_unit, folder)
    there = [need_program("nsenter", "util-linux"), "--user", "--mount"]
    there.append(f"--target={warm_with_disks.process.pid}")
    mount = ["mount", "-t", "tmpfs", "-o", f"size={room_kb}k", "tmpfs", folder]
    subprocess.run([*there, *mount], check=True)
    ended = run(folder, [command.module, *line], warm_with_disks)
    prefix = "hw_sim" if command.module == HW_SIM else f"altd {command.line.split()[0]}"
    assert re.fullmatch(
        rf"{prefix}: [^\n]*{place}[^\n]*: (cannot be written: )?No space left on device\n",
        ended.err.removeprefix("\n".join([*CONSENT, ""])),
    ), ended
    assert ended.status == 2
    assert ended.left <= ({"cal.json"} if "report" in name else set())
    assert ended.temporary == frozenset()
