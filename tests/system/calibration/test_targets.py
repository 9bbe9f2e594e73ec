"""Whole calibrations whose targets are those of the recordings' headers, whatever cameras look at them."""

import hashlib
import json
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient
from support.cli import altd_here, refusal
from support.plates import View, plate_light, tilted, write_plates
from support.played_unit import PlayingDaemon
from support.ports import free_port
from support.recordings import grid, place_px, seen, write_scan_of, write_targets

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration
from altd.errors import BadInputError
from altd.recording.reader import open_recording
from altd.records import Glass

GLASS = {"glass_mm": 20.0, "glass_index": 1.5}
THREE = [seen("front", 0.0, "near") | GLASS, seen("middle", 140.0, "mid"), seen("rear", 280.0, "far")]
PLATE_VIEW = View(1333.0, 420.0, tilted(12.0, 1.0, 2.0), mirrored=True)
SIZE = {"width": 752, "height": 480, "bits": 8}


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan of three targets, its calibration and its report."""
    folder = tmp_path_factory.mktemp("three")
    write_scan_of(folder / "scan", *THREE, exposures=2)
    done = altd_here("calibrate", folder / "scan", "-o", folder / "cal.json", "--report", folder / "report")
    assert (done.status, done.err) == (0, "")
    head = next(n for n, line in enumerate(done.out.splitlines()) if line.startswith("target "))
    rows = done.out.splitlines()[head + 1 :][:3]
    assert [line.split()[0] for line in rows] == ["front", "middle", "rear"], done.out
    return folder


def test_three_targets_become_three_in_beam_order(three: Path) -> None:
    targets = load_calibration(three / "cal.json").targets
    assert [(target.name, target.z_mm) for target in targets] == [
        ("front", 0),
        ("middle", 140),
        ("rear", 280),
    ]
    assert [target.glass for target in targets] == [Glass(20.0, 1.5), None, None]
    for target in targets:
        point = target.point(*place_px(target.name, 11.0, -7.0))
        assert point is not None
        assert (point.x_mm, point.y_mm) == pytest.approx((11.0, -7.0), abs=0.02)


def test_the_report_shows_all_three_and_names_the_cameras(three: Path) -> None:
    page = (three / "report" / "cal.html").read_text()
    for name in ("front", "middle", "rear"):
        assert f"residual vectors of target {name}" in page
        assert f"spots and LEDs in the picture of {name}" in page
    assert "from all targets together" in page
    assert "Camera near, target front" in page
    assert "z 0 mm, 20 mm of glass (index 1.5) behind it, picture" in page
    assert (three / "report" / "cal.pdf").read_bytes().startswith(b"%PDF")


DX_MM, DY_MM = 20.0 * 0.02 / 3, 20.0 * 0.01 / 3
"""Behind the glass the beam is displaced by a third of slope times thickness."""
BEAM = {"front": (3.0, -4.0), "middle": (5.8 - DX_MM, -2.6 - DY_MM), "rear": (8.6 - DX_MM, -1.2 - DY_MM)}


@pytest.fixture(scope="module")
def beam(three: Path) -> Path:
    """The camera ``spare`` looks at no target, and its frames are none of the measurement's."""
    rec = write_targets(three / "beam", "measurement", THREE, [(BEAM, None)] * 4)
    about = json.loads((rec / "recording.json").read_text())
    about["cameras"]["spare"] = SIZE
    (rec / "recording.json").write_text(json.dumps(about))
    with (rec / "frames.csv").open("a") as table:
        table.write("4,0.2,spare,near0000.png,off,,\n")
    return rec


def assert_is_the_beam(line: dict[str, Any]) -> None:
    assert line["valid"], line
    assert (line["x_mm"], line["y_mm"]) == pytest.approx((3.0, -4.0), abs=0.03)
    assert (line["yaw_mm_per_m"], line["pitch_mm_per_m"]) == pytest.approx((20.0, 10.0), abs=0.15)
    for name, place in BEAM.items():
        assert (line[name]["x_mm"], line[name]["y_mm"]) == pytest.approx(place, abs=0.03), name


def test_a_beam_through_three_targets_is_replayed(three: Path, beam: Path) -> None:
    done = altd_here("replay", beam, "--calibration", three / "cal.json", "--window", "4", "--every", "4")
    (line,) = done.objects
    assert_is_the_beam(line)


def test_the_daemon_measures_and_publishes_all_three(three: Path, beam: Path, tmp_path: Path) -> None:
    http, modbus = free_port(), free_port()
    config = f'[unit]\nserial = "TEST-1"\ncalibration = "{three / "cal.json"}"\n[measuring]\nwindow = 4\n'
    for name, port in (("http", http), ("modbus_tcp", modbus)):
        config += f'[{name}]\nhost = "127.0.0.1"\nport = {port}\n'
    for target in THREE:
        config += "[[targets]]\n" + "".join(f"{key} = {json.dumps(of)}\n" for key, of in target.items())
        config += f'[cameras.{target["camera"]}]\ndriver = "recording"\npath = "{beam}"\nrepeat = true\n'
    (tmp_path / "altd.toml").write_text(config)
    command = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", tmp_path / "altd.toml"]
    with subprocess.Popen(command) as process:
        daemon = PlayingDaemon(process, http, modbus)
        try:
            assert_is_the_beam(daemon.wait_until_valid())
            with ModbusTcpClient("127.0.0.1", port=modbus) as controller:
                x_mm = math.nan
                while math.isnan(x_mm):  # a busy machine may be without a value for a moment
                    words = controller.read_input_registers(20, count=4).registers
                    x_mm, y_mm = struct.unpack(">2f", struct.pack(">4H", *words))
        finally:
            process.kill()
    assert (x_mm, y_mm) == pytest.approx((3.0, -4.0), abs=0.03)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({2: seen("rear", 281.0, "far")}, "cal.json: target 'rear' was calibrated at z 280 mm, not 281"),
        (
            {0: seen("front", 0.0, "near") | {"glass_mm": 4.0}},
            "cal.json: target 'front' was calibrated with 20 mm of glass (index 1.5) behind it, "
            "not with 4 mm of glass (index 1.52)",
        ),
        ({1: seen("other", 140.0, "mid")}, "cal.json: does not know target 'other'"),
        ({1: None}, "rec: has no camera that looks at target 'middle'"),
    ],
)
def test_a_recording_of_other_targets_is_not_replayed(
    three: Path, tmp_path: Path, change: dict[int, dict[str, object] | None], complaint: str
) -> None:
    targets = [change.get(number, target) for number, target in enumerate(THREE)]
    known = [target for target in targets if target is not None]
    shots = [({str(target["name"]): (0.0, 0.0) for target in known}, None)]
    rec = write_targets(tmp_path / "rec", "measurement", known, shots)
    assert complaint in refusal(altd_here("replay", rec, "--calibration", three / "cal.json"))


@pytest.mark.usefixtures("undrawn")
def test_a_plate_recorded_with_one_camera_calibrates_one_target(tmp_path: Path) -> None:
    """It is called otherwise than its target, and sees it mirrored, as ``front`` is seen."""
    rec = write_plates(
        tmp_path / "rec",
        {"cam7": plate_light(PLATE_VIEW)},
        cameras={"cam7": SIZE},
        unit={"serial": "TEST-1"},
        targets=[seen("front", 0.0, "cam7") | GLASS],
    )
    cal, report = tmp_path / "cal.json", tmp_path / "report"
    done = altd_here("calibrate", rec, "-o", cal, "--report", report)
    assert (done.status, done.err) == (0, "")
    (target,) = load_calibration(cal).targets
    assert (target.name, target.glass) == ("front", Glass(20.0, 1.5))
    u, v = PLATE_VIEW.to_px(np.array([[21.0, -13.0]]))[0]
    mapped = altd_here("map", "--calibration", cal, "--target", "front", stdin=f"{u} {v}\n")
    assert [float(value) for value in mapped.out.split()[:2]] == pytest.approx([21.0, -13.0], abs=0.01)
    page = (report / "cal.html").read_text()
    assert "predicted sigma of x over the area" in page
    assert "yaw" not in page
    assert "both targets" not in page
    beams = write_targets(
        tmp_path / "beams", "measurement", [seen("front", 0.0, "cam7")], [({"front": (0.0, 0.0)}, None)]
    )
    refused = refusal(altd_here("replay", beams, "--calibration", cal))
    assert "cal.json: is of target 'front' alone; a beam needs at least 2 targets" in refused


def test_only_the_target_front_is_seen_mirrored_unless_the_camera_says_so(tmp_path: Path) -> None:
    """A plate is symmetric: who takes it for mirrored gets a map with x the other way round."""
    upright = View(950.0, 340.0, tilted(10.0, 2.5, -3.0))
    for name, view, said in (
        ("rear", upright, {}),
        ("front", upright, {"mirrored": False}),
        ("rear", PLATE_VIEW, {"mirrored": True}),
    ):
        rec = write_plates(
            tmp_path / f"{name}{len(said)}{view.mirrored}",
            {"front": plate_light(view)},
            pairs=1,
            cameras={"front": {**SIZE, **said}},
            targets=[seen(name, 0.0, "front")],
        )
        (target,) = calibrate([open_recording(rec)]).calibration.targets
        point = target.point(*view.to_px(np.array([[21.0, -13.0]]))[0])
        assert point is not None
        assert (point.x_mm, point.y_mm) == pytest.approx((21.0, -13.0), abs=0.02), (name, said)


@pytest.mark.usefixtures("undrawn")
def test_each_target_is_taken_from_the_recording_that_has_it(tmp_path: Path) -> None:
    plate = write_plates(
        tmp_path / "plate",
        {"cam": plate_light(PLATE_VIEW)},
        pairs=1,
        cameras={"cam": SIZE},
        targets=[seen("front", 0.0, "cam")],
        note="a plate",
    )
    scan = write_scan_of(tmp_path / "scan", seen("rear", 280.0, "cam"), note="a scan")
    cal = tmp_path / "cal.json"
    done = altd_here("calibrate", plate, scan, "-o", cal, "--report", tmp_path / "report")
    (doubt,) = done.err.splitlines()
    assert done.status == 0
    assert "doubtful: the targets are from different recordings: the zero of yaw and pitch" in doubt
    made = load_calibration(cal)
    assert [(target.name, target.z_mm) for target in made.targets] == [("front", 0.0), ("rear", 280.0)]
    assert [target.localiser.method for target in made.targets] == ["moment", "profile"]
    assert made.recording_note == "a plate; a scan"
    lines = "".join(f"{open_recording(path).sha256()}\n" for path in (plate, scan))
    assert made.recording_sha256 == hashlib.sha256(lines.encode()).hexdigest()
    page = (tmp_path / "report" / "cal.html").read_text()
    assert "scan, a scan" in page
    assert f"altd calibrate {plate} {scan} -o {cal}" in page


def test_of_one_recording_note_and_hash_are_its_own(three: Path) -> None:
    made = load_calibration(three / "cal.json")
    assert made.recording_note == "written by a test"
    assert made.recording_sha256 == open_recording(three / "scan").sha256()


def test_what_one_scan_of_a_target_lacks_another_gives(tmp_path: Path) -> None:
    """Of each scan a quarter of the nodes is dark, other ones: alone neither is enough."""
    target, places = seen("rear", 280.0, "cam"), grid()
    scans = [
        write_targets(
            tmp_path / f"scan{number}",
            "scan",
            [target],
            [({"rear": None if n % 4 == number else place}, place) for n, place in enumerate(places)] * 2,
            seed=number,
        )
        for number in (0, 1)
    ]
    recordings = [open_recording(path) for path in scans]
    for recording in recordings:
        with pytest.raises(BadInputError, match="rear: 5 of 20 nodes have no spot: spot_missing in cam"):
            calibrate([recording])
    result = calibrate(recordings)
    assert result.refused == ()
    (evidence,) = result.evidence
    assert evidence.nodes_mm == pytest.approx(np.array(places))
    assert evidence.exposures == tuple(2 if n % 4 < 2 else 4 for n in range(20))
    point = result.calibration.targets[0].point(*place_px("rear", 11.0, -7.0))
    assert point is not None
    assert (point.x_mm, point.y_mm) == pytest.approx((11.0, -7.0), abs=0.02)


def test_a_stage_that_comes_back_elsewhere_is_no_scatter_of_exposures(tmp_path: Path) -> None:
    """The second scan lies 0.1 mm aside, which is 0.4 px; single exposures scatter by 0.01 px."""
    target = seen("rear", 280.0, "cam")
    aside = [({"rear": (x + 0.1, y)}, (x, y)) for x, y in grid() for _ in range(2)]
    scans = [
        write_scan_of(tmp_path / "scan", target, exposures=2),
        write_targets(tmp_path / "again", "scan", [target], aside, seed=1),
    ]
    alone = calibrate([open_recording(scans[0])]).calibration.targets[0]
    together = calibrate([open_recording(path) for path in scans])
    (made,) = together.calibration.targets
    assert made.repeatability_px.max() < 1.5 * alone.repeatability_px.max() < 0.03
    (doubt,) = together.doubts
    assert doubt.startswith(f"rear: {scans[1]} puts the spots of 20 nodes 0.10 mm from where {scans[0]} does")


def test_the_flat_of_a_target_is_what_its_own_camera_saw(tmp_path: Path) -> None:
    """In the flat the cameras have other names than in the scan, even each other's."""
    targets = [seen("front", 0.0, "a"), seen("rear", 280.0, "b")]
    scan = write_scan_of(tmp_path / "scan", *targets)
    flat = tmp_path / "flat"
    flat.mkdir()
    levels = {"a": 90, "b": 180}
    about = json.loads((scan / "recording.json").read_text())
    about |= {"kind": "flat", "targets": [seen("front", 0.0, "b"), seen("rear", 280.0, "a")]}
    rng = np.random.default_rng(5)
    pictures = {name: level * rng.uniform(0.8, 1.2, (480, 752)) for name, level in levels.items()}
    rows = ["sequence,t_s,camera,file,leds,x_mm,y_mm"]
    for name, pixels in pictures.items():
        cv2.imwrite(str(flat / f"{name}.png"), pixels.astype(np.uint8))
        rows.append(f"0,0.0,{name},{name}.png,off,,")
    (flat / "frames.csv").write_text("\n".join(rows) + "\n")
    (flat / "recording.json").write_text(json.dumps(about))
    front, rear = calibrate([open_recording(scan)], open_recording(flat)).calibration.targets
    for target, name in ((front, "b"), (rear, "a")):
        assert target.flat is not None
        seen_there = pictures[name].ravel()
        assert np.corrcoef(target.flat.response.ravel(), seen_there)[0, 1] > 0.99
    about["targets"] = [seen("middle", 140.0, "a")]
    (flat / "recording.json").write_text(json.dumps(about))
    with pytest.raises(BadInputError, match="flat: has no frame of the targets 'front' and 'rear'"):
        calibrate([open_recording(scan)], open_recording(flat))
