"""The baseline of a row in a file: what fits is used, all else is refused with its reason."""

import asyncio
import json
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from support.clock import FakeClock
from support.measurements import measurement_of_row
from support.row import calibrated

from altd.app.baseline import BaselineFile, BaselineKeeper, baseline_path, with_baseline_kept
from altd.app.stored_baseline import store_baseline
from altd.calibration.file import save_calibration
from altd.config import Config, RowSettings, Unit
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from altd.instruments.row.displacement import BaselineMeans
from altd.instruments.row.frames import RowChain
from altd.instruments.row.places import BeamPlace
from altd.measuring.calibration import Calibration, CalibrationFile
from altd.reasons import Reason
from altd.records import Fault
from altd.status.board import Board
from altd.status.health import Health, State

MADE = datetime(2026, 11, 25, 12, 0, tzinfo=UTC)
NAMES = ("t1", "t2", "t3", "t4", "t5")
SETTINGS = RowSettings(stable=("t1", "t5"))


def place(x_mm: float) -> BeamPlace:
    matrix = np.array([[4e-6, 1e-6], [1e-6, 9e-6]])
    return BeamPlace(
        77, 4, np.array([x_mm, -2.5]), matrix, 3.0 * matrix, 1e-6, 2.5, 0.28 * np.eye(2), (0.01, -0.02)
    )


MEANS = BaselineMeans(
    {name: place(number) for number, name in enumerate(NAMES)},
    {name: {"t1": place(0.25), "t5": place(4.25)} for name in NAMES},
)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return replace(calibrated(1), file=CalibrationFile("0" * 64, "abc"))


@pytest.fixture
def file(tmp_path: Path, calibration: Calibration) -> BaselineFile:
    return BaselineFile(tmp_path / "baseline.json", calibration, SETTINGS)


@pytest.mark.parametrize("simulated", [False, True])
def test_a_stored_baseline_comes_back_whole(file: BaselineFile, simulated: bool) -> None:
    assert file.load() is None
    file.save(MEANS, MADE, simulated)
    means = file.load()
    assert means.simulated is simulated
    assert list(means.own) == list(NAMES)
    back, stored = means.stable["t3"]["t5"], MEANS.stable["t3"]["t5"]
    assert (back.frames, back.excess_mm2, back.spot_sigma_mm, back.stretch) == (4, 1e-6, 2.5, (0.01, -0.02))
    for key in ("mm", "random_mm2", "covariance_mm2", "mm_per_px"):
        assert np.array_equal(getattr(back, key), getattr(stored, key))


def edited(file: BaselineFile, change: Callable[[dict[str, Any]], object]) -> None:
    """A change with a checksum that fits."""
    file.save(MEANS, MADE, simulated=False)
    document = json.loads(file.path.read_text())
    del document["checksum"]
    change(document)
    document["checksum"] = checksum_of(document)
    file.path.write_text(json.dumps(document))


CHANGES: tuple[tuple[Callable[[dict[str, Any]], object], str], ...] = (
    (lambda of: of.update(format="altd-baseline/2"), "is no altd-baseline/1"),
    (lambda of: of.update(unit="ROW-9"), "is of unit 'ROW-9'"),
    (lambda of: of.update(calibration="abd"), "is of another calibration"),
    (lambda of: of["own"].update(t9=of["own"]["t1"]), "has target 't9', which is not in the calibration"),
    (lambda of: of["stable"]["t3"].pop("t5"), "'t5' was not a stable target then"),
    (lambda of: of["own"]["t2"].update(mm=[1.0, float("nan")]), "own.t2.mm.1: Input should be"),
    (lambda of: of["own"]["t2"].update(mm=[1.0, 1e300]), "own.t2.mm.1: Input should be"),
    (lambda of: of["own"]["t2"].update(random_mm2=[[1.0, 2.0], [2.0, 1.0]]), "has an invalid covariance"),
    (lambda of: of["own"]["t2"].update(frames=0), "own.t2.frames: Input should be"),
    (lambda of: of.update(origin="guess"), "origin: Input should be"),
    (lambda of: of.update(note="x"), "note: Extra inputs"),
)


@pytest.mark.parametrize(("change", "said"), CHANGES, ids=[said for _, said in CHANGES])
def test_what_does_not_fit_is_refused(
    file: BaselineFile, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    edited(file, change)
    with pytest.raises(BadInputError) as refused:
        file.load()
    assert str(refused.value).startswith(f"{file.path}: {said}")


def test_a_stable_target_that_was_left_out_is_no_reason_to_refuse(file: BaselineFile) -> None:
    def leave_out(document: dict[str, Any]) -> None:
        del document["own"]["t5"], document["stable"]["t5"]
        for of in document["stable"].values():
            del of["t5"]

    edited(file, leave_out)
    means = file.load()
    assert "t5" not in means.own
    assert set(means.stable["t3"]) == {"t1"}


def test_damage_is_refused(file: BaselineFile) -> None:
    file.save(MEANS, MADE, simulated=False)
    whole = file.path.read_text()
    for damaged in ("", "[]", "{", whole[: len(whole) // 2], whole.replace("4.25", "4.35", 1)):
        file.path.write_text(damaged)
        with pytest.raises(BadInputError):
            file.load()


def test_without_a_place_to_keep_it_a_row_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = Config(unit=Unit(serial="ROW-1", calibration=Path("c.json"), instrument="chain"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with pytest.raises(BadInputError, match="a restart would reset the baseline to zero"):
        with_baseline_kept(config, tmp_path / "altd.toml")
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    kept = with_baseline_kept(config, tmp_path / "altd.toml")
    assert kept.chain.baseline == baseline_path(config, tmp_path)


class _Chain:
    baseline: BaselineMeans | None = None


@pytest.mark.parametrize(
    ("reasons", "origin"), [((), "camera"), ((Reason.SIMULATED,), "simulated"), ((Reason.PLAYBACK,), None)]
)
async def test_the_first_rounds_baseline_is_written_and_that_of_a_played_recording_not(
    file: BaselineFile, reasons: tuple[Reason, ...], origin: str | None
) -> None:
    clock, chain = FakeClock.of_loop(), _Chain()
    component = Health(clock).component("baseline")
    measured = measurement_of_row(NAMES, status=tuple(map(Fault, reasons)))
    board = Board(clock, 10.0, measured.quantities, rehearsal=True)
    keeper = BaselineKeeper(cast("RowChain", chain), board, file, component)
    task = asyncio.create_task(keeper.run())
    board.publish(measured)
    await clock.advance(0.1)
    assert not file.path.exists()
    chain.baseline = MEANS
    board.publish(measured)
    await saved(task.done)
    clock.end()
    assert component.state is State.OK
    assert (file.path.exists() and json.loads(file.path.read_text())["origin"]) == (origin or False)


def test_a_baseline_is_renamed_before_the_daemon_makes_another(
    calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    save_calibration(replace(calibration, file=None), tmp_path / "cal.json")
    serial = calibration.unit_serial
    unit = Unit(serial=serial, calibration=tmp_path / "cal.json", instrument="chain")
    config = Config(unit=unit, chain=SETTINGS)
    path = baseline_path(config, tmp_path)
    path.write_text("of old")
    with pytest.raises(BadInputError, match="--replace renames it"):
        store_baseline(config, tmp_path / "altd.toml", None, replace=False)
    renamed, then = store_baseline(config, tmp_path / "altd.toml", None, replace=True)
    assert not path.exists()
    assert Path(renamed.removeprefix("renamed: ")).read_text() == "of old"
    assert then == f"restart altd: its first 5 rounds make the baseline, {path}"


async def saved(is_so: Callable[[], bool]) -> None:
    """Wait for the thread that saves: the clock of the test does not."""
    while not is_so():
        time.sleep(0.001)  # noqa: ASYNC251  the loop's time is the test's
        await asyncio.sleep(0)


async def test_a_full_disk_is_told_and_retried(file: BaselineFile, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, chain = FakeClock.of_loop(), _Chain()
    component = Health(clock).component("baseline")
    measured = measurement_of_row(NAMES)
    board = Board(clock, 10.0, measured.quantities)
    away = replace(file, path=file.path.parent / "away" / "baseline.json")
    task = asyncio.create_task(BaselineKeeper(cast("RowChain", chain), board, away, component).run())
    await clock.advance(0.1)
    chain.baseline = MEANS
    board.publish(measured)
    await saved(lambda: component.state is State.FAILED)
    assert "trying again" in component.message
    away.path.parent.mkdir()
    await clock.advance(10.1)
    await saved(task.done)
    clock.end()
    assert away.load() is not None
    assert component.state is State.OK
