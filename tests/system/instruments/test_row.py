"""The row of glass targets on recordings: a step in the first round, faults by name, and disturbances."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.cli import altd_here, refusal
from support.row import Monitored, Monitoring, calibrated, drifting, monitored, stepping

from altd.calibration.file import save_calibration
from altd.config import RowSettings
from hw_sim.beam import BeamPose
from hw_sim.row.record import record_rounds
from hw_sim.row.row import Row, RowConfig

ROUND_S = 5 * (0.5 + 4 / 20.0)
FINAL_SEEDS = (501, 502, 503, 504, 505)
"""Nothing was tuned on these."""
STEP_MM = (0.32, -0.24)
STEP_ROUND = 10
ROUNDS = 20


def in_round(number: int) -> float:
    """The time just before a round begins."""
    return number * ROUND_S - 0.01


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Monitored]:
    """Five rows over 60 m: t3 moves by 0.4 mm while the beam drifts by 2 mm and 0.1 mrad."""
    config = RowConfig(
        beam=drifting(ROUNDS * ROUND_S), places={"t3": stepping(in_round(STEP_ROUND), STEP_MM)}
    )
    settings = RowSettings(stable=("t1", "t5"), baseline_rounds=4)
    return {
        seed: Monitoring(replace(config, seed=seed), ROUNDS, settings, {"own_only": True}).run(
            tmp_path_factory.mktemp("stepped")
        )
        for seed in FINAL_SEEDS
    }


def test_a_step_is_found_in_the_first_round_and_no_other_place_moves(stepped: dict[int, Monitored]) -> None:
    for rounds in stepped.values():
        assert [line["valid"] for line in rounds.lines] == [True] * ROUNDS
        assert all(rounds.target(number, "t3")["dx_mm"] is None for number in range(4))
        first = rounds.target(STEP_ROUND, "t3")
        assert first["significance"] > 10
        assert np.hypot(first["dx_mm"] - STEP_MM[0], first["dy_mm"] - STEP_MM[1]) < 0.05
        assert np.abs(rounds.errors(("t1", "t2", "t3", "t4", "t5"), 4)[:, :2]).max() < 0.05
        others = [
            rounds.target(number, name)["significance"]
            for number in range(4, ROUNDS)
            for name in ("t2", "t4")
        ]
        assert max(others) < 4.5


def test_the_displacements_sigma_is_honest(stepped: dict[int, Monitored]) -> None:
    errors = np.concatenate([rounds.errors(("t2", "t3", "t4"), 4) for rounds in stepped.values()])
    ratio = float(np.sqrt(np.mean((errors[:, :2] / errors[:, 2:]) ** 2)))
    rms_mm = float(np.sqrt(np.mean(errors[:, :2] ** 2)))
    print(f"rms {rms_mm:.4f} mm, error/sigma {ratio:.2f}, {len(errors)} displacements")
    assert rms_mm < 0.02
    assert 0.8 <= ratio <= 1.25


FAULTS: dict[str, tuple[dict[str, Any], str, set[str], set[str]]] = {
    # name: (what is wrong, what is named, targets still measured, targets that must be invalid)
    "stuck opaque": ({"stuck": {"t3": "opaque"}}, "t3_stuck_opaque", {"t1", "t2"}, {"t4", "t5"}),
    "first stuck opaque": (
        {"stuck": {"t1": "opaque"}},
        "t1_stuck_opaque",
        {"t1"},
        {"t2", "t3", "t4", "t5"},
    ),
    "stuck clear": ({"stuck": {"t3": "clear"}}, "t3_stuck_clear", {"t1", "t2", "t4", "t5"}, {"t3"}),
    "last stuck clear": ({"stuck": {"t5": "clear"}}, "t5_stuck_clear", {"t1", "t2", "t3", "t4"}, {"t5"}),
    "beam lost": ({"lost_behind": "t2"}, "t2_beam_lost_behind", {"t1", "t2"}, {"t3", "t4", "t5"}),
    "beam lost at the end": ({"lost_behind": "t4"}, "t4_beam_lost_behind", {"t1", "t4"}, {"t5"}),
}


@pytest.mark.parametrize("first", [0, 3], ids=["from the start", "later"])
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named(tmp_path: Path, name: str, first: int) -> None:
    wrong, named, good, bad = FAULTS[name]
    if name == "last stuck clear" and not first:
        pytest.skip("the last glass shows its haze alone from the start: nothing tells (docs/chain.md)")
    rounds = monitored(tmp_path, rounds=first + 2, fault_s=max(in_round(first), 0.0), **wrong)
    last = rounds.lines[-1]
    assert named in last["status"]
    culprits = {code for code in last["status"] if code.endswith(("opaque", "clear", "behind", "confirmed"))}
    assert culprits == {named}
    assert good <= {target for target, of in last["targets"].items() if of["valid"]}
    for target in bad:
        of = last["targets"][target]
        assert (of["valid"], of["x_mm"], of["dx_mm"], of["sigma"]["x_mm"]) == (False, None, None, None)
        assert of["status"]
    if first:
        assert named not in rounds.lines[first - 1]["status"]


def test_a_slow_glass_and_a_late_switch_are_not_settled(tmp_path: Path) -> None:
    slow = monitored(tmp_path / "slow", rounds=4, slow={"t3": 12.0})
    assert "t3_slow" in slow.lines[2]["status"]
    assert not slow.target(2, "t3")["valid"]
    assert slow.target(2, "t2")["valid"]
    late = Monitoring(rounds=4, recorded={"settle_s": 0.0}).run(tmp_path / "late")
    assert not any(late.target(2, name)["valid"] for name in ("t1", "t2", "t3", "t4"))
    assert {"t1_slow", "t2_slow", "t3_slow"} <= late.statuses(2)


def test_a_glass_that_switches_unseen_is_not_confirmed(tmp_path: Path) -> None:
    """The camera of t3 looks at a cover; the beam behind it goes and comes as the glass switches."""

    def cover(path: Path) -> None:
        rng = np.random.default_rng(3)
        for file in sorted((path / "t3").iterdir()):
            dark = np.clip(np.rint(rng.normal(8.0, 1.0, (240, 320))), 0, 255).astype(np.uint8)
            cv2.imwrite(str(file), dark)

    rounds = Monitoring(rounds=4, spoil=cover).run(tmp_path)
    assert "t3_not_confirmed" in rounds.lines[2]["status"]
    assert not rounds.target(2, "t3")["valid"]
    assert rounds.target(2, "t4")["valid"]


def test_without_frames_of_clear_glasses_the_switch_is_unseen_and_the_beam_lost_behind(
    tmp_path: Path,
) -> None:
    good = Monitoring(rounds=4, recorded={"own_only": True}).run(tmp_path / "good")
    assert all(of["valid"] for of in good.lines[2]["targets"].values())
    assert {"t1_switch_unseen", "t4_switch_unseen", "t5_switch_unseen"} <= good.statuses(2)
    stuck = replace(RowConfig(), stuck={"t3": "opaque"})
    bad = Monitoring(stuck, rounds=4, recorded={"own_only": True}).run(tmp_path / "bad")
    assert "t3_beam_lost_behind" in bad.lines[2]["status"]


def test_a_dim_laser_is_no_fault_of_the_glasses_and_a_dead_switch_is(tmp_path: Path) -> None:
    dim = monitored(tmp_path / "dim", rounds=6, laser_share=0.25, fault_s=in_round(3))
    assert all(of["valid"] and not of["status"] for of in dim.lines[5]["targets"].values())
    assert np.abs(dim.errors(("t2", "t3", "t4"), 2)[:, :2]).max() < 0.05
    stuck = {f"t{number}": "clear" for number in range(1, 6)}
    clear = monitored(tmp_path / "clear", rounds=9, stuck=stuck, fault_s=in_round(5))
    assert not clear.lines[7]["valid"]
    assert all(of["status"] == ["stuck_clear"] for of in clear.lines[7]["targets"].values())


@pytest.mark.parametrize("name", ["t4", "t5"])
def test_a_lamp_that_looks_like_the_spot_gives_no_place(tmp_path: Path, name: str) -> None:
    """The camera sees a spot of the beam's size and light in every exposure."""
    row = Row(RowConfig(seed=1))

    def lamp(path: Path) -> None:
        for file in sorted((path / name).iterdir()):
            cv2.imwrite(str(file), np.asarray(row.picture(name, (4.0, -3.0), 0.9)))

    rounds = Monitoring(rounds=4, spoil=lamp).run(tmp_path)
    assert not any(line["targets"][name]["valid"] for line in rounds.lines)
    assert rounds.target(2, "t3")["valid"]


def test_swapped_cameras_give_no_place(tmp_path: Path) -> None:
    rounds = monitored(tmp_path, rounds=4, swapped=("t2", "t4"))
    for name in ("t2", "t4"):
        of = rounds.target(2, name)
        assert not of["valid"]
        assert {"wrong_camera", "cameras_swapped"} & set(of["status"])
    assert rounds.target(2, "t3")["valid"]


def edit_rows(path: Path, change: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> None:
    table = path / "frames.csv"
    with table.open(newline="") as file:
        reader = csv.DictReader(file)
        names, rows = list(reader.fieldnames or ()), list(reader)
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(change(rows))


def test_a_frozen_camera_gives_no_place(tmp_path: Path) -> None:
    """From round 2 on the camera of t2 repeats its last picture in which the glass was opaque."""

    def freeze(path: Path) -> None:
        def frozen(rows: list[dict[str, str]]) -> list[dict[str, str]]:
            own = [row for row in rows if row["camera"] == "t2" and row["opaque"] == "t2"]
            last = own[2 * 4 - 1]
            for row in rows:
                if row["camera"] == "t2" and int(row["sequence"]) > int(last["sequence"]):
                    row["file"] = last["file"]
            return rows

        edit_rows(path, frozen)

    rounds = Monitoring(rounds=5, spoil=freeze).run(tmp_path)
    assert rounds.target(1, "t2")["valid"]
    for number in (2, 3):
        assert rounds.target(number, "t2")["status"][0] == "frame_repeated"
        assert not rounds.target(number, "t2")["valid"]
        assert rounds.target(number, "t3")["valid"]


def test_a_camera_that_is_lost_leaves_the_other_targets(tmp_path: Path) -> None:
    def lose(path: Path) -> None:
        edit_rows(
            path, lambda rows: [row for row in rows if row["camera"] != "t3" or int(row["sequence"]) < 40]
        )

    rounds = Monitoring(rounds=6, spoil=lose).run(tmp_path)
    assert len(rounds.lines) == 6
    assert rounds.target(4, "t3")["status"] == ["camera_silent"]
    assert abs(rounds.target(4, "t4")["dx_mm"]) < 0.05


def test_a_beam_that_jumps_within_a_round_moves_no_place(tmp_path: Path) -> None:
    """The laser is knocked by 0.5 mm and 0.03 mrad between t1 and t3 of round 4: t3, t4 see it first."""
    knocked_s = 4 * ROUND_S + 0.9

    def beam(t_s: float) -> BeamPose:
        return BeamPose(0.5, 0.3, 3e-5, -2e-5) if t_s > knocked_s else BeamPose(0.0, 0.0)

    rounds = Monitoring(RowConfig(beam=beam), 9, recorded={"own_only": True}).run(tmp_path)
    errors = rounds.errors(("t2", "t3", "t4"), 2)
    assert np.max(np.abs(errors[:, :2]) / errors[:, 2:]) < 4.0
    assert (
        max(
            rounds.target(number, name)["significance"]
            for number in range(2, 9)
            for name in ("t2", "t3", "t4")
        )
        < 4.0
    )
    assert np.abs(rounds.errors(("t2", "t3", "t4"), 7)[:, :2]).max() < 0.05


def test_light_scattered_by_a_neighbour_is_no_spot(tmp_path: Path) -> None:
    """Behind t2, stuck opaque, the camera of t3 sees a glow 40 mm wide, off the beam."""

    def glow(path: Path) -> None:
        rng = np.random.default_rng(4)
        v, u = np.mgrid[0:240, 0:320]
        bright = 35.0 * np.exp(-2.0 * ((u - 190.0) ** 2 + (v - 100.0) ** 2) / 70.0**2)
        for file in sorted((path / "t3").iterdir()):
            counts = 8.0 + bright + rng.normal(0.0, 1.2, bright.shape)
            cv2.imwrite(str(file), np.clip(np.rint(counts), 0, 255).astype(np.uint8))

    config = RowConfig(stuck={"t2": "opaque"}, fault_s=0.0)
    rounds = Monitoring(config, rounds=5, spoil=glow).run(tmp_path)
    assert not rounds.target(3, "t3")["valid"]
    assert "t2_stuck_opaque" in rounds.lines[3]["status"]


@pytest.mark.parametrize("stable", [("t1", "t3", "t5"), ("t1", "t2", "t3", "t5")])
def test_a_stable_target_that_moved_is_detected(tmp_path: Path, stable: tuple[str, ...]) -> None:
    config = RowConfig(places={"t3": stepping(in_round(3), (0.3, 0.0))})
    settings = RowSettings(stable=stable, baseline_rounds=2)
    rounds = Monitoring(config, 6, settings, {"own_only": True}).run(tmp_path)
    assert "stable_targets_disagree" not in rounds.lines[2]["status"]
    for number in (4, 5):
        if len(stable) == 3:  # detected; which one is not known
            assert "stable_targets_disagree" in rounds.lines[number]["status"]
            assert all(of["dx_mm"] is None for of in rounds.lines[number]["targets"].values())
        else:
            assert "t3_stable_moved" in rounds.lines[number]["status"]
            assert abs(rounds.target(number, "t3")["dx_mm"] - 0.3) < 0.05
            assert abs(rounds.target(number, "t4")["dx_mm"]) < 0.05


def test_the_unknown_movement_of_the_beam_is_in_sigma(tmp_path: Path) -> None:
    config = RowConfig(beam=drifting(8 * ROUND_S))
    for stable, warning in ((("t1",), "beam_angle_unknown"), ((), "beam_drift_unknown")):
        settings = RowSettings(stable=stable, baseline_rounds=2)
        rounds = Monitoring(config, 8, settings, {"own_only": True}).run(tmp_path / f"{len(stable)}")
        assert warning in rounds.lines[6]["status"]
        errors = rounds.errors(("t2", "t3", "t4", "t5"), 6)
        assert np.abs(errors[:, 0]).max() > 0.5
        assert 0.5 < np.sqrt(np.mean((errors[:, 0] / errors[:, 2]) ** 2)) < 2.0


def test_a_stable_target_that_is_lost_leaves_what_the_other_tells(tmp_path: Path) -> None:
    rounds = monitored(tmp_path, rounds=6, lost_behind="t4", fault_s=in_round(3))
    assert "beam_angle_unknown" in rounds.lines[5]["status"]


def test_a_day_of_creep_is_found_and_sized(tmp_path: Path) -> None:
    """24 h at the level of frames, a round each half hour: t3 creeps by 0.05 mm a day.

    The beam follows the day's temperature by ±0.25 mm and ±0.01 mrad.
    """
    day_s, rounds = 86_400.0, 48

    def beam(t_s: float) -> BeamPose:
        swing = np.sin(2.0 * np.pi * t_s / day_s)
        return BeamPose(0.25 * swing, -0.15 * swing, 1e-5 * swing, 0.5e-5 * swing)

    def creep(t_s: float) -> tuple[float, float]:
        return 0.05 * t_s / day_s, 0.0

    settings = RowSettings(stable=("t1", "t5"), exposures=2, alarm_mm_per_day=0.03)
    recorded = {"exposures": 2, "own_only": True, "pause_s": day_s / rounds - 5 * 0.6}
    day = Monitoring(RowConfig(seed=506, beam=beam, places={"t3": creep}), rounds, settings, recorded).run(
        tmp_path
    )
    last = day.target(-1, "t3")
    sigma = last["sigma"]["dx_mm_per_day"]
    print(f"creep {last['dx_mm_per_day']:.4f} ± {sigma:.4f} mm a day")
    assert sigma < 0.012
    assert abs(last["dx_mm_per_day"] - 0.05) < min(3.0 * sigma, 0.02)
    assert "alarm_rate" in last["status"]
    for name in ("t2", "t4"):
        assert not any("alarm_rate" in line["targets"][name]["status"] for line in day.lines)


def test_replay_and_check_config_on_the_command_line(tmp_path: Path) -> None:
    row = Row(RowConfig(seed=1, places={"t3": stepping(in_round(4), STEP_MM)}))
    record_rounds(tmp_path / "rounds", row, 6)
    calibration = tmp_path / "chain.json"
    save_calibration(calibrated(1), calibration)
    config = tmp_path / "altd.toml"
    settings = 'stable = ["t1", "t5"]\nbaseline_rounds = 3\nalarm_mm = 0.3'
    config.write_text(row_toml(row.config, calibration, settings))
    replayed = altd_here("replay", tmp_path / "rounds", "--calibration", calibration, "--config", config)
    assert (replayed.status, len(replayed.objects)) == (0, 6)
    table = tmp_path / "rounds.csv"
    again = ("--calibration", calibration, "--config", config, "--format", "csv", "-o", table)
    assert altd_here("replay", tmp_path / "rounds", *again).status == 0
    with table.open(newline="") as file:
        line = list(csv.DictReader(file))[5]
    of = replayed.objects[5]["targets"]["t3"]
    assert [float(line[f"t3_{key}"]) for key in ("x_mm", "dx_mm")] == [of["x_mm"], of["dx_mm"]]
    assert float(line["sigma_t3_dx_mm"]) == of["sigma"]["dx_mm"]
    assert "places of a row are not drawn" in refusal(
        altd_here("replay", tmp_path / "rounds", *again, "--plot", tmp_path / "plot.svg")
    )
    before, after = replayed.objects[3], replayed.objects[5]
    assert replayed.objects[2]["targets"]["t3"]["dx_mm"] is None
    assert abs(before["targets"]["t3"]["dx_mm"]) < 0.05
    assert "t3_alarm_displacement" in after["status"]
    assert "t3_alarm_displacement" not in before["status"]
    checked = altd_here("check-config", config)
    assert checked.status == 0
    assert "t5: 0.2840 mW, 0.73^4 of 1 mW" in checked.out
    config.write_text(row_toml(row.config, calibration, "laser_mw = 0.05"))
    checked = altd_here("check-config", config)
    assert checked.status == 2
    assert "t4, t5: less than chain.min_mw, 0.02 mW" in checked.err
    contradicting = tmp_path / "rounds"
    edit_rows(contradicting, lambda rows: [rows[0], rows[1] | {"opaque": "t2"}, *rows[2:]])
    refused = altd_here("replay", contradicting, "--calibration", calibration)
    assert refused.status == 2
    assert "row 3: opaque 't2' is not that of the same exposure in row 2, 't1'" in refused.err


def row_toml(config: RowConfig, calibration: Path, settings: str) -> str:
    text = f'[unit]\nserial = "{config.serial}"\ncalibration = "{calibration}"\n'
    text += f'instrument = "chain"\n[chain]\n{settings}\n'
    for name, z_mm in zip(config.names, config.z_mm, strict=True):
        text += f'[[targets]]\nname = "{name}"\nz_mm = {z_mm}\ncamera = "{name}"\n'
        text += f'[cameras.{name}]\ndriver = "recording"\npath = "rounds"\n'
    return text


def test_the_simulators_command_writes_a_row_that_altd_measures(tmp_path: Path) -> None:
    """The way of docs/chain.md."""
    folder = tmp_path / "row"
    assert altd_here("chain", "-o", folder, "--rounds", 12, module="hw_sim").status == 0
    calibration, settings = folder / "chain.json", folder / "altd.toml"
    assert altd_here("calibrate", *sorted(folder.glob("scan-*")), "-o", calibration).status == 0
    replayed = altd_here("replay", folder / "rounds", "--calibration", calibration, "--config", settings)
    alarms = ["t3_alarm_displacement" in line["status"] for line in replayed.objects]
    assert alarms == [False] * 6 + [True] * 6
    assert "exists and is not an empty folder" in refusal(altd_here("chain", "-o", folder, module="hw_sim"))
    stuck = altd_here("chain", "-o", tmp_path / "other", "--stuck", "t9=opaque", module="hw_sim")
    assert "possible: t1=opaque to t5=clear" in refusal(stuck)
    assert not (tmp_path / "other").exists()
