"""``altd planar`` on pictures of a plate that the simulated machine with errors drives."""

import csv
import shutil
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from support.cli import altd_here, refusal

from altd.calibration.planar_machine import MachineFile
from altd.config.loading import load_tables
from altd.instruments.planar.machine.kinematics import poses_of
from hw_sim.double_triangle import random_motion, source_machine
from hw_sim.planar import HALF_RANGE, MACHINE_FLAWS

SEED, POSES, UNSEEN = 402, 24, 20
DESIGN = Path(__file__).parents[3] / "config" / "planar-machine.toml"
Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of known poses and of poses that the machine reached, and the calibration."""
    folder = tmp_path_factory.mktemp("machine")
    common = ("planar-recording", "--seed", SEED, "--exposures", 1)
    known = ("--known", 8, "-o", folder / "known")
    driven = ("--known", 0, "--unknown", POSES, "--machine", "-o", folder / "driven")
    for arguments in (known, driven):
        assert altd_here(*common, *arguments, module="hw_sim").status == 0
    assert altd_here("calibrate", folder / "known", "-o", folder / "planar.json").status == 0
    return folder


def planar(
    folder: Path, *recordings: Path, design: Path = DESIGN, output: Path | None = None
) -> tuple[object, ...]:
    files = ("--calibration", folder / "planar.json", "--design", design)
    return ("planar", *recordings, *files, *(() if output is None else ("-o", output)))


def test_the_machine_is_found_and_predicts_poses_that_were_not_recorded(folder: Path, tmp_path: Path) -> None:
    done = altd_here(*planar(folder, folder / "driven", output=tmp_path / "fitted.toml"))
    assert (done.status, done.err) == (0, "")
    assert (tmp_path / "fitted.toml").read_text() == done.out
    assert done.out.startswith(f"# altd planar, SIMULATED: {POSES} poses\n# chi-square ")
    fitted, design = (load_tables(path, MachineFile).machine for path in (tmp_path / "fitted.toml", DESIGN))
    machine = source_machine(MACHINE_FLAWS, SEED)
    moved = [(machine.joints_mm, pose) for pose in islice(random_motion(machine, HALF_RANGE), POSES + UNSEEN)]
    joints, poses = (np.array(each[POSES:]) for each in zip(*moved, strict=True))
    for model, low_mm, high_mm in ((fitted, 0.0, 0.005), (design, 0.3, 1.5)):
        reached = poses_of(model, joints) - poses[:, None]
        errors = reached[range(UNSEEN), np.abs(reached[..., 2]).argmin(axis=1)]
        assert low_mm < np.sqrt(np.mean(errors[:, :2] ** 2)) < high_mm
    again = altd_here(*planar(folder, folder / "driven", design=tmp_path / "fitted.toml"))
    assert [line for line in again.out.splitlines() if line[:1] not in "#"] == [
        line for line in done.out.splitlines() if line[:1] not in "#"
    ]


def test_workspace_and_singular_poses_are_those_of_the_study(folder: Path) -> None:
    """docs/studies/kinematics.md, by its design: 49.2486°, 65.3757°, and type 2 from 32.0° on."""
    said = altd_here(*planar(folder, folder / "driven")).out
    pieces = said.split("# workspace: phi ")[1].splitlines()[0]
    ends = [float(end) for piece in pieces.removesuffix(" deg").split(", ") for end in piece.split(" to ")]
    assert ends[:3] == pytest.approx([-60.0, 49.25, 49.25], abs=1.0)
    type_1 = said.split("type 1, a rail parallel to its edge: phi ")[1].splitlines()[0]
    turns = sorted(float(part.split(" ")[0]) for part in type_1.split(", "))
    assert turns == pytest.approx([49.2486, 65.3757, 65.3757], abs=0.6)
    type_2 = said.split("some poses at phi ")[1]
    assert float(type_2.split(" to ")[0]) == pytest.approx(32.0, abs=1.0)


def copied(folder: Path, to: Path, change: dict[str, str], row: int = 5, without: str = "") -> Path:
    """The driven recording with other fields in a row of its table, or without a column."""
    shutil.copytree(folder / "driven", to)
    with (to / "frames.csv").open() as file:
        lines = list(csv.DictReader(file))
    lines[row - 2] |= change
    with (to / "frames.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, [key for key in lines[0] if key != without], extrasaction="ignore")
        table.writeheader()
        table.writerows(lines)
    return to


@pytest.mark.parametrize(
    ("change", "without", "said"),
    [
        ({}, "joint_2_mm", "frames.csv: row 1: column 'joint_2_mm' is missing"),
        ({"joint_2_mm": "nan"}, "", "frames.csv: row 5: joint_2_mm 'nan' is not a number"),
        (
            {"joint_2_mm": ""},
            "",
            "row 5: joint_1_mm, joint_2_mm, joint_3_mm must all be given or all be empty",
        ),
        ({"joint_2_mm": "20000"}, "", "frames.csv: row 5: joint_2_mm '20000' is larger than 10000"),
        ({"joint_2_mm": "300.1"}, "", "frames.csv: row 5: joints and pose "),
    ],
)
def test_a_wrong_table_is_refused_by_its_row(
    folder: Path, tmp_path: Path, change: dict[str, str], without: str, said: str
) -> None:
    recording = copied(folder, tmp_path / "rec", change, without=without)
    old = tmp_path / "old.toml"
    old.write_text("old")
    assert said in refusal(altd_here(*planar(folder, recording, output=old)))
    assert old.read_text() == "old"


def test_wrong_files_are_refused(folder: Path, tmp_path: Path) -> None:
    known, driven = folder / "known", folder / "driven"
    assert "no row with joint_1_mm, joint_2_mm, joint_3_mm" in refusal(altd_here(*planar(folder, known)))
    said = refusal(altd_here(*planar(folder, driven, design=folder / "planar.json")))
    assert "planar.json: line 1, column 1: not TOML" in said
    (tmp_path / "design.toml").write_text(DESIGN.read_text().replace("rail_deg", "rail", 1))
    said = refusal(altd_here(*planar(folder, driven, design=tmp_path / "design.toml")))
    assert "design.toml: line 7, column 1: legs.0.rail: there is no such key" in said
    twice = refusal(altd_here(*planar(folder, driven, driven)))
    assert f"{driven / 'frames.csv'}: row 2: is the same as {driven / 'frames.csv'}: row 2" in twice
