"""Tests in a network of their own: GigE Vision's port is fixed, and links are pulled there.

Such a test, marked ``own_network``, runs in a pytest of its own inside a fresh user and network namespace,
where it may do to the network what it likes; several at once do not meet. Its fixtures are set up outside,
too, and must do nothing before they are asked to.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys

import pytest

from support.foreign import need, need_program

_MARK = "ALTD_OWN_NETWORK"
_UP = 'ip link set lo up && ip address add 127.0.0.2/32 dev lo && exec "$@"'


def inside() -> bool:
    """Whether this process is in such a network already."""
    return _MARK in os.environ


def run_inside(item: pytest.Item) -> None:
    """Run one test inside; it fails here with what it said there."""
    need(importlib.util.find_spec("gi") is not None, "PyGObject is not installed (make programs venv)")
    need_program("arv-fake-gv-camera-0.8", "aravis-tools")
    need_program("ip", "iproute2")
    unshare = [need_program("unshare", "util-linux"), "--user", "--map-root-user", "--net"]
    need(
        subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode == 0,
        "this machine allows no network namespaces",
    )
    pytest_alone = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", item.nodeid]
    done = subprocess.run(
        [*unshare, "sh", "-c", _UP, "sh", *pytest_alone],
        cwd=item.config.rootpath,
        env=os.environ | {_MARK: "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if done.returncode or not re.search(r"\b1 passed", done.stdout):
        pytest.fail(f"in its own network:\n{done.stdout}{done.stderr}", pytrace=False)
