"""Tests in a network of their own: GigE Vision's port is fixed, and links are pulled there.

Tests marked ``own_network`` run inside a fresh user and network namespace, where they may do to the network
what they like; several runs at once do not meet. All of one file run there in one pytest, started for the
first of them. Their fixtures are set up outside, too, and must do nothing before they are asked to.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from support.foreign import need, need_namespaces, need_program, need_receive_buffer

MARKER = "own_network"
FILE_TIMEOUT_S = 900.0
"""All marked tests of one file; each has a time-out of its own inside."""
_NOTES = "ALTD_OWN_NETWORK_NOTES"
_UP = 'ip link set lo up && ip address add 127.0.0.2/32 dev lo && exec "$@"'
_complaints: dict[str, str] = {}


def inside() -> bool:
    """Whether this process is in such a network already."""
    return _NOTES in os.environ


def note(report: pytest.TestReport) -> None:
    """Inside: leave word of how a test went."""
    if report.when == "call" or not report.passed:
        with Path(os.environ[_NOTES]).open("a") as notes:
            complaint = "" if report.passed else f"in its own network:\n{report.longrepr}"
            notes.write(json.dumps([report.nodeid, complaint]) + "\n")


def run_inside(item: pytest.Item) -> None:
    """Outside: fail a test with what it said inside."""
    need(importlib.util.find_spec("gi") is not None, "PyGObject is not installed (make programs venv)")
    need_receive_buffer()
    need_program("arv-fake-gv-camera-0.8", "aravis-tools")
    need_program("arv-tool-0.8", "aravis-tools-cli")
    need_program("ip", "iproute2")
    unshare = need_namespaces("--net")
    if item.nodeid not in _complaints:
        _run_file(item, [*unshare, "sh", "-c", _UP, "sh"])
    if _complaints[item.nodeid]:
        pytest.fail(_complaints[item.nodeid], pytrace=False)


def _run_file(item: pytest.Item, in_own_network: list[str]) -> None:
    asked_for = [
        other.nodeid
        for other in item.session.items
        if other.path == item.path and other.get_closest_marker(MARKER) is not None
    ]
    with tempfile.NamedTemporaryFile() as notes:
        done = subprocess.run(
            [*in_own_network, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *asked_for],
            cwd=item.config.rootpath,
            env=os.environ | {_NOTES: notes.name},
            capture_output=True,
            text=True,
            timeout=FILE_TIMEOUT_S,
            check=False,
        )
        _complaints.update(dict.fromkeys(asked_for, f"did not run:\n{done.stdout}{done.stderr}"))
        told: dict[str, str] = {}
        for nodeid, complaint in map(json.loads, Path(notes.name).read_text().splitlines()):
            told[nodeid] = told.get(nodeid, "") + complaint
        _complaints.update(told)
