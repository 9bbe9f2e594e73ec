"""``altd replay`` into tables: what a foreign reader finds in them is what the lines say."""

import csv
import io
import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.csv
import pyarrow.parquet
import pytest
from support.cli import Outcome, altd_here, refusal
from support.played_unit import PlayedUnit
from support.recordings import Shot, write

START = "2026-11-20T08:15:30Z"
MEASURED = [
    *("sequence", "time", "t_s", "frames", "valid", "status"),
    *("x_mm", "y_mm", "yaw_deg", "pitch_deg", "yaw_mm_per_m", "pitch_mm_per_m", "roll_deg"),
    *("sigma_x_mm", "sigma_y_mm", "sigma_yaw_deg", "sigma_pitch_deg"),
    *("sigma_random_x_mm", "sigma_random_y_mm", "sigma_random_yaw_deg", "sigma_random_pitch_deg"),
    *("covariance_x_mm_x_mm", "covariance_x_mm_y_mm", "covariance_x_mm_yaw_mm_per_m"),
    *("covariance_x_mm_pitch_mm_per_m", "covariance_y_mm_y_mm", "covariance_y_mm_yaw_mm_per_m"),
    *("covariance_y_mm_pitch_mm_per_m", "covariance_yaw_mm_per_m_yaw_mm_per_m"),
    *("covariance_yaw_mm_per_m_pitch_mm_per_m", "covariance_pitch_mm_per_m_pitch_mm_per_m"),
    *("front_x_mm", "front_y_mm", "rear_x_mm", "rear_y_mm"),
]


@pytest.fixture(scope="module")
def spoilt(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A beam that rests, is gone for a while, and comes back, seen by a simulator's cameras."""
    beam: Shot = ((10.0, 5.0), (15.6, -3.4), None)
    shots = [beam] * 6 + [(beam[0], None, None)] * 4 + [beam] * 6
    path = tmp_path_factory.mktemp("spoilt") / "rec"
    write(path, "measurement", shots, start=START, made_by="altd 9.9", note='a note; with "quotes"')
    header = json.loads((path / "recording.json").read_text())
    header["cameras"]["rear"] = {
        **header["cameras"]["rear"],
        "serial": "50-1",
        "model": "M",
        "driver": "aravis",
        "exposure_ms": 2.5,
        "gain_db": 6.0,
        "origin": "simulated",
    }
    (path / "recording.json").write_text(json.dumps(header))
    return path


def replay(recording: Path, unit: PlayedUnit, *more: object) -> Outcome:
    return altd_here("replay", recording, "--calibration", unit.calibration, *more)


def flat(line: dict[str, Any]) -> list[Any]:
    """The values of a JSON object in the table's order, written down here and not by altd."""
    values = [line[name] for name in MEASURED[:13]]
    values[5] = " ".join(line["status"])
    for sigma in ("sigma", "sigma_random"):
        values += [line[sigma][name] for name in ("x_mm", "y_mm", "yaw_deg", "pitch_deg")]
    values += [line["covariance"][row][column] for row in range(4) for column in range(row, 4)]
    return values + [line[target][axis] for target in ("front", "rear") for axis in ("x_mm", "y_mm")]


def test_a_file_has_the_lines_of_standard_output(
    played_unit: PlayedUnit, spoilt: Path, tmp_path: Path
) -> None:
    lines = replay(spoilt, played_unit, "--window", 4)
    assert lines.err == ""
    outcome = replay(spoilt, played_unit, "--window", 4, "-o", tmp_path / "lines")
    assert (outcome.status, outcome.out, outcome.err) == (0, "", "")
    assert (tmp_path / "lines").read_text() == lines.out
    assert replay(spoilt, played_unit, "--window", 4, "--format", "jsonl").out == lines.out
    states = [(line["valid"], *line["status"]) for line in lines.objects]
    assert (True, "simulated") in states
    assert (False, "rear_spot_missing", "simulated") in states


def test_csv_by_two_foreign_readers(played_unit: PlayedUnit, spoilt: Path, tmp_path: Path) -> None:
    lines = replay(spoilt, played_unit, "--window", 4).objects
    outcome = replay(spoilt, played_unit, "--window", 4, "--format", "csv", "-o", tmp_path / "t.csv")
    assert (outcome.status, outcome.out, outcome.err) == (0, "", "")
    content = (tmp_path / "t.csv").read_bytes()
    assert content.count(b"\r\n") == content.count(b"\n") == len(lines) + 1  # RFC 4180
    header, *rows = csv.reader(io.StringIO(content.decode("ascii"), newline=""), strict=True)
    assert header == MEASURED
    for row, line in zip(rows, lines, strict=True):
        expected = ["" if value is None else str(value) for value in flat(line)]
        expected[4] = expected[4].lower()
        assert row == expected
        assert row[1].endswith("Z")
    table = pyarrow.csv.read_csv(tmp_path / "t.csv")
    types = {name: str(table.schema.field(name).type) for name in MEASURED}
    assert types["sequence"] == types["frames"] == "int64"
    assert types["time"].startswith("timestamp")
    assert types["valid"] == "bool"
    assert {types[name] for name in MEASURED if "_mm" in name or "_deg" in name} - {"double"} <= {"null"}
    assert types["roll_deg"] == "null"
    assert table["x_mm"].to_pylist() == [line["x_mm"] for line in lines]
    assert replay(spoilt, played_unit, "--window", 4, "--format", "csv").out.encode() == content.replace(
        b"\r\n", b"\n"
    )  # subprocess' text mode


def test_parquet_has_types_nulls_units_and_where_it_comes_from(
    played_unit: PlayedUnit, spoilt: Path, tmp_path: Path
) -> None:
    lines = replay(spoilt, played_unit, "--window", 4).objects
    outcome = replay(spoilt, played_unit, "--window", 4, "--format", "parquet", "-o", tmp_path / "t.parquet")
    assert (outcome.status, outcome.out, outcome.err) == (0, "", "")
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    assert table.column_names == MEASURED
    rows = [list(row.values()) for row in table.to_pylist()]
    expected = [flat(line) for line in lines]
    for row in expected:
        row[1] = datetime.strptime(row[1], "%Y-%m-%dT%H:%M:%S.%fZ").replace(tzinfo=UTC)
    assert rows == expected
    schema = table.schema
    assert schema.field("time").type == pyarrow.timestamp("ms", tz="UTC")
    assert [schema.field(name).type for name in ("sequence", "valid", "status", "x_mm", "roll_deg")] == [
        *(pyarrow.int64(), pyarrow.bool_(), pyarrow.string(), pyarrow.float64(), pyarrow.float64())
    ]
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in MEASURED}
    assert (units["x_mm"], units["sigma_yaw_deg"], units["yaw_mm_per_m"], units["t_s"]) == (
        "mm",
        "°",
        "mm/m",
        "s",
    )
    about = {key.decode(): json.loads(value) for key, value in schema.metadata.items()}
    assert about["altd.unit_serial"] == "TEST-1"
    assert about["altd.origin"] == "simulated"
    assert about["altd.recording"] == {
        "kind": "measurement",
        "fps": 20.0,
        "note": 'a note; with "quotes"',
        "made_by": "altd 9.9",
        "path": str(spoilt),
        "start": "2026-11-20T08:15:30.000Z",
    }
    rear = {"width": 752, "height": 480, "bits": 8, "serial": "50-1", "model": "M", "driver": "aravis"}
    assert about["altd.cameras"]["rear"] == {
        **rear, "origin": "simulated", "exposure_ms": 2.5, "gain_db": 6.0
    }  # fmt: skip
    assert about["altd.calibration"]["origin"] == "camera"
    assert about["altd.window"] == "sliding means of 4 exposures"


def test_a_table_without_rows_can_be_loaded(played_unit: PlayedUnit, tmp_path: Path) -> None:
    arguments = ("--window", 1000, "--every", 1000)
    for form in ("csv", "parquet"):
        outcome = replay(
            played_unit.beams, played_unit, *arguments, "--format", form, "-o", tmp_path / form,
            "--plot", tmp_path / f"{form}.svg",
        )  # fmt: skip
        assert (outcome.status, outcome.err) == (0, "")
    assert pyarrow.csv.read_csv(tmp_path / "csv").column_names == MEASURED
    assert pyarrow.parquet.read_table(tmp_path / "parquet").num_rows == 0
    assert b"<svg" in (tmp_path / "csv.svg").read_bytes()


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nodes of three exposures, LED reference pairs first, a beam that misses the stage's place at the rear.

    By 0.2 mm in x and −0.1 mm in y: what a metrologist is to find.
    """
    nodes = [(-20.0, -10.0), (5.0, -10.0), (5.0, 12.5), (-20.0, -10.0)]
    shots: list[Shot] = [(None, None, None)] * 2
    for x, y in nodes:
        shots += [((x, y), (x + 0.2, y - 0.1), (x, y))] * 3
    path = write(tmp_path_factory.mktemp("scan") / "rec", "scan", shots)
    rows = (
        (path / "frames.csv")
        .read_text()
        .replace("1,0.050000,front,front0001.png,off", "1,0.050000,front,front0001.png,on")
    )
    (path / "frames.csv").write_text(rows)
    return path


NODES = [(-20.0, -10.0), (5.0, -10.0), (5.0, 12.5), (-20.0, -10.0)]


def test_a_scan_gives_a_line_a_node_with_its_place_and_the_difference(
    played_unit: PlayedUnit, scan: Path
) -> None:
    outcome = replay(scan, played_unit)
    assert outcome.status == 0
    lines = outcome.objects
    x_mm, y_mm = (statistics.fmean(line[key] ** 2 for line in lines) ** 0.5 for key in ("dx_mm", "dy_mm"))
    largest_mm = max(math.hypot(line["dx_mm"], line["dy_mm"]) for line in lines)
    assert outcome.err == (
        "altd replay: 4 of 4 measurements valid; against the known positions: "
        f"rms x {x_mm:.4f} mm, y {y_mm:.4f} mm, largest {largest_mm:.4f} mm\n"
    )
    assert [(line["known_x_mm"], line["known_y_mm"]) for line in lines] == NODES
    assert [(line["sequence"], line["frames"], line["valid"]) for line in lines] == [
        (sequence, 3, True) for sequence in (4, 7, 10, 13)
    ]
    for line, (x, y) in zip(lines, NODES, strict=True):
        assert (line["dx_mm"], line["dy_mm"]) == pytest.approx((0.0, 0.0), abs=0.03)
        assert (line["front"]["dx_mm"], line["front"]["dy_mm"]) == pytest.approx((0.0, 0.0), abs=0.03)
        assert (line["rear"]["dx_mm"], line["rear"]["dy_mm"]) == pytest.approx((0.2, -0.1), abs=0.03)
        assert line["rear"]["x_mm"] - x == pytest.approx(line["rear"]["dx_mm"], abs=1.1e-4)
        assert line["y_mm"] - y == pytest.approx(line["dy_mm"], abs=1.1e-4)


@pytest.mark.parametrize(
    ("arguments", "frames"),
    [(("--window", 2), [1, 2, 2]), (("--window", 2, "--every", 2), [2]), (("--every", 3), [0])],
)
def test_windows_never_mix_two_nodes(
    played_unit: PlayedUnit, scan: Path, arguments: Sequence[object], frames: list[int]
) -> None:
    """They start again at each; three exposures are less than half of the usual window."""
    lines = replay(scan, played_unit, *arguments).objects
    assert [line["frames"] for line in lines] == frames * len(NODES)
    known = [(line["known_x_mm"], line["known_y_mm"]) for line in lines]
    assert known == [node for node in NODES for _ in frames]
    for line in lines:
        assert line["valid"] == (line["frames"] > 0)
        assert line["status"] == ([] if line["valid"] else ["warming_up"])
        assert (line["dx_mm"] is None) == (line["rear"]["dy_mm"] is None) == (not line["valid"])
        assert line["dx_mm"] is None or abs(line["dx_mm"]) < 0.05


def test_a_scan_as_a_table(played_unit: PlayedUnit, scan: Path, tmp_path: Path) -> None:
    lines = replay(scan, played_unit).objects
    replay(scan, played_unit, "--format", "parquet", "-o", tmp_path / "t")
    table = pyarrow.parquet.read_table(tmp_path / "t")
    assert table.column_names == [
        *MEASURED,
        *("known_x_mm", "known_y_mm", "dx_mm", "dy_mm"),
        *("front_dx_mm", "front_dy_mm", "rear_dx_mm", "rear_dy_mm"),
    ]
    assert table["known_y_mm"].to_pylist() == [y for _, y in NODES]
    assert table["rear_dx_mm"].to_pylist() == [line["rear"]["dx_mm"] for line in lines]
    assert json.loads(table.schema.metadata[b"altd.window"]) == "all exposures of a node"


def test_a_node_without_a_spot_is_a_line_too(played_unit: PlayedUnit, tmp_path: Path) -> None:
    shots: list[Shot] = []
    for x, y in NODES:
        shots += [((x, y), None if y > 0 else (x, y), (x, y))] * 2
    lines = replay(write(tmp_path / "rec", "scan", shots), played_unit).objects
    assert [line["status"] for line in lines] == [[], [], ["rear_spot_missing"], []]
    assert (lines[2]["known_y_mm"], lines[2]["dy_mm"], lines[2]["rear"]["dy_mm"]) == (12.5, None, None)


def test_a_scan_that_contradicts_itself_or_knows_no_place(
    played_unit: PlayedUnit, scan: Path, tmp_path: Path
) -> None:
    shots: list[Shot] = [((5.0, 5.0), (5.0, 5.0), (5.0, 5.0))] * 2
    path = write(tmp_path / "rec", "scan", shots)
    text = (path / "frames.csv").read_text()
    (path / "frames.csv").write_text(
        text.replace("1,0.050000,rear,rear0001.png,off,5.0", "1,0.050000,rear,rear0001.png,off,6.0")
    )
    said = refusal(replay(path, played_unit))
    assert said.endswith("frames.csv: row 5: x_mm, y_mm are not those of the same exposure in row 4")
    nowhere = write(tmp_path / "nowhere", "scan", [((5.0, 5.0), (5.0, 5.0), None)])
    assert refusal(replay(nowhere, played_unit)).endswith(
        "frames.csv: is of a scan, and no row has a position"
    )


def test_a_scan_that_is_not_in_the_order_of_time(played_unit: PlayedUnit, tmp_path: Path) -> None:
    """One camera's rows after all of the other's, whose numbers are larger: too long to wait."""
    path = write(tmp_path / "rec", "scan", [((5.0, 5.0), (5.0, 5.0), (5.0, 5.0))] * 2)
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for camera, step in (("front", 1000), ("rear", 7)):
        rows += [
            f"{n * step},{n / 20},{camera},{camera}000{n % 2}.png,off,{n % 50},{n % 3}" for n in range(1200)
        ]
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    said = refusal(replay(path, played_unit))
    assert said.endswith("frames.csv: row 2201: is not in order of time: sequence 6993 long after 1199000")


class TestRefusals:
    """Before any work: one line, nothing written."""

    def test_parquet_on_standard_output(self, played_unit: PlayedUnit) -> None:
        said = refusal(replay(played_unit.beams, played_unit, "--format", "parquet"))
        assert said == "altd replay: --format parquet: needs a file: -o FILE"

    def test_a_plot_that_is_no_svg(self, played_unit: PlayedUnit, tmp_path: Path) -> None:
        assert "SVG" in refusal(replay(played_unit.beams, played_unit, "--plot", tmp_path / "plot.png"))

    def test_one_file_for_both(self, played_unit: PlayedUnit, tmp_path: Path) -> None:
        place, again = tmp_path / "t.svg", tmp_path / ".." / tmp_path.name / "t.svg"
        assert "twice" in refusal(replay(played_unit.beams, played_unit, "-o", place, "--plot", again))

    def test_what_is_read(self, played_unit: PlayedUnit) -> None:
        for path in (played_unit.calibration, played_unit.beams / "frames.csv"):
            before = path.read_bytes()
            assert refusal(replay(played_unit.beams, played_unit, "-o", path)).endswith(": is the input")
            assert path.read_bytes() == before

    def test_a_folder_that_is_not_there(self, played_unit: PlayedUnit, tmp_path: Path) -> None:
        for option in ("-o", "--plot"):
            said = refusal(replay(played_unit.beams, played_unit, option, tmp_path / "none" / "t.svg"))
            assert said.endswith("t.svg: its folder does not exist")

    @pytest.mark.parametrize(
        ("module", "arguments", "extra"),
        [("pyarrow", "--format parquet -o t", "parquet"), ("matplotlib", "--plot t.svg", "report")],
    )
    def test_an_extra_that_is_not_installed(
        self, played_unit: PlayedUnit, tmp_path: Path, module: str, arguments: str, extra: str
    ) -> None:
        (tmp_path / "hidden").mkdir()
        (tmp_path / "hidden" / f"{module}.py").write_text("raise ImportError('hidden')")
        command = ["replay", "nowhere", "--calibration", str(played_unit.calibration), *arguments.split()]
        done = subprocess.run(
            [sys.executable, "-m", "altd.cli", *command],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "hidden"), str(Path.cwd())])},
        )
        option = arguments.removesuffix(" -o t").removesuffix(" t.svg")
        said = f"altd replay: {option}: needs {module}, which comes with the extra altd[{extra}]\n"
        assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
        assert [path.name for path in tmp_path.iterdir()] == ["hidden"]


def test_an_older_table_stays_when_a_frame_cannot_be_decoded(
    played_unit: PlayedUnit, spoilt: Path, tmp_path: Path
) -> None:
    rec = tmp_path / "rec"
    subprocess.run(["cp", "-r", str(spoilt), str(rec)], check=True)
    whole = (rec / "rear0012.png").read_bytes()
    (rec / "rear0012.png").write_bytes(whole[:2000])
    for form in ("jsonl", "csv", "parquet"):
        (tmp_path / "old").write_text("old")
        said = refusal(
            replay(rec, played_unit, "--format", form, "-o", tmp_path / "old", "--plot", tmp_path / "t.svg")
        )
        assert "rear0012.png" in said
        assert (tmp_path / "old").read_text() == "old"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["old", "rec"]
