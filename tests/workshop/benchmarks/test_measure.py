"""``make bench`` runs and says all that it promises. How fast anything is belongs to no test."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.cli import altd

from altd.errors import BadInputError
from altd.measuring.calibration import Calibration
from benchmarks.daemon import measure_served
from benchmarks.material import Material, make_pairs
from benchmarks.measure import SERVED


def numbers(value: object) -> Iterator[float]:
    if isinstance(value, dict):
        for inner in value.values():
            yield from numbers(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from numbers(inner)
    elif isinstance(value, int | float):
        yield float(value)


def test_a_quick_run_prints_a_table_and_writes_all_its_figures(tmp_path: Path) -> None:
    written = tmp_path / "bench.json"
    done = altd("--quick", "--json", written, module="benchmarks.measure", timeout_s=470)
    assert (done.status, done.err) == (0, "")
    figures = json.loads(written.read_text())
    assert all(math.isfinite(number) and number >= 0 for number in numbers(figures))

    stages = {stage["name"]: stage for stage in figures["stages"]}
    assert [name for name, stage in stages.items() if not stage["part_of"]] == [
        "memory pass: copy",
        "memory pass: cv2.resize to 1/8",
        "coarse search",
        "fine front",
        "fine rear",
        "fine front, no flat",
        "fine rear, no flat",
        "new frames, both",
        "pairing",
        "motion in step",
        "averaging over 20",
        "mapping, one point",
        "cross-check, one point",
        "beam fit",
        "whole chain",
    ]
    parts = [(stage["part_of"], stage["name"]) for stage in figures["stages"] if stage["part_of"]]
    assert parts[:3] == [("coarse search", part) for part in ("coarse picture", "background", "regions")]
    of_a_spot = ["patch", "judging", "noise", "profile", "misfit"]
    for fine in ("fine front", "fine rear"):
        assert [part for of, part in parts if of == fine] == of_a_spot
    assert all(0 < stage["median_us"] <= stage["p99_us"] for stage in stages.values())
    assert stages["memory pass: copy"]["passes"] == 1
    assert stages["coarse search"]["median_us"] > stages["background"]["median_us"]

    inside = figures["inside_us"]
    *parts_us, whole_us = inside.values()
    assert [sum(of_rate) for of_rate in zip(*parts_us, strict=True)] == pytest.approx(whole_us)
    shared = {name for name in stages if not stages[name]["part_of"]} & inside.keys()
    assert shared == stages.keys() - {part for _, part in parts} - {
        *("memory pass: copy", "memory pass: cv2.resize to 1/8", "fine front, no flat", "fine rear, no flat")
    }

    idle, bare, *served = figures["loads"]
    assert idle["pairs"] == 0
    assert [load["name"] for load in served] == [name for name, _, _ in SERVED]
    for load in (bare, *served):
        assert load["pairs"] == load["latency"]["count"] > 0
        assert load["latency"]["p50_ms"] <= load["latency"]["p99_ms"] <= load["latency"]["max_ms"]
    assert [load["answers"] for load in (bare, *served[:-1])] == [{}] * len(served)
    assert all(served[-1]["answers"][what] > 0 for what in ("modbus answers", "stream events", "telegrams"))

    for load in figures["rates"]["loads"]:
        assert load["pairs"] == load["latency"]["count"] > 0
    assert figures["rates"]["chain_alone"] > 0
    start = figures["start"]
    assert 0 < start["first_answer_s"] <= start["first_valid_s"]
    assert set(figures["machine"]) >= {"cpu", "cores", "python", "numpy", "opencv"}

    for line in (
        "whole chain",
        "no publishers",
        "the chain alone, back to back",
        "altd run, from process",
    ):
        assert line in done.out
    assert done.out.splitlines()[-1].startswith("cpu ")


def test_an_interface_that_cannot_be_made_ends_the_benchmark(
    monkeypatch: pytest.MonkeyPatch, calibration_of_unit_3: Calibration
) -> None:
    """Without asyncua the benchmark waited without end for its child process."""
    monkeypatch.setattr("altd.publish.opcua.publisher.find_spec", lambda name: None)
    material = Material(tuple(make_pairs(2)), calibration_of_unit_3, calibration_of_unit_3)
    with pytest.raises(BadInputError, match="needs asyncua"):
        measure_served(material, "unread", 1.0, has_broker=False, has_clients=False)
