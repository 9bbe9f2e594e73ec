"""``make bench`` runs and says all that it promises. How fast anything is belongs to no test."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from support.places import ROOT

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
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.measure", "--quick", "--json", str(written)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
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

    idle, bare, *served = figures["loads"]
    assert idle["pairs"] == 0
    assert [load["name"] for load in served] == [name for name, _, _ in SERVED]
    for load in (bare, *served):
        assert load["pairs"] == load["latency"]["count"] > 0
        assert load["latency"]["p50_ms"] <= load["latency"]["p99_ms"] <= load["latency"]["max_ms"]
    assert [load["answers"] for load in (bare, *served[:-1])] == [{}] * len(served)
    assert all(served[-1]["answers"][what] > 0 for what in ("modbus answers", "stream events", "telegrams"))

    rate = figures["rate"]
    assert rate["held"] < rate["chain_alone"]
    assert rate["pairs"] >= rate["held"] * rate["seconds"] * 0.99
    start = figures["start"]
    assert 0 < start["first_answer_s"] <= start["first_valid_s"]
    assert set(figures["machine"]) >= {"cpu", "cores", "python", "numpy", "opencv"}

    for line in (
        "whole chain",
        "no publishers",
        "highest rate without a lost pair",
        "altd run, from process",
    ):
        assert line in done.stdout
    assert done.stdout.splitlines()[-1].startswith("cpu ")
