"""Every command, ended in each way it can end: standard error, temporary folders and exit status.

``lamps on`` is ended on a real chip in ``test_lamps.py``, ``altd scan`` killed in ``test_scan.py``, the
simulator's cameras in ``hw_sim/gige/test_command.py``, a daemon on live cameras in ``test_live.py``.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.history import START_S, batch, event, store, write_seconds
from support.places import ROOT
from support.played_unit import BEAMS, PlayedUnit
from support.ports import free_port
from support.recordings import write_beams, write_scan

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
FRAME = "altd.recording.reader:Recording.frame 5"
EXPOSE = "hw_sim.unit:Unit.expose 5"


@dataclass(frozen=True)
class Command:
    """A command line, and the call of a function at which it gets a signal.

    ``leaves`` may stand in the working folder after that; ``ends_with`` is the status then, None: 128 and the
    signal's number; ``says`` is all of standard error. ``signals`` are fewer where another command is ended
    by all of them in the same work.
    """

    line: str
    at: str
    leaves: frozenset[str] = frozenset()
    ends_with: int | None = None
    says: str = ""
    module: str = "altd.cli"
    signals: tuple[signal.Signals, ...] = SIGNALS


HW_SIM = "hw_sim"
COMMANDS = {
    "run": Command(
        "run --config {config}",
        "altd.measuring.chain:MeasuringChain.add 5",
        ends_with=0,
        says="(altd: .*\n)+",
    ),
    "calibrate": Command("calibrate {scan} -o cal.json", FRAME),
    "calibrate's file": Command("calibrate {scan} -o cal.json", "altd.files.writing:_opened_beside 1"),
    "calibrate's report": Command(
        "calibrate {scan} -o cal.json --report rep",
        "altd.files.writing:_opened_beside 3",
        frozenset({"cal.json"}),
        signals=(signal.SIGTERM,),
    ),
    "calibrate's report, at its first drawing": Command(
        "calibrate {scan} -o cal.json --report rep", "altd.calibration.report.html:svg 1"
    ),
    "replay": Command("replay {beams} --calibration {cal}", FRAME),
    "replay's lines": Command("replay {beams} --calibration {cal} -o t.jsonl", FRAME),
    "replay's csv": Command("replay {nodes} --calibration {cal} --format csv -o t.csv", FRAME),
    "replay's csv on standard output": Command("replay {beams} --calibration {cal} --format csv", FRAME),
    "replay's parquet": Command("replay {beams} --calibration {cal} --format parquet -o t.parquet", FRAME),
    "replay's parquet, at its footer": Command(
        "replay {beams} --calibration {cal} --format parquet -o t.parquet",
        "altd.tables.parquet:ParquetTable.__exit__ 1",
    ),
    "replay's plot": Command(
        "replay {beams} --calibration {cal} --format csv -o t.csv --plot p.svg", "altd.answers.plot:svg 1"
    ),
    "record": Command(
        "record --config {config} -o kept --seconds 60",
        "altd.recording.writer:RecordingWriter.write 7",
        frozenset({"kept"}),
        says=r"altd record: interrupted: \d+ exposures in kept\n",
    ),
    "record before its first exposure": Command(
        "record --config {config} -o kept --seconds 60",
        "altd.app.record:cameras_of 1",
        says="(altd record: interrupted before the first exposure\n)?",
    ),
    "scan": Command(
        "scan --stage -o kept",
        "altd.recording.writer:RecordingWriter.write 5",
        frozenset({"kept.unfinished"}),
        says="hw_sim: no self-check: .*\nhw_sim: interrupted; the same command goes on from there\n",
        module=HW_SIM,
    ),
    "lamps": Command("lamps off --config {lamps}", "altd.app.lamps_by_hand:LampsByHand.leave_lit 1"),
    "locate": Command(
        "locate {beams}/front0000.png {beams}/rear0000.png", "altd.files.picture:read_picture 2"
    ),
    "locate's table": Command(
        "locate --format csv {beams}/front0000.png {beams}/rear0000.png", "altd.files.picture:read_picture 2"
    ),
    "map's table": Command(
        "map --calibration {cal} --target rear --format csv",
        "altd.measuring.calibration:TargetCalibration.point 2",
    ),
    "map": Command(
        "map --calibration {cal} --target rear", "altd.measuring.calibration:TargetCalibration.point 2"
    ),
    "token": Command("token credentials press", "altd.files.writing:_opened_beside 1"),
    "selfcheck": Command("selfcheck {check} --calibration {cal}", FRAME),
    "selfcheck's daemon": Command("selfcheck --config {served}", "http.client:HTTPConnection.request 1"),
    "status": Command("status --socket none.sock", "http.client:HTTPConnection.request 1"),
    "export": Command("export --history {history} -o t.csv", "altd.history.reader:Reader.summaries 1"),
    "export's parquet": Command(
        "export --history {history} --format parquet -o t.parquet", "altd.tables.parquet:ParquetTable.add 3"
    ),
    "export on standard output": Command(
        "export --history {history} --every measurement", "altd.history.reader:Reader.measurements 1"
    ),
    "events": Command("events --history {history}", "altd.history.reader:Reader.events_after 1"),
    "events that are followed": Command("events --follow --history {history}", "time:sleep 1"),
    "check-config": Command("check-config {config}", "altd.config:load_config 1"),
    "devices": Command("devices", "altd.app.connected_devices:lines 1"),
    "doctor": Command("doctor", "altd.doctor.checks:examine 1"),
    "hw_sim scan": Command("scan -o kept", EXPOSE, module=HW_SIM),
    "hw_sim flat": Command("flat -o kept", EXPOSE, module=HW_SIM),
    "hw_sim plate": Command("plate -o kept", EXPOSE, module=HW_SIM),
    "hw_sim measure": Command("measure -o kept --truth truth.json", EXPOSE, module=HW_SIM),
    "studies": Command("averaging", EXPOSE, module="studies"),
    "hw_sim demo": Command(
        "demo --seed 3 --calibration {cal_3}",
        "altd.measuring.chain:MeasuringChain.add 5",
        ends_with=0,
        module=HW_SIM,
    ),
    "hw_sim demo, kept": Command(
        "demo --seed 3 --calibration {cal_3} --keep kept",
        "altd.measuring.chain:MeasuringChain.add 5",
        frozenset({"kept"}),
        ends_with=0,
        module=HW_SIM,
        signals=(signal.SIGTERM,),
    ),
    "hw_sim demo, calibrated by itself": Command(
        "demo",
        "altd.measuring.chain:MeasuringChain.add 5",
        ends_with=0,
        module=HW_SIM,
        signals=(signal.SIGTERM,),
    ),
}

DONE = {
    "calibrate": (0, "", {"cal.json"}),
    "calibrate's report": (0, "", {"cal.json", "rep"}),
    "replay": (0, "", set()),
    "replay's lines": (0, "", {"t.jsonl"}),
    "replay's csv": (0, "", {"t.csv"}),
    "replay's parquet": (0, "", {"t.parquet"}),
    "replay's plot": (0, "", {"t.csv", "p.svg"}),
    "record --config {config} -o kept --seconds 0.4": (0, r"\d+ exposures in kept\n", {"kept"}),
    "lamps": (1, r"altd lamps: .*\n", set()),
    "locate": (0, "", set()),
    "locate {beams}/front0000.png none.png": (2, "altd locate: none.png: No such file or directory\n", set()),
    "map": (0, "", set()),
    "selfcheck": (1, "", set()),
    "selfcheck's daemon": (
        1,
        r"altd selfcheck: no daemon answers at 127\.0\.0\.1 port \d+: Connection refused\n",
        set(),
    ),
    "status": (1, "altd status: the daemon does not run: there is no socket none.sock\n", set()),
    "export": (0, "", {"t.csv"}),
    "export's parquet": (0, "", {"t.parquet"}),
    "export on standard output": (0, "", set()),
    "events": (0, "", set()),
    "check-config": (0, "", set()),
    "devices": (0, "", set()),
    "doctor": (0, "", set()),
    "hw_sim flat": (0, "", {"kept"}),
    "hw_sim plate": (0, "", {"kept"}),
    "hw_sim measure": (0, "", {"kept", "truth.json"}),
}
"""How commands end by themselves: status, standard error, what stands in the working folder."""

FULL_DISK = {
    "calibrate": (16, "cal.json"),
    "calibrate's report": (900, "rep"),
    "replay's lines": (4, "t.jsonl"),
    "replay's csv": (4, "t.csv"),
    "replay's parquet": (4, "t.parquet"),
    "replay's plot": (16, "p.svg"),
    "export": (4, "t.csv"),
    "export's parquet": (4, "t.parquet"),
    "hw_sim scan": (1000, "kept"),
    "hw_sim flat": (1000, "kept"),
    "hw_sim plate": (1000, "kept"),
    "hw_sim measure": (1000, "kept"),
}
"""Room on the disk, kB, and what does not find any there."""


@dataclass(frozen=True)
class Ended:
    status: int
    out: str
    err: str
    left: frozenset[str]
    temporary: frozenset[str]


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


def filled(line: str, unit: PlayedUnit, folder: Path) -> list[str]:
    lamps = folder.parent / "lamps.toml"
    lamps.write_text(unit.config.read_text() + '[lamps]\ndriver = "gpiod"\nchip = "none"\nlines = ["L"]\n')
    served = folder.parent / "served.toml"  # nobody is there
    served.write_text(unit.config.read_text() + f'[http]\nhost = "127.0.0.1"\nport = {free_port()}\n')
    scans = {"scan": folder.parent / "scan", "nodes": unit.folder / "scan", "check": folder.parent / "check"}
    files = {"beams": unit.beams, "cal": unit.calibration, "config": unit.config}
    files |= {
        "history": folder.parent / "history.db",
        "cal_3": folder.parent / "cal-3.json",
        "lamps": lamps,
        "served": served,
    }
    return shlex.split(line.format(**scans, **files))


def _take_signals() -> None:
    """None is ignored, as they may be where the tests run in the background or under nohup."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def run(folder: Path, command: list[str]) -> Ended:
    temporary = folder.parent / "temporary"
    done = subprocess.run(
        command,
        preexec_fn=_take_signals,
        cwd=folder,
        input="375 240\n380 240\n385 240\n",
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={
            **os.environ,
            "TMPDIR": str(temporary),
            "PYTHONWARNINGS": "error",
            "PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), str(ROOT)]),
        },
    )
    left, in_temporary = (frozenset(entry.name for entry in where.iterdir()) for where in (folder, temporary))
    return Ended(done.returncode, done.stdout, done.stderr, left, in_temporary)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param(name, number, id=f"{name}-{number.name}")
        for name, command in COMMANDS.items()
        for number in command.signals
    ],
)
def test_ended_by_a_signal(name: str, number: signal.Signals, played_unit: PlayedUnit, folder: Path) -> None:
    command = COMMANDS[name]
    line = filled(command.line, played_unit, folder)
    program = [sys.executable, "-m", "support.signalled", number.name, *command.at.split(), command.module]
    ended = run(folder, [*program, *line])
    assert ended.status == (128 + number if command.ends_with is None else command.ends_with), ended
    assert re.fullmatch(command.says, ended.err), ended.err
    assert ended.left == command.leaves
    assert ended.temporary == frozenset()


@pytest.mark.parametrize("name", DONE)
def test_ended_by_itself(name: str, played_unit: PlayedUnit, folder: Path) -> None:
    status, says, leaves = DONE[name]
    command = COMMANDS.get(name, Command(name, ""))
    ended = run(folder, [sys.executable, "-m", command.module, *filled(command.line, played_unit, folder)])
    assert ended.status in (status, 1 if name == "doctor" else status), (
        ended
    )  # it says what this computer lacks
    assert re.fullmatch(says, ended.err), ended.err
    assert (ended.left, ended.temporary) == (leaves, frozenset())


@pytest.mark.parametrize("redirected", ["| true; exit ${PIPESTATUS[0]}", ">/dev/full"])
@pytest.mark.parametrize(
    "name",
    [
        *("calibrate", "replay", "replay's csv on standard output", "locate", "locate's table"),
        *("map", "map's table", "selfcheck", "check-config", "devices", "doctor"),
        *("export on standard output", "events"),
    ],
)
def test_ended_by_who_reads(name: str, redirected: str, played_unit: PlayedUnit, folder: Path) -> None:
    line = shlex.join([sys.executable, "-m", "altd.cli", *filled(COMMANDS[name].line, played_unit, folder)])
    ended = run(folder, ["/bin/bash", "-c", f"{line} {redirected}"])
    if "full" in redirected:
        assert ended.status == 1
        command = COMMANDS[name].line.split()[0]
        assert ended.err == f"altd {command}: standard output: No space left on device\n"
    else:
        assert ended.status in (0, 1)  # 0: it was done before the reader was gone
        assert ended.err == ""
    assert ended.left <= {"cal.json"}
    assert ended.temporary == frozenset()


@pytest.mark.parametrize("name", FULL_DISK)
def test_ended_by_a_full_disk(name: str, played_unit: PlayedUnit, folder: Path) -> None:
    """A real one, in a mount namespace of its own, where it is looked at too."""
    room_kb, place = FULL_DISK[name]
    command = COMMANDS[name]
    line = shlex.join([sys.executable, "-m", command.module, *filled(command.line, played_unit, folder)])
    disk = folder / "disk"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size={room_kb}k tmpfs {disk} && cd {disk}"
    ended = run(
        folder, ["unshare", "-rm", "sh", "-c", f"{mount} && {line} >/dev/null; echo $?; ls -A {disk}"]
    )
    prefix = "hw_sim" if command.module == HW_SIM else f"altd {command.line.split()[0]}"
    assert re.fullmatch(
        rf"{prefix}: [^\n]*{place}[^\n]*: (cannot be written: )?No space left on device\n", ended.err
    ), ended
    status, *left = ended.out.split()
    assert status == "2"
    assert set(left) <= ({"cal.json"} if "report" in name else set())
    assert ended.temporary == frozenset()
