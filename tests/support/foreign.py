"""Foreign parts that a test needs: on a bare machine their absence skips it, in CI it fails it."""

from __future__ import annotations

import os
import shutil

import pytest


def need(available: bool, reason: str) -> None:
    """Skip a test for a missing foreign part on a bare machine; in CI a missing part is a failure."""
    if available:
        return
    if os.environ.get("CI"):
        pytest.fail(f"CI must have it: {reason}")
    pytest.skip(reason)


def need_program(name: str, package: str | None = None) -> str:
    """The path of a foreign program, or a skip with the name of the Debian package that has it."""
    path = shutil.which(name)
    need(path is not None, f"{name} is not installed (Debian package {package or name})")
    assert path is not None
    return path
