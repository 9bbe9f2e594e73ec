"""A separate PostgreSQL server of Debian's package, for measurements and tests."""

from __future__ import annotations

import contextlib
import itertools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psycopg

_START_TIMEOUT_S = 60.0


def programs() -> Path | None:
    """Folder of the newest installed server's programs; None if none is installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    return found[-1].parent if found else None


@dataclass
class Cluster:
    """A server on a socket in ``folder``, owned by its user; if started by root it runs as ``postgres``."""

    folder: Path
    programs: Path
    settings: Sequence[str]
    user: str | None = None
    server: subprocess.Popen[bytes] | None = None
    databases: int = 0

    def initialise(self) -> None:
        """Initialise its data folder."""
        made = self._run("initdb", "-D", str(self.folder / "data"), "-U", "altd", "-A", "trust", "--no-sync")
        assert made.wait() == 0, (self.folder / "log").read_text()  # noqa: S101

    def start(self) -> None:
        """Start, and wait until it answers."""
        words = itertools.chain.from_iterable(("-c", setting) for setting in self.settings)
        self.server = self._run("postgres", "-D", str(self.folder / "data"), "-k", str(self.folder), *words)
        deadline_s = time.monotonic() + _START_TIMEOUT_S
        while True:
            try:
                psycopg.connect(self.connection("postgres")).close()
            except psycopg.OperationalError:
                log = (self.folder / "log").read_text()
                assert self.server.poll() is None, log  # noqa: S101
                assert time.monotonic() < deadline_s, log  # noqa: S101
                time.sleep(0.02)
            else:
                return

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """Stop the server: SIGINT cleanly, SIGQUIT as in a crash."""
        if self.server is not None and self.server.poll() is None:
            self.server.send_signal(how)
            self.server.wait()

    def connection(self, database: str) -> str:
        """Connection string of a database."""
        return f"host={self.folder} dbname={database} user=altd"

    def new_database(self) -> str:
        """Create an empty database and return its connection string."""
        self.databases += 1
        name = f"fleet_{self.databases}"
        with psycopg.connect(self.connection("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}".encode())
        return self.connection(name)

    def _run(self, program: str, *arguments: str) -> subprocess.Popen[bytes]:
        groups: list[int] | None = None if self.user is None else []
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(  # noqa: S603
                [str(self.programs / program), *arguments],
                stdout=log,
                stderr=log,
                user=self.user,
                cwd=self.folder,
                extra_groups=groups,
            )


@contextlib.contextmanager
def postgresql(*settings: str) -> Iterator[Cluster]:
    """Run a new cluster with these settings (such as ``fsync=off``)."""
    found = programs()
    assert found is not None, "PostgreSQL is not installed (Debian package postgresql)"  # noqa: S101
    folder = Path(tempfile.mkdtemp(prefix="altd-postgresql-"))
    user = "postgres" if os.getuid() == 0 else None
    if user is not None:
        owner = pwd.getpwnam(user)
        os.chown(folder, owner.pw_uid, owner.pw_gid)
    cluster = Cluster(folder, found, ("listen_addresses=", "max_connections=50", *settings), user)
    try:
        cluster.initialise()
        cluster.start()
        yield cluster
    finally:
        cluster.stop()
        shutil.rmtree(folder)
