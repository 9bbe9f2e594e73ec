"""A clean Debian that runs its own systemd in namespaces of its own, as the PC of a unit."""

import contextlib
import hashlib
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path

from support.foreign import need_program
from support.places import CACHE, ROOT

MIRROR = "http://deb.debian.org/debian"
_PACKAGES = "systemd,systemd-sysv,udev,procps,iproute2,ca-certificates"
"""Packages of any installed Debian beyond the smallest one."""
_ENVIRONMENT = (
    "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    *("HOME=/root", "LANG=C.UTF-8", "DEBIAN_FRONTEND=noninteractive"),
)
_BOOT = """
mount --make-rprivate /
mount --bind "$1" "$1"
cd "$1"
mount -t proc proc proc
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs tmpfs run
mount -t tmpfs tmpfs tmp
mount -t tmpfs -o mode=755 dev dev
for node in null zero full random urandom tty; do touch dev/$node; mount --bind /dev/$node dev/$node; done
mkdir -p dev/pts dev/shm dev/serial/by-id .host
mount --rbind /dev/pts dev/pts
ln -s pts/ptmx dev/ptmx
mount -t tmpfs tmpfs dev/shm
ip link set lo up
pivot_root . .host
umount -l .host
export container=altd
exec /lib/systemd/systemd --system </dev/null
"""


class BareDebian:
    """The machine; ``process`` is its systemd as the host sees it, ``root`` its file system."""

    def __init__(self, pid: int, root: Path) -> None:
        self._pid = pid
        self.root = root

    def run(
        self, line: str, folder: str = "/root", *, online: bool = False, timeout_s: float = 300.0
    ) -> subprocess.CompletedProcess[str]:
        """A line of a root shell; ``online``: with the host's network instead of its own."""
        spaces = ["--mount", "--pid", "--uts", "--ipc", "--cgroup"] + ([] if online else ["--net"])
        shell = ["env", "-i", *_ENVIRONMENT, "bash", "-c", f"cd {folder} && {line}"]
        return subprocess.run(
            ["nsenter", f"--target={self._pid}", *spaces, *shell],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # a signal to its group is not one to the tests
        )

    @contextlib.contextmanager
    def beside(self, command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
        """A process of the host on the machine's network, such as a camera."""
        inside = ["nsenter", f"--target={self._pid}", "--net", *command]
        with subprocess.Popen(inside, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
            try:
                yield process
            finally:
                process.terminate()


def install_debian(root: Path, suite: str) -> None:
    """Install Debian of this code name into the empty folder ``root``.

    The result is kept in the folder of ``.ci/kernel`` until Debian changes the release, some times a year.
    """
    install = [need_program("debootstrap"), "--variant=minbase", f"--include={_PACKAGES}", suite]
    with urllib.request.urlopen(f"{MIRROR}/dists/{suite}/InRelease", timeout=60) as release:
        digest = hashlib.sha256(" ".join(install).encode() + release.read()).hexdigest()[:16]
    kept = CACHE / f"debian-{suite}-{digest}.tar"
    if kept.exists():
        subprocess.run(["tar", "--numeric-owner", "-C", root, "-xpf", kept], check=True)
        shutil.copy("/etc/resolv.conf", root / "etc")  # as debootstrap does
        return
    done = subprocess.run([*install, root, MIRROR], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    CACHE.mkdir(parents=True, exist_ok=True)
    for old in CACHE.glob(f"debian-{suite}-*.tar"):
        old.unlink()
    written = CACHE / f"{kept.name}.{os.getpid()}"
    subprocess.run(["tar", "--numeric-owner", "-C", root, "-cf", written, "."], check=True)
    written.replace(kept)


@contextlib.contextmanager
def bare_debian(root: Path) -> Iterator[BareDebian]:
    """Boot the Debian in ``root``."""
    own = ["--mount", "--net", "--pid", "--ipc", "--uts", "--cgroup", "--fork", "--kill-child"]
    boot = [need_program("unshare", "util-linux"), *own, "sh", "-ec", _BOOT, "sh", str(root)]
    with subprocess.Popen(boot, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as systemd:
        try:
            machine = BareDebian(_first_child(systemd), root)
            for _ in range(300):  # its bus is there a moment later
                started = machine.run("systemctl is-system-running --wait", folder="/")
                if started.stdout not in ("", "offline\n"):
                    break
                time.sleep(0.1)
            assert started.stdout == "running\n", started
            yield machine
        finally:
            systemd.kill()


def _first_child(process: subprocess.Popen[str]) -> int:
    """The systemd that ``unshare`` has started, once it is that."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    for _ in range(500):
        with contextlib.suppress(OSError, ValueError):
            pid = int(children.read_text())
            if Path(f"/proc/{pid}/comm").read_text() == "systemd\n":
                return pid
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.02)
    raise AssertionError("no systemd")
