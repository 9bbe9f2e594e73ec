"""The commands that are ended, and how one is run: what it left and what it said."""

import os
import shlex
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

from support.places import ROOT
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.warm import Warm

from altd.app.backup import back_up

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
FRAME = "altd.recording.reader:Recording.frame 5"
EXPOSE = "hw_sim.unit:Unit.expose 5"


@dataclass(frozen=True)
class Command:
    """A command line, and the call of a function at which it gets a signal.

    ``leaves`` may be in the working folder after that; ``ends_with`` is the status then, None: 128 and the
    signal's number; ``says`` is all of standard error.
    """

    line: str
    at: str
    leaves: frozenset[str] = frozenset()
    ends_with: int | None = None
    says: str = ""
    module: str = "altd.cli"


HW_SIM = "hw_sim"
COMMANDS = {
    "run": Command(
        "run --config {config}",
        "altd.measuring.chain:MeasuringChain.add 5",
        ends_with=0,
        says="(altd: .*\n)+",
    ),
    "calibrate": Command("calibrate {scan} -o cal.json", FRAME),
    "calibrate's file": Command("calibrate {scan} -o cal.json", "altd.files.writing:_temporary_file 1"),
    "calibrate's report": Command(
        "calibrate {scan} -o cal.json --report rep",
        "altd.files.writing:_temporary_file 3",
        frozenset({"cal.json"}),
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
        "altd.tables:ParquetTable.__exit__ 1",
    ),
    "replay's plot": Command(
        "replay {beams} --calibration {cal} --format csv -o t.csv --plot p.svg", "altd.answers.plot:svg 1"
    ),
    "record": Command(
        "record --config {config} -o kept --seconds 60",
        "altd.recording.writer:RecordingWriter.write 7",
        frozenset({"kept"}),
        says=r"altd record: interrupted: \d+ exposures? in kept\n",
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
        says="hw_sim: no self-check: .*\nhw_sim: interrupted; the same command continues there\n",
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
    "axis": Command(
        "axis --config {tunnel}/unit.toml {tunnel}/axis.json {tunnel}/beam.json {tunnel}/measurement.jsonl",
        "altd.axis:Axis.feet 1",
    ),
    "token": Command("token credentials press", "altd.files.writing:_temporary_file 1"),
    "selfcheck": Command("selfcheck {check} --calibration {cal}", FRAME),
    "verify": Command("verify {scan} --calibration {cal}", FRAME),
    "verify's page": Command(
        "verify {scan} --calibration {cal} -o page", "altd.calibration.report.html:svg 1"
    ),
    "selfcheck's daemon": Command("selfcheck --config {served}", "http.client:HTTPConnection.request 1"),
    "status": Command("status --socket none.sock", "http.client:HTTPConnection.request 1"),
    "export": Command("export --history {history} -o t.csv", "altd.history.reader:Reader.summaries 1"),
    "export's parquet": Command(
        "export --history {history} --format parquet -o t.parquet", "altd.tables:ParquetTable.add 3"
    ),
    "export on standard output": Command(
        "export --history {history} --every measurement", "altd.history.reader:Reader.measurements 1"
    ),
    "events": Command("events --history {history}", "altd.history.reader:Reader.events_after 1"),
    "events that are followed": Command("events --follow --history {history}", "time:sleep 1"),
    "backup": Command("backup --config {config} -o b.tar.gz", "altd.app.backup:_add 2"),
    "restore": Command("restore {archive} --config altd.toml", "altd.app.restore:_stage 2"),
    "diagnose": Command(
        "diagnose --config {served} -o d.zip",
        "altd.app.diagnostics:_versions 1",
        says="(altd diagnose: .+\\n)+",
    ),
    "diagnose for an issue": Command(
        "diagnose --public --yes --config {config} --recording {beams} -o p.zip",
        "altd.recording.reader:Recording.frame 3",
    ),
    "diagnose for an issue, at its question": Command(
        "diagnose --public --config {config} -o p.zip",
        "altd.cli.diagnose:_agrees 1",
        says="(This archive .*\\n)(.+\\n)+?(altd diagnose: nothing is written\\n)?",
    ),
    "record of a plate": Command(
        "record --config {config} -o kept --seconds 60 --kind plate --plate 7,5,25,0.05 --placed 0.5,1,300 "
        "--target front --beam 5",
        "altd.recording.writer:RecordingWriter.write 7",
        frozenset({"kept"}),
        says=r"altd record: interrupted: \d+ exposures? in kept\n",
    ),
    "planar": Command(
        "planar driven --calibration {cal} --design {design} -o m.toml",
        "altd.files.reading:read_file 1",
    ),
    "check-config": Command("check-config {config}", "altd.config.loading:read_config 1"),
    "registers": Command("registers --format csv", "csv:DictWriter.writeheader 1"),
    "refraction": Command("refraction --distance 10 100", "altd.cli.refraction:bending 2"),
    "devices": Command("devices", "altd.cli.devices:lines 1"),
    "doctor": Command("doctor", "altd.doctor.checks:examine 1"),
    "ingest": Command(
        "ingest --config {fleet}",
        "altd.fleet.ingest:Ingest._open_database 1",
        ends_with=0,
        says="(altd: .*\n)*(ingest: no database yet: .*\n)?",  # its thread continues until the end
    ),
    "fleet": Command("fleet --config {fleet}", "altd.fleet.database:connect 1"),
    "hw_sim scan": Command("scan -o kept", EXPOSE, module=HW_SIM),
    "hw_sim flat": Command("flat -o kept --exposures 4", EXPOSE, module=HW_SIM),
    "hw_sim plate": Command("plate -o kept", EXPOSE, module=HW_SIM),
    "hw_sim planar-recording": Command(
        "planar-recording -o kept --known 2", "hw_sim.planar:PlanarScene.expose 5", module=HW_SIM
    ),
    "hw_sim measure": Command("measure -o kept --truth truth.json --poses 2", EXPOSE, module=HW_SIM),
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
    ),
}


@dataclass(frozen=True)
class Ended:
    status: int
    out: str
    err: str
    left: frozenset[str]
    temporary: frozenset[str]


def filled(line: str, unit: PlayedUnit, folder: Path) -> list[str]:
    lamps = folder.parent / "lamps.toml"
    lamps.write_text(unit.config.read_text() + '[lamps]\ndriver = "gpiod"\nchip = "none"\nlines = ["L"]\n')
    served = folder.parent / "served.toml"  # no daemon is there
    served.write_text(unit.config.read_text() + f'[http]\nhost = "127.0.0.1"\nport = {free_port()}\n')
    archive = folder.parent / "unit.tar.gz"
    if "{archive}" in line:
        back_up(unit.config, archive)
    fleet = folder.parent / "fleet.toml"  # neither broker nor database are there
    fleet.write_text(
        f'[broker]\nhost = "127.0.0.1"\nport = {free_port()}\n[database]\nconnection = "host={folder}"\n'
    )
    scans = {"scan": folder.parent / "scan", "nodes": unit.folder / "scan", "check": folder.parent / "check"}
    files = {"beams": unit.beams, "cal": unit.calibration, "config": unit.config}
    files |= {
        "history": folder.parent / "history.db",
        "cal_3": folder.parent / "cal-3.json",
        "lamps": lamps,
        "served": served,
        "archive": archive,
        "fleet": fleet,
        "design": ROOT / "config" / "planar-machine.toml",
        "tunnel": ROOT / "examples" / "tunnel",
    }
    return shlex.split(line.format(**scans, **files))


ENVIRONMENT = {
    **os.environ,
    "PYTHONWARNINGS": "error",
    "PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), str(ROOT)]),
}


def run(
    folder: Path, command: list[str], warm: Warm, *, cold: bool = False, output: int | None = None
) -> Ended:
    """Run ``python -m`` with these words in a folder, forked by ``warm`` or ``cold``: by an own interpreter.

    ``output`` is a descriptor that it has for standard output.
    """
    temporary = folder.parent / "temporary"
    with TemporaryFile() as read, TemporaryFile() as out, TemporaryFile() as err:
        read.write(b"375 240\n380 240\n385 240\n")
        read.seek(0)
        streams = read.fileno(), out.fileno() if output is None else output, err.fileno()
        if cold:
            stdin, stdout, stderr = streams
            status = subprocess.run(
                [sys.executable, "-m", *command],
                cwd=folder,
                stdin=stdin,
                stdout=stdout,
                stderr=stderr,
                timeout=200,
                check=False,
                env={**ENVIRONMENT, "TMPDIR": str(temporary)},
            ).returncode
        else:
            status = warm.run(command, folder, streams, TMPDIR=str(temporary))
        for file in (out, err):
            file.seek(0)
        left, in_temporary = (
            frozenset(entry.name for entry in warm.sees(where).iterdir()) for where in (folder, temporary)
        )
        return Ended(status, out.read().decode(), err.read().decode(), left, in_temporary)
