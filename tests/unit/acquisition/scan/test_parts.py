"""The scan's order, its judgement of a node, and its folder; whole: ``tests/system/scan/test_scan.py``."""

import os
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.frames import Blob, frame, light
from support.unit_toml import write_config

from altd.acquisition.scan.folder import DoneNode, ScanFolder
from altd.acquisition.scan.plan import BadNode, NodeSpots, fingerprint, judge, nodes_of
from altd.config import Config, Scan, load_config
from altd.errors import BadInputError
from altd.measuring.pairing import Pair
from altd.recording.header import TargetHeader, UnitHeader
from altd.recording.reader import open_recording
from altd.records import Frame

UNIT = UnitHeader(serial="TEST-1", target_distance_mm=280.0)
START = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
DARK = frame(np.zeros((480, 752)))


def pair(front: Frame, rear: Frame, sequence: int = 0) -> Pair[Frame]:
    items = {
        name: Frame(name, sequence, sequence * 50_000_000, f.pixels)
        for name, f in (("front", front), ("rear", rear))
    }
    return Pair(sequence, sequence * 50_000_000, 0, items, {}, {})


def spot(u_px: float, v_px: float, peak: float = 150.0) -> Frame:
    return frame(light(Blob(u_px, v_px, peak=peak)), np.random.default_rng(0))


def test_serpentine_never_moves_further_than_one_pitch() -> None:
    nodes = nodes_of(Scan(columns=6, rows=5, pitch_mm=25.0))
    assert (nodes[0].x_mm, nodes[0].y_mm) == (-62.5, -50.0)
    assert (nodes[-1].x_mm, nodes[-1].y_mm) == (62.5, 50.0)
    steps = [abs(a.x_mm - b.x_mm) + abs(a.y_mm - b.y_mm) for a, b in pairwise(nodes)]
    assert steps == [25.0] * 29


def test_by_rows_every_node_is_reached_from_the_same_side() -> None:
    scan = Scan(columns=4, rows=4, pitch_mm=20.0, centre_x_mm=5.0, centre_y_mm=-10.0, order="rows")
    nodes = nodes_of(scan)
    for before, after in pairwise(nodes):
        assert after.x_mm > before.x_mm or (after.column == 0 and after.y_mm > before.y_mm)
    assert np.mean([(n.x_mm, n.y_mm) for n in nodes], axis=0) == pytest.approx((5.0, -10.0))
    assert {(n.column, n.row) for n in nodes} == {
        (n.column, n.row) for n in nodes_of(Scan(columns=4, rows=4))
    }


def test_good_exposures_give_the_mean_spots() -> None:
    node = judge([pair(spot(300.0, 200.0), spot(400.0, 210.0)), pair(spot(300.2, 200.0), spot(400.0, 210.4))])
    assert isinstance(node, NodeSpots)
    assert node.px["front"] == pytest.approx((300.1, 200.0), abs=0.05)
    assert node.px["rear"] == pytest.approx((400.0, 210.2), abs=0.05)


@pytest.mark.parametrize(
    ("rear", "complaint"),
    [
        (DARK, "rear spot_missing (nothing is brighter than the background)"),
        (frame(light(Blob(200, 200), Blob(500, 200))), "rear ambiguous (a second spot has "),
        (spot(-4.0, 200.0), "rear cut_by_edge"),
        (spot(403.0, 210.0), "rear unsteady (its exposures lie up to 1.5 px off their mean)"),
    ],
    ids=["dark", "two", "edge", "moved"],
)
def test_a_bad_exposure_is_named_with_its_target_and_reason(rear: Frame, complaint: str) -> None:
    good = spot(400.0, 210.0)
    node = judge([pair(spot(300, 200), good), pair(spot(300, 200), rear)])
    assert isinstance(node, BadNode)
    assert node.complaint.startswith(complaint)


def pipe_at(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def with_nan(path: Path) -> None:
    path.write_text(path.read_text().replace("25.0,", "NaN,", 1))


class TestFolder:
    """A scan of four nodes, interrupted after the first two."""

    FACTS = {"unit.serial": "TEST-1", "scan.pitch_mm": 25.0}  # noqa: RUF012

    TARGETS = (
        TargetHeader(name="front", z_mm=0.0, camera="front"),
        TargetHeader(name="rear", z_mm=280.0, camera="rear"),
    )

    def folder(self, tmp_path: Path, later_s: float = 0.0) -> ScanFolder:
        def utc(t_ns: int) -> datetime:
            return START + timedelta(seconds=later_s + t_ns * 1e-9)

        return ScanFolder(tmp_path / "scan", self.FACTS, utc, targets=self.TARGETS)

    def begin(self, tmp_path: Path) -> ScanFolder:
        folder = self.folder(tmp_path)
        for node in range(2):
            self.add(folder, node)
            folder.commit()
        return folder

    def add(self, folder: ScanFolder, node: int) -> None:
        pairs = [pair(spot(300 + 50 * node, 200), spot(300, 200), 2 * node + k) for k in range(2)]
        folder.keep(pairs, UNIT, "test", (25.0 * node, 0.0))
        folder.state.nodes[f"{node},0"] = DoneNode(position_mm=(25.0 * node, 0.0), spots_px={})

    def test_a_crash_costs_the_node_that_was_under_way_and_no_more(self, tmp_path: Path) -> None:
        folder = self.begin(tmp_path)
        self.add(folder, 2)  # written, but not committed
        folder.close()
        with (folder.path / "frames.csv").open("a") as table:
            table.write("6,0.3,fro")  # torn
        (folder.path / "scan.new").write_text("{")
        again = self.folder(tmp_path, later_s=3600.0)
        assert again.resumed
        assert list(again.state.nodes) == ["0,0", "1,0"]
        self.add(again, 2)
        assert not (tmp_path / "scan").exists()
        again.finish()
        recording = open_recording(tmp_path / "scan")
        assert [row.sequence for row in recording.rows if row.camera == "rear"] == [0, 1, 2, 3, 4, 5]
        assert [row.position_mm for row in [*recording.rows][::4]] == [(0, 0), (25, 0), (50, 0)]
        # the pause counts: t_s is true against the start
        assert [*recording.rows][8].t_s == pytest.approx(3600.2, abs=0.001)
        assert recording.header.start == START
        assert recording.header.kind == "scan"
        assert recording.header.targets == self.TARGETS
        assert not (tmp_path / "scan.unfinished").exists()

    def test_what_was_begun_differently_is_not_mixed(self, tmp_path: Path) -> None:
        self.begin(tmp_path).close()
        with pytest.raises(BadInputError) as caught:
            ScanFolder(tmp_path / "scan", self.FACTS | {"scan.pitch_mm": 20.0}, lambda _: None)
        assert "scan.unfinished: was begun with scan.pitch_mm = 25.0, now it is 20.0" in str(caught.value)

    @pytest.mark.parametrize(
        ("spoil", "said"),
        [
            (
                lambda path: (path / "rear/000001.png").unlink(),
                "frames.csv: row 5: rear/000001.png: No such file",
            ),
            (lambda path: pipe_at(path / "scan.json"), "scan.json: is a pipe, not a file"),
            (lambda path: pipe_at(path / "frames.csv"), "frames.csv: is a pipe, not a file"),
            (lambda path: with_nan(path / "scan.json"), "scan.json: is not a record of a scan"),
        ],
        ids=["a frame is gone", "the record is a pipe", "the table is a pipe", "a number is none"],
    )
    def test_what_cannot_go_on_is_named(
        self, tmp_path: Path, spoil: Callable[[Path], object], said: str
    ) -> None:
        folder = self.begin(tmp_path)
        folder.close()
        spoil(folder.path)
        with pytest.raises(BadInputError, match=said):
            self.folder(tmp_path)

    def test_cameras_of_another_size_are_refused(self, tmp_path: Path) -> None:
        self.begin(tmp_path).close()
        small = frame(np.zeros((240, 320)))
        folder = self.folder(tmp_path)
        with pytest.raises(BadInputError, match="cameras of another size"):
            folder.keep([pair(small, small)], UNIT, "test", None)

    def test_a_used_folder_and_a_broken_record_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "scan").mkdir()
        (tmp_path / "scan" / "something").touch()
        with pytest.raises(BadInputError, match="is not an empty folder"):
            self.folder(tmp_path)
        (tmp_path / "scan" / "something").unlink()
        self.begin(tmp_path).finish()  # an empty folder does
        assert len(open_recording(tmp_path / "scan").rows) == 8
        (tmp_path / "scan").rename(tmp_path / "scan.unfinished")
        (tmp_path / "scan.unfinished" / "scan.json").write_text("{")
        with pytest.raises(BadInputError, match="is not a record of a scan"):
            self.folder(tmp_path)


def test_the_port_and_the_speed_may_change_but_not_the_coordinates(tmp_path: Path) -> None:
    def config(stage: str, scan: str = "") -> Config:
        more = f'[stage]\ndriver = "grbl"\n{stage}\n[scan]\n{scan}\n'
        return load_config(write_config(tmp_path / "altd.toml", Path("cal.json"), Path("rec"), more))

    first = fingerprint(config('device = "/dev/ttyUSB0"'))
    assert fingerprint(config('device = "/dev/ttyUSB1"\nfeed_mm_per_min = 5.0')) == first
    assert fingerprint(config('device = "/dev/ttyUSB0"', "settle_s = 2.0\nretries = 9")) == first
    assert fingerprint(config('device = "/dev/ttyUSB0"', "exposures = 9")) != first
    assert fingerprint(config('device = "/dev/ttyUSB0"\noffset_x_mm = 1.0')) != first
