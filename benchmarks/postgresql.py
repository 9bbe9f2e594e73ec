"""A separate PostgreSQL server of Debian's package, for measurements and tests."""

import contextlib
import itertools
import os
import pwd
import signal
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg

from benchmarks.harness import Child, child, until

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
    life: contextlib.ExitStack
    """Its processes end with it."""
    user: str | None = None
    server: Child | None = None
    databases: int = 0

    def initialise(self) -> None:
        """Initialise its data folder."""
        data = str(self.folder / "data")
        self._run("initdb", "-D", data, "-U", "altd", "-A", "trust", "--no-sync").result()

    def start(self) -> None:
        """Start, and wait until it answers."""
        words = itertools.chain.from_iterable(("-c", setting) for setting in self.settings)
        self.server = self._run("postgres", "-D", str(self.folder / "data"), "-k", str(self.folder), *words)
        until(self._answers, _START_TIMEOUT_S, self.server.described)

    def _answers(self) -> bool:
        try:
            psycopg.connect(self.connection("postgres")).close()
        except psycopg.OperationalError:
            if self.server is not None and self.server.process.poll() is not None:
                raise
            return False
        return True

    def stop(self, how: signal.Signals) -> None:
        """Stop the server: SIGINT cleanly, SIGQUIT as in a crash."""
        if self.server is not None:
            self.server.send(how)
            self.server.process.wait()

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

    def _run(self, program: str, *arguments: str) -> Child:
        groups: list[int] | None = None if self.user is None else []
        settings: dict[str, Any] = {"user": self.user, "extra_groups": groups, "cwd": self.folder}
        command = [str(self.programs / program), *arguments]
        return self.life.enter_context(child(command, self.folder / "log", signal.SIGINT, **settings))


@contextlib.contextmanager
def postgresql(*settings: str) -> Iterator[Cluster]:
    """Run a new cluster with these settings (such as ``fsync=off``)."""
    found = programs()
    assert found is not None, "PostgreSQL is not installed (Debian package postgresql)"  # noqa: S101
    with contextlib.ExitStack() as life:
        folder = Path(life.enter_context(tempfile.TemporaryDirectory(prefix="altd-postgresql-")))
        user = "postgres" if os.getuid() == 0 else None
        if user is not None:
            owner = pwd.getpwnam(user)
            os.chown(folder, owner.pw_uid, owner.pw_gid)
        usual = "listen_addresses=", "max_connections=50"
        cluster = Cluster(folder, found, (*usual, *settings), life, user)
        cluster.initialise()
        cluster.start()
        yield cluster
