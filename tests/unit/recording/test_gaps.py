import random
from pathlib import Path

import pytest
from support.cli import altd_here
from support.played_unit import PlayedUnit

from altd.recording.frames_table import FrameLine
from altd.recording.reader import gaps

CAMERAS = ("front", "rear")


def table(*exposures: tuple[int, str]) -> list[FrameLine]:
    """Rows of (sequence, cameras by their first letters), numbered from 2."""
    rows: list[FrameLine] = []
    for sequence, letters in exposures:
        for camera in CAMERAS:
            if camera[0] in letters:
                rows.append(FrameLine(len(rows) + 2, sequence, sequence / 20, camera, "x.png", False, None))
    return rows


def said(rows: list[FrameLine], cameras: tuple[str, ...] = CAMERAS) -> list[str]:
    return [str(gap) for gap in gaps(rows, cameras)]


@pytest.mark.parametrize(
    ("exposures", "expected"),
    [
        ([(n, "fr") for n in range(5)], []),
        ([(n, "fr") for n in range(7, 12)], []),
        ([(0, "fr"), (1, "f"), (2, "fr")], ["row 4: sequence 1 has no row of camera 'rear'"]),
        ([(0, "r"), (1, "fr")], ["row 2: sequence 0 has no row of camera 'front'"]),
        ([(0, "fr"), (1, "fr"), (2, "f")], ["row 6: sequence 2 has no row of camera 'rear'"]),
        ([(0, "fr"), (2, "fr")], ["row 4: before it sequence 1 is missing"]),
        ([(0, "fr"), (9, "fr")], ["row 4: before it sequences 1 to 8 are missing"]),
        (
            [(0, "fr"), (1, "f"), (2, "f"), (3, "r"), (5, "r")],
            [
                "row 4: sequences 1 to 2 have no row of camera 'rear'",
                "row 6: sequence 3 has no row of camera 'front'",
                "row 7: before it sequence 4 is missing",
                "row 7: sequence 5 has no row of camera 'front'",
            ],
        ),
    ],
)
def test_what_a_table_lacks(exposures: list[tuple[int, str]], expected: list[str]) -> None:
    assert said(table(*exposures)) == expected


def test_one_camera_behind_the_other_is_no_gap() -> None:
    rows = table(*((n, "fr") for n in range(20)))
    rows.sort(key=lambda row: row.t_s + (0.18 if row.camera == "rear" else 0))
    assert said(rows) == []


def test_all_that_is_taken_away_is_found() -> None:
    """Against a plain count of what is left."""
    random.seed(7)
    rows = table(*((n, "fr") for n in range(300)))
    kept = [row for row in rows if random.random() > 0.2]
    numbers = {camera: {row.sequence for row in kept if row.camera == camera} for camera in CAMERAS}
    either = numbers["front"] | numbers["rear"]
    found: dict[str, set[int]] = {"front": set(), "rear": set()}
    for gap in gaps(kept, CAMERAS):
        for camera in gap.cameras or CAMERAS:
            found[camera] |= set(range(gap.first, gap.last + 1))
    for camera in CAMERAS:
        assert found[camera] == set(range(min(either), max(either) + 1)) - numbers[camera]


@pytest.fixture
def without_rows(played_unit: PlayedUnit, tmp_path: Path) -> Path:
    """The unit's beams, of whose twelve exposures three rows are missing."""
    for picture in played_unit.beams.glob("*.png"):
        (tmp_path / picture.name).symlink_to(picture)
    (tmp_path / "recording.json").write_text((played_unit.beams / "recording.json").read_text())
    rows = (played_unit.beams / "frames.csv").read_text().splitlines()
    del rows[20], rows[10], rows[9]  # the front's of sequence 9, the both of sequence 4
    (tmp_path / "frames.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def test_replay_names_them_and_goes_on(played_unit: PlayedUnit, without_rows: Path) -> None:
    outcome = altd_here("replay", without_rows, "--calibration", played_unit.calibration, "--window", 4)
    place = f"altd replay: {without_rows}/frames.csv"
    assert outcome.err.splitlines() == [
        f"{place}: row 10: before it sequence 4 is missing",
        f"{place}: row 18: sequence 9 has no row of camera 'rear'",
    ]
    assert outcome.status == 0
    assert [line["sequence"] for line in outcome.objects] == [0, 1, 2, 3, *range(5, 12)]


def test_many_are_counted(played_unit: PlayedUnit, without_rows: Path) -> None:
    rows = (played_unit.beams / "frames.csv").read_text().splitlines()
    kept = [rows[0], *(row for row in rows[1:] if "rear" not in row or int(row.split(",")[0]) % 2)]
    (without_rows / "frames.csv").write_text("\n".join(kept) + "\n")
    outcome = altd_here("replay", without_rows, "--calibration", played_unit.calibration)
    assert len(outcome.err.splitlines()) == 4
    assert outcome.err.endswith("frames.csv: 3 more such places; 6 exposures lack a frame in all\n")


def test_a_camera_without_any_row_is_one_line(played_unit: PlayedUnit, without_rows: Path) -> None:
    rows = (played_unit.beams / "frames.csv").read_text().splitlines()
    (without_rows / "frames.csv").write_text("\n".join(row for row in rows if ",rear," not in row) + "\n")
    outcome = altd_here("replay", without_rows, "--calibration", played_unit.calibration)
    assert outcome.err == f"altd replay: {without_rows}/frames.csv: no row of camera 'rear'\n"
    assert all(not line["valid"] for line in outcome.objects)
