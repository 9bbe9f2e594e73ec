"""Foreign parts that a test needs: on a bare machine their absence skips it, in CI it fails it."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support.places import ROOT


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


def need_npm(package: str) -> Path:
    """The folder in which node finds a package that ``.ci/npm`` has installed, or a skip."""
    need((ROOT / "node_modules" / package).exists(), f"{package} is not installed (npm): make programs")
    return ROOT


def need_namespaces(*kinds: str) -> list[str]:
    """The words that run a command as root of its own namespaces, such as ``--net``."""
    unshare = [need_program("unshare", "util-linux"), "--user", "--map-root-user", *kinds]
    tried = subprocess.run([*unshare, "true"], capture_output=True, check=False)
    need(tried.returncode == 0, "this machine allows no namespaces")
    return unshare


def need_receive_buffer() -> None:
    """Skip a test of cameras on the network where the kernel keeps no whole frames: many would be lost.

    The kernel's default was 208 kB, and is 4 MB in newer ones.
    """
    limit = Path("/proc/sys/net/core/rmem_max")
    is_large = not limit.exists() or int(limit.read_text()) >= 1 << 20
    need(is_large, "net.core.rmem_max is too small: sysctl -w net.core.rmem_max=4194304")


def on_small_disk(folder: Path, size: str, shell: str) -> list[str]:
    """The words of a command that sees a real disk of this size at ``folder``, which is gone with it."""
    mount = f"mount -t tmpfs -o size={size} tmpfs {folder}"
    return [*need_namespaces("--mount"), "sh", "-c", f"{mount} && {shell}"]
