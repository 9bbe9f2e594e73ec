"""The demo's kept data, and the commands that it prints, pasted unchanged."""

import json
import re
import shlex
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.cli import altd
from support.foreign import need_program

from tools.pictures.terminal import terminal

pytestmark = pytest.mark.alone


def pasted(command: str) -> str:
    """The output of a command in another shell, in another folder."""
    return subprocess.run(
        ["sh", "-c", command], cwd="/", check=True, capture_output=True, text=True, timeout=200
    ).stdout


def get(address: str, path: str) -> Any:
    with urllib.request.urlopen(f"{address}{path}", timeout=5) as answer:
        return json.load(answer)


def recording_of(address: str, why: str) -> Any:
    """The recording of a fault; a busy machine adds some of its own."""
    recordings = get(address, "/api/v1/recordings")["recordings"]
    return next((kept for kept in recordings if kept["why"].startswith(why)), None)


def until(found: Callable[[], Any], timeout_s: float = 90.0) -> Any:
    deadline_s = time.monotonic() + timeout_s
    while not (value := found()):
        assert time.monotonic() < deadline_s
        time.sleep(0.2)
    return value


def told_of(events: str, recording: str) -> str | None:
    """The command's list of the events, once the history holds this one: it is written now and then."""
    told = pasted(events)
    return told if re.search(rf"^\S+ recording .*{re.escape(recording)}$", told, re.MULTILINE) else None


def test_a_fault_of_the_demo_is_seen_in_events_watched_and_replayed(unit_3: Path) -> None:
    need_program("tmux")
    calibration = unit_3 / "cal.json"
    demo = shlex.join(
        [sys.executable, "-m", "hw_sim", "demo", "--seed", "3", "--calibration", str(calibration)]
    )
    with terminal(f"env TMPDIR=/tmp {demo}; sleep 100", 80, 24) as screen:
        screen.await_text("VALID, mean of 20 exposures; simulated", 60.0)
        text = screen.text()
        address = re.search(r"browser +(http://127.0.0.1:\d+)/", text)
        watch = re.search(r"terminal +(cd .*)", text)
        events = re.search(r"terminal.*\n +(cd .*)", text)
        assert address is not None
        assert watch is not None
        assert events is not None
        time.sleep(5.0)  # of frames before the fault
        screen.press("b")
        kept = until(lambda: recording_of(address[1], "spot_missing "))

        told = until(lambda: told_of(events[1], f"s of frames are kept: {kept['why']}"))
        for kind, words in (
            ("started", "altd .* started"),
            ("cause_came", "SIMULATED"),
            ("cause_came", "no laser spot"),
        ):
            assert re.search(rf"^\S+ {kind} .*({words})", told, re.MULTILINE), told

        with terminal(watch[1], 80, 24) as watching:
            watching.await_text("SIMULATED", 20.0)
            watching.await_text("no laser spot", 20.0)
            screen.press("c")
            watching.await_text(" VALID", 20.0)

        folder = re.search(r"cd (\S+)", watch[1])
        assert folder is not None
        replayed = pasted(
            f"cd {folder[1]} && ./altd replay recordings/{kept['name']} --calibration {calibration}"
        )
        lines = [json.loads(line) for line in replayed.splitlines()]
        assert any(line["valid"] for line in lines), "what was before the fault"
        assert lines[-1]["valid"] is False
        assert {"front_spot_missing", "rear_spot_missing", "simulated"} <= set(lines[-1]["status"])
        trend = get(address[1], "/api/v1/trend?from=-60&points=60")
        assert sum(trend["n_valid"]) > 0
        screen.press("q")
        screen.await_text("The demo has ended", 20.0)
        until(lambda: not Path(folder[1]).exists())


def test_a_folder_that_is_kept_goes_on_with_the_next_demo(tmp_path: Path, unit_3: Path) -> None:
    folder = tmp_path / "kept"
    for _ in range(2):
        shown = altd(
            "demo", "--seed", "3", "--calibration", unit_3 / "cal.json", "--keep", folder, "--seconds", "4",
            module="hw_sim",
        )  # fmt: skip
        assert (shown.status, shown.err) == (0, "")
    assert {path.name for path in folder.iterdir()} == {"history.db", "history.db.lock", "recordings"}
    told = altd("events", "--history", folder / "history.db", "--format", "jsonl").out
    kinds = [json.loads(line)["kind"] for line in told.splitlines()]
    assert (kinds.count("started"), kinds.count("stopped"), kinds.count("not_ended")) == (2, 2, 0)
