"""``make faults`` judges rightly, runs the whole daemon, and repeats by its seed."""

import json
import math
import weakref
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from altd.errors import BadInputError
from altd.measuring.freshness import FreshnessCheck
from altd.records import FloatArray, Frame
from benchmarks.faults import __main__ as faults
from benchmarks.faults.judging import Judge, Result, error_of_times
from benchmarks.faults.tables import Run, failures
from benchmarks.faults.wires import Published, of_json

ZERO = datetime(2026, 11, 20, 8, 0, tzinfo=UTC)
S = 1_000_000_000
GOOD = {
    "valid": True,
    "time": "2026-11-20T08:00:09.500Z",
    "status": ["simulated"],
    "frames": 20,
    "age_s": 0.5,
    **dict.fromkeys(("x_mm", "y_mm", "yaw_deg", "pitch_deg"), 1.0),
    "sigma": dict.fromkeys(("x_mm", "y_mm", "yaw_deg", "pitch_deg"), 0.02),
}
BLANK = dict.fromkeys(("x_mm", "y_mm", "yaw_deg", "pitch_deg"))
NO_SPOT = {**GOOD, **BLANK, "valid": False, "sigma": BLANK, "status": ["front_spot_missing"]}


def shown(wire: str, message: dict[str, Any]) -> Published:
    return of_json(wire, json.dumps(message).encode())


def judged(message: dict[str, Any], wire: str = "http") -> Result:
    """The judgement of one message at 10 s; the truth is 1 in every quantity."""

    def error_of(one: Published, t_ns: float, now_ns: int) -> FloatArray:
        assert one.values is not None
        return np.abs(one.values - 1.0)

    judge = Judge(error_of, 0.0, 1e18)
    judge.take([shown(wire, message)], 10 * S, ZERO)
    return judge.result


def test_the_error_of_a_fault_of_times_is_that_of_a_permitted_time_or_its_own() -> None:
    """Grease, seed 4, run 143: pitch was wrong by 0.049°; at another time x, y and pitch differed by less."""
    sigma = np.array([0.038, 0.037, 0.024, 0.023])
    own = np.array([0.008, 0.005, 0.002, 0.049])
    other, beyond_5_sigma, right = (
        [0.215, 0.19, 0.005, 0.044],
        [0.149, 0.149, 0.0, 0.0],
        [0.1, 0.0, 0.0, 0.02],
    )
    sharp = np.array([0.02, 0.02, 0.024, 0.023])
    assert error_of_times(np.array([other, own]), own, sigma) is own
    assert error_of_times(np.array([other, beyond_5_sigma]), own, sharp) is own
    assert error_of_times(np.array([other, right, [0.149, 0.0, 0.0, 0.0]]), own, sigma).tolist() == right


@pytest.mark.parametrize(
    ("change", "counted"),
    [
        ({}, {}),
        ({"x_mm": 1.16}, {"beyond_limits": 1, "beyond_sigmas": 1}),
        ({"pitch_deg": 0.969}, {"beyond_limits": 1}),  # 1.6 sigma
        ({"x_mm": 1.11}, {"beyond_sigmas": 1}),  # below the limit
        ({"sigma": BLANK}, {"beyond_sigmas": 1}),
        ({"age_s": 1.7}, {"stale": 1}),
        ({"valid": False}, {"contradicting": 1}),
        ({"yaw_deg": None}, {"contradicting": 1, "no_reason": 1}),
        ({**BLANK, "valid": False, "sigma": BLANK}, {"no_reason": 1}),  # simulated is no reason
    ],
)
def test_what_may_not_be_shown_is_counted(change: dict[str, Any], counted: dict[str, int]) -> None:
    result = judged({**GOOD, **change})
    bad = ("beyond_limits", "beyond_sigmas", "stale", "contradicting", "no_reason")
    assert {name: count for name in bad if (count := getattr(result, name))} == counted
    assert (
        bool(failures(Run(0, "plain", ("fog",), "", "", False, result))) == bool(counted) or result.back_s > 3
    )


def test_an_old_message_that_looks_fresh_is_judged_by_the_time_that_it_states() -> None:
    """One that a wire held for 1.6 s: a telegram has no age, only a time."""
    assert judged({**GOOD, "time": "2026-11-20T08:00:07.900Z"}, "telegram").stale == 1


def test_reason_and_recovery_count_when_all_polled_wires_agree() -> None:
    judge = Judge(lambda one, t_ns, now_ns: np.zeros(4), 10.0 * S, 12.0 * S)
    wires = ("http", "local", "modbus")

    def take(now_s: float, *messages: dict[str, Any]) -> None:
        judge.take([shown(*one) for one in zip(wires, messages, strict=False)], round(now_s * S), ZERO)

    take(10.2, NO_SPOT, NO_SPOT, GOOD)
    assert judge.result.reason_s is None
    take(10.4, NO_SPOT, NO_SPOT, NO_SPOT)
    assert judge.result.reason_s == pytest.approx(0.4)
    take(12.3, GOOD, GOOD, GOOD)
    take(12.4, GOOD, GOOD)  # Modbus does not answer
    assert judge.back_ns is None
    take(12.9, GOOD, GOOD, GOOD)
    assert judge.result.back_s == pytest.approx(0.9)
    assert judge.result.unanswered == 1


def judge_after(*messages: tuple[int, dict[str, Any]]) -> Judge:
    """After these messages on each wire, with their times in s; the fault lasts from 10 s to 12 s."""
    judge = Judge(lambda one, t_ns, now_ns: np.zeros(4), 10.0 * S, 12.0 * S)
    for now_s, message in messages:
        judge.take([shown(wire, message) for wire in ("http", "local", "modbus")], now_s * S, ZERO)
    return judge


@pytest.mark.parametrize(
    ("unit", "messages", "failed"),
    [
        ("dusty", ((9, GOOD), (11, NO_SPOT), (20, NO_SPOT)), True),
        ("dusty", ((9, NO_SPOT), (11, NO_SPOT), (20, NO_SPOT)), False),
        ("plain", ((9, GOOD), (11, NO_SPOT), (13, GOOD), (14, NO_SPOT)), True),  # comes back and goes
    ],
)
def test_a_unit_is_to_measure_again_where_it_measured_before(
    unit: str, messages: tuple[tuple[int, dict[str, Any]], ...], failed: bool
) -> None:
    """Dust lies where the beam meets a plate: there the unit refuses each spot, fault or no fault."""
    run = Run(0, unit, ("inverted",), "", "", False, judge_after(*messages).result)
    assert failures(run) == (["back after inf s"] if failed else [])


@pytest.mark.parametrize(
    ("undisturbed", "back_s"),
    [
        ({}, math.inf),
        ({15: ["front_spot_missing"]}, 3),
        ({15: ["front_spot_missing", "warming_up"]}, math.inf),
        ({14: ["front_spot_missing"]}, math.inf),
    ],
    ids=["measures", "refuses too", "for another reason", "at another time"],
)
def test_a_refusal_counts_as_recovered_only_where_a_unit_without_the_fault_refuses(
    undisturbed: dict[int, list[str]], back_s: float
) -> None:
    judge = judge_after((9, GOOD), (14, NO_SPOT), (15, NO_SPOT))
    judge.time_recovery({now_s * S: frozenset(reasons) for now_s, reasons in undisturbed.items()})
    assert judge.result.back_s == back_s


@pytest.mark.timeout(1200)
def test_a_unit_that_never_recovers_fails_beside_one_without_the_fault(
    units: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stuck = weakref.WeakKeyDictionary[FreshnessCheck, str]()
    compare = FreshnessCheck.repeated

    def repeated_for_ever(self: FreshnessCheck, frame: Frame) -> str:
        if repeated := compare(self, frame):
            stuck.setdefault(self, repeated)
        return stuck.get(self, "")

    monkeypatch.setattr(FreshnessCheck, "repeated", repeated_for_ever)
    assert faults.main(["--runs", "1", "--seed", "1", "--only", "frozen", "--units", "plain"]) == 1
    assert "back after inf s" in capsys.readouterr().out


NAMES = "laser_off,camera_unplugged,port_flood,clock_set"


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A place for the unit's scan and calibration."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ALTD_CAMPAIGN_CACHE", str(tmp_path_factory.mktemp("campaign")))
        yield


@pytest.mark.timeout(1200)
def test_the_daemon_shows_reasons_and_no_wrong_value_and_a_run_repeats_by_its_seed(
    units: None, tmp_path: Path
) -> None:
    """Eight runs: half a minute, and as much for a scan and its calibration."""
    results = [tmp_path / "first", tmp_path / "again"]
    for file in results:
        command = ["--runs", "4", "--seed", "7", "--only", NAMES, "--units", "plain", "--results", str(file)]
        assert faults.main([*command, "--page", str(tmp_path / "page.md")]) == 0
    first, again = ([Run.of_json(line) for line in file.read_text().splitlines()] for file in results)
    assert [run.names for run in first] == [(name,) for name in NAMES.split(",")]
    for one, other in zip(first, again, strict=True):
        assert (one.note, one.result.reason_s, one.result.back_s) == (
            other.note,
            other.result.reason_s,
            other.result.back_s,
        )
        assert one.result.worst_sigmas == pytest.approx(other.result.worst_sigmas)
        assert {"http", "local", "modbus", "telegram"} <= one.result.judged.keys()
    blind = [run for run in first if run.is_blind]
    assert [run.names for run in blind] == [("laser_off",), ("camera_unplugged",)]
    assert all(run.result.reason_s is not None and run.result.reason_s <= 1.0 for run in blind)
    assert all(run.result.valid > 50 and run.result.back_s <= 3.0 for run in first)
    assert "|clock_set|" in (tmp_path / "page.md").read_text()


@pytest.mark.timeout(1200)
def test_a_daemon_that_takes_a_frozen_picture_for_a_new_one_fails(
    units: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(FreshnessCheck, "repeated", lambda self, frame: "")
    assert faults.main(["--runs", "1", "--seed", "1", "--only", "frozen", "--units", "plain"]) == 1
    assert " wrong of " in capsys.readouterr().out


def test_an_unknown_fault_is_bad_input() -> None:
    with pytest.raises(BadInputError, match="--only: unknown fault 'gremlins'; groups are camera, light"):
        faults.main(["--only", "gremlins"])
