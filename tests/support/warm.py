"""Commands as processes that need not import: a process that has imported everything forks for each of them.

    with Warm(environment) as warm:
        status = warm.run(["altd.cli", "locate", "a.png"], folder, (stdin, stdout, stderr))

Importing the daemon takes more than half a second of a processor, which is most of a short command. The
forked process is what ``python -m altd.cli locate a.png`` would be: its own number, streams as the
interpreter opens them, the signals' first dispositions, one thread, and the interpreter's own end. It does
not show an error while importing: some tests start an interpreter.
"""

import contextlib
import gc
import importlib
import io
import json
import os
import pkgutil
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

PACKAGES = ("altd", "hw_sim", "studies")
MAX_ORDER_BYTES = 1 << 16
TIMEOUT_S = 200.0
_NO_COMMAND = ("__main__", "libkernel")
"""The last names of modules that are not imported: programs, and a library that is none of Python's."""


class Warm:
    """The process that forks; ``within`` are the words of a program that runs it, such as unshare(1)."""

    def __init__(self, environment: Mapping[str, str], within: Sequence[str] = ()) -> None:
        self._orders, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._orders.settimeout(TIMEOUT_S)
        with theirs:
            self.process = subprocess.Popen(
                [*within, sys.executable, "-m", "support.warm", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env=environment,
                start_new_session=True,  # as a group it ends with what it has forked
            )
        if not self._orders.recv(100):
            raise RuntimeError(f"it does not import: status {self.process.wait()}")

    def run(
        self, command: Sequence[str], folder: Path, streams: tuple[int, int, int], **environment: str
    ) -> int:
        """Run ``python -m`` with these words in a folder, on these descriptors; returns its status.

        That is minus the signal's number where one ended it.
        """
        order = {"command": list(command), "folder": str(folder), "environment": environment}
        socket.send_fds(self._orders, [json.dumps(order).encode()], streams)
        return int(self._orders.recv(100))

    def sees(self, path: Path) -> Path:
        """Path at which this process finds what its processes have at ``path``, in their mount namespace."""
        return Path(f"/proc/{self.process.pid}/root{path}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._orders.close()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def main() -> None:
    """Import; become a command, again and again, until there is no order any more."""
    orders = socket.socket(fileno=int(sys.argv[1]))
    for package in PACKAGES:
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not module.name.endswith(_NO_COMMAND):
                with contextlib.suppress(ModuleNotFoundError):  # of an optional library
                    importlib.import_module(module.name)
    threads = list(Path("/proc/self/task").iterdir())
    assert len(threads) == 1, "a forked process would lack the others"
    gc.collect()
    gc.freeze()  # else each forked process would copy all of this to count references
    orders.send(b"ready")
    module, *arguments = _forked(orders)
    sys.argv[1:] = arguments
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _forked(orders: socket.socket) -> list[str]:
    """The words of a command, in a new process for each; the first process does not return."""
    while True:
        content, streams, _, _ = socket.recv_fds(orders, MAX_ORDER_BYTES, 3)
        if not content:
            sys.exit()
        forked = os.fork()
        if not forked:
            break
        for descriptor in streams:
            os.close(descriptor)
        _, status = os.waitpid(forked, 0)
        orders.send(str(os.waitstatus_to_exitcode(status)).encode())
    orders.close()
    for number, descriptor in enumerate(streams):
        os.dup2(descriptor, number)
        os.close(descriptor)
    order = json.loads(content)
    os.environ.update(order["environment"])
    os.chdir(order["folder"])
    tempfile.tempdir = None  # that of the environment
    _open_streams()
    command: list[str] = order["command"]
    return command


def _open_streams() -> None:
    """As the interpreter does, by what descriptors 0 to 2 are now."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        before = getattr(sys, name)
        stream = open(number, mode, encoding=before.encoding, errors=before.errors, closefd=False)  # noqa: SIM115
        if name == "stderr":
            stream.reconfigure(line_buffering=True)
        assert isinstance(stream, io.TextIOWrapper)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


if __name__ == "__main__":
    main()
