"""The guest kernel itself: what runs in it, what comes out of it, what is left of it."""

import os
import time
from pathlib import Path

import pytest
from support.guest import run_in_guest


def test_a_guest_has_the_drivers_that_tests_need(tmp_path: Path) -> None:
    run = run_in_guest(
        tmp_path,
        "what_is_there.py",
        "two words",
        2,
        kernel_arguments=("vivid.n_devs=1", "v4l2loopback.devices=2"),
    )
    found = run.results
    assert found["arguments"] == ["two words", "2"]
    assert "vivid-000-vid-cap" in found["cameras"]
    assert sum("Dummy video device" in name for name in found["cameras"]) == 2
    assert found["usb_controllers"] == ["dummy_udc.0"]
    assert found["gpio_sim"]
    assert found["usb_gadgets"]
    assert found["loopback"] != "down"
    assert run.out == "looking around\n"


def test_the_exit_status_of_a_guest_program_comes_out(tmp_path: Path) -> None:
    run = run_in_guest(tmp_path, "ends_badly.py", 7)
    assert (run.status, run.out) == (7, "before the end\n")
    with pytest.raises(AssertionError, match="before the end"):
        _ = run.results


def test_of_a_guest_that_hangs_nothing_is_left(tmp_path: Path) -> None:
    for timeout_s in (4.0, 16.0, 64.0):  # it must have begun, which takes long on a busy machine
        folder = tmp_path / f"{timeout_s:g}"
        folder.mkdir()
        with pytest.raises(TimeoutError) as hanging:
            run_in_guest(folder, "ends_badly.py", -1, timeout_s=timeout_s)
        if "before the end" in str(hanging.value):
            break
    assert "before the end" in str(hanging.value)
    deadline = time.monotonic() + 30.0  # a killed process of the guest may wait for its turn to end
    while (left := _processes_that_name(str(tmp_path))) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left


def _processes_that_name(word: str) -> list[str]:
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and int(process.name) != os.getpid():
            try:
                line = (process / "cmdline").read_bytes().decode(errors="replace")
            except OSError:
                continue
            if word in line:
                found.append(line)
    return found
