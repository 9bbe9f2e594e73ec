"""``python -m hw_sim gige`` as a process: what it says, how it ends, and what it refuses."""

import contextlib
import os
import re
import signal
import socket
import subprocess
from itertools import pairwise
from statistics import median

import pytest
from support.cli import altd_here, refusal
from support.gige_unit import client, need_gige, new_addresses, served

from hw_sim.__main__ import main
from hw_sim.gige import libaravis
from hw_sim.gige.loopback import GVCP_PORT


def on_lo(address: str) -> bool:
    shown = subprocess.run(["ip", "address", "show", "dev", "lo"], capture_output=True, text=True, check=True)
    return f" {address}/" in shown.stdout


@pytest.mark.parametrize(
    ("number", "streaming"), [(signal.SIGINT, False), (signal.SIGTERM, False), (signal.SIGTERM, True)]
)
def test_a_signal_ends_it_and_leaves_nothing(number: int, streaming: bool) -> None:
    with contextlib.ExitStack() as clients, served("--seed", "3") as cameras:
        assert on_lo(cameras.front)
        if streaming:
            front = clients.enter_context(client(cameras.front))
            front.start()
            front.frame()
            clients.callback(front.abandon)
        os.kill(cameras.process.pid, number)
        out, err = cameras.process.communicate(timeout=30)
    assert cameras.process.returncode == 0
    assert err == ""
    made = re.search(r"SIM-3-front (\d+), SIM-3-rear 0; CPU: [\d.]+% of one core", out)
    assert made is not None
    assert (int(made[1]) >= 1) == streaming
    assert not on_lo(cameras.front)
    assert not on_lo(cameras.rear)


@pytest.mark.real_time
def test_two_cameras_of_20_frames_a_second_lose_nothing() -> None:
    with served("--seed", "3") as cameras, client(cameras.front) as front, client(cameras.rear) as rear:
        front.start()
        rear.start()
        pairs = [(front.frame(), rear.frame()) for _ in range(80)]
    for one in zip(*pairs, strict=True):
        numbers = [frame.number for frame in one]
        gaps = [after - before for before, after in pairwise(numbers)]
        assert sum(gaps) - len(gaps) <= 2, gaps  # a busy machine may be late for a frame
        exposed_ms = [1e-6 * frame.timestamp_ns for frame in one[1:]]
        assert 48.0 < median(after - before for before, after in pairwise(exposed_ms)) < 52.0
    skews_ms = sorted(1e-6 * ((a.timestamp_ns - b.timestamp_ns + 25e6) % 50e6 - 25e6) for a, b in pairs[1:])
    assert abs(skews_ms[len(skews_ms) // 2]) < 5.0  # both expose when the clock is at whole periods


def test_a_camera_that_was_killed_can_be_served_again() -> None:
    with served("--only", "rear") as gone:
        gone.process.kill()
        gone.process.wait()
    try:
        with served("--only", "rear", "--rear", gone.rear) as cameras, client(gone.rear) as rear:
            assert f"rear at {gone.rear}" in cameras.said
            assert "front at" not in cameras.said
            rear.take(1)
    finally:
        delete = ["ip", "address", "del", f"{gone.rear}/32", "dev", "lo"]
        subprocess.run(delete, check=True)  # a killed process does not clear away


def test_a_port_that_is_taken_is_one_clear_line() -> None:
    need_gige()
    at = new_addresses()["front"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((at, GVCP_PORT))
        said = refusal(altd_here("gige", "--only", "front", "--front", at, module="hw_sim"))
    assert said == f"hw_sim: {at}:{GVCP_PORT}: another camera is served there"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--front", "203.0.113.7"], "203.0.113.7:3956: no network interface of this machine has this"),
        (["--front", "localhost"], "'localhost' is not an IPv4 address"),
        (["--seed", "1234567"], "makes a serial number of more than 15 characters"),
        (["--faults", "gremlins"], "unknown fault 'gremlins'"),
        (["--fps", "0"], "'0' is not a number from 1 to 200"),
        (["--seconds", "never"], "'never' is not a number of seconds above 0"),
    ],
)
def test_what_it_cannot_do_is_one_clear_line(arguments: list[str], says: str) -> None:
    assert says in refusal(altd_here("gige", *arguments, module="hw_sim"))


def test_without_the_library_it_names_the_package(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    need_gige()
    monkeypatch.setattr(libaravis, "LIBRARIES", ("libaravis-0.0.so.0", "libgobject-2.0.so.0"))
    at = new_addresses()
    assert main(["gige", "--front", at["front"], "--rear", at["rear"], "--seconds", "1"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("hw_sim: libaravis-0.0.so.0: cannot be loaded; the Debian package libaravis-0.8-0")
    assert len(said.splitlines()) == 1
