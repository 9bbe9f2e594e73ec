"""Input and output of a check: the computer, with its user and its service; and findings.

The computer's files are under a root that a test may choose.
Unreadable content is empty: a check reports that, and no check raises.
"""

from __future__ import annotations

import contextlib
import fnmatch
import grp
import os
import pwd
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Self

from altd.process.port_owner import is_altd, process_at, words_of

_UNIT = "altd.service"
_UNIT_FOLDERS = (
    "/etc/systemd/system",
    "/run/systemd/system",
    "/usr/local/lib/systemd/system",
    "/lib/systemd/system",
)


@dataclass(frozen=True, slots=True)
class Account:
    """A user who runs altd."""

    name: str
    uid: int
    gids: frozenset[int]

    def may_use(self, status: os.stat_result) -> bool:
        """Whether this account may read and write the file."""
        if self.uid == 0:
            return True
        shift = 6 if status.st_uid == self.uid else 3 if status.st_gid in self.gids else 0
        return status.st_mode >> shift & 0o6 == 0o6


def own_account() -> Account:
    """The user of this process."""
    return Account(user_name(os.geteuid()), os.geteuid(), frozenset({os.getegid(), *os.getgroups()}))


@dataclass(frozen=True, slots=True)
class Service:
    """Permissions that the systemd unit gives the daemon."""

    account: Account
    closed: bool
    """Whether only devices that the unit lists may be opened."""
    devices: tuple[str, ...]
    """The listed devices: paths, or ``char-`` and the name of a driver."""
    low_ports: bool
    """Whether the service may listen on ports below 1024."""
    folders: tuple[str, ...] | None = None
    """Folders that it may write to; None: the unit does not restrict them."""

    def allows(self, path: str, drivers: set[str]) -> bool:
        """Whether the unit lets the daemon open this device of these drivers."""
        names = {path, *(f"char-{driver}" for driver in drivers)}
        return not self.closed or any(fnmatch.filter(names, listed) for listed in self.devices)

    def may_write(self, folder: Path) -> bool:
        """Whether the unit lets the daemon write to this folder."""
        return self.folders is None or any(folder.is_relative_to(allowed) for allowed in self.folders)


@dataclass(frozen=True, slots=True)
class Machine:
    """The computer that this runs on, or a directory tree that looks like one."""

    root: Path = Path("/")
    account: Account = field(default_factory=own_account)

    def at(self, path: str | Path) -> Path:
        """Path of a computer's file below the root in use."""
        return self.root / str(path).lstrip("/")

    def text(self, path: str | Path) -> str:
        """Text of a file without blanks around it; empty if it cannot be read."""
        try:
            return self.at(path).read_text(errors="replace").strip()
        except OSError:
            return ""

    def number(self, path: str | Path) -> int | None:
        """Number in a file; None if there is none."""
        try:
            return int(self.text(path))
        except ValueError:
            return None

    def paths(self, pattern: str) -> list[str]:
        """Paths that match a pattern, as named on the computer."""
        return sorted(f"/{path.relative_to(self.root)}" for path in self.root.glob(pattern.lstrip("/")))

    def status(self, path: str | Path) -> os.stat_result | None:
        """Status of the file behind a path; None if there is none."""
        try:
            return self.at(path).stat()
        except OSError:
            return None

    def drivers(self, status: os.stat_result) -> set[str]:
        """Names of the drivers that a character device may belong to (/proc/devices)."""
        lines = self.text("/proc/devices").partition("Block devices")[0].splitlines()
        pairs = [line.split() for line in lines]
        major = str(os.major(status.st_rdev))
        return {pair[1] for pair in pairs if len(pair) == 2 and pair[0] == major}

    def holders(self, opened: os.stat_result) -> Iterator[tuple[int, str]]:
        """Processes that have a device open: number and name. Only root gets those of other users."""
        for link in self.root.glob("proc/[0-9]*/fd/*"):
            with contextlib.suppress(OSError):
                status = link.stat()
                if stat.S_ISCHR(status.st_mode) and status.st_rdev == opened.st_rdev:
                    yield process_at(link.parent.parent)

    def runs_daemon(self) -> bool:
        """Whether a daemon of altd runs, of any user."""
        commands = map(words_of, self.root.glob("proc/[0-9]*"))
        return any("run" in words for words in commands if is_altd(words))

    def service(self) -> Service | None:
        """The systemd unit of altd, with its drop-in files; None if it is not installed."""
        texts = [text for folder in _UNIT_FOLDERS if (text := self.text(f"{folder}/{_UNIT}"))][:1]
        if not texts:
            return None
        for folder in reversed(_UNIT_FOLDERS):
            texts += [self.text(path) for path in self.paths(f"{folder}/{_UNIT}.d/*.conf")]
        keys = _keys("\n".join(texts))
        groups = [name for names in keys.get("SupplementaryGroups", []) for name in names.split()]
        devices = keys.get("DeviceAllow", [])
        return Service(
            Account("the service", -1, frozenset(filter(None, map(_gid, groups)))),
            closed=bool(devices) or keys.get("DevicePolicy", ["auto"])[-1] in ("closed", "strict"),
            devices=tuple(rule.split()[0] for rule in devices),
            low_ports=any("CAP_NET_BIND_SERVICE" in names for names in keys.get("AmbientCapabilities", [])),
            folders=_folders(keys) if keys.get("ProtectSystem", [""])[-1] == "strict" else None,
        )


def group_name(gid: int) -> str:
    """The name of a group, or its number."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def user_name(uid: int) -> str:
    """The name of a user, or its number."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _gid(name: str) -> int | None:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return None


def _folders(keys: dict[str, list[str]]) -> tuple[str, ...]:
    """Folders that a unit may write to in a read-only file system (systemd.exec(5), ProtectSystem=)."""
    prefixes = {"StateDirectory": "/var/lib/", "RuntimeDirectory": "/run/", "ReadWritePaths": ""}
    return tuple(
        f"{prefix}{name.lstrip('-+')}"
        for key, prefix in prefixes.items()
        for names in keys.get(key, [])
        for name in names.split()
    )


def _keys(text: str) -> dict[str, list[str]]:
    """Values of each key of a unit file; an empty value clears the earlier ones."""
    keys: dict[str, list[str]] = {}
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith(("#", ";")):
            keys[key.strip()] = [*keys.get(key.strip(), []), value.strip()] if value.strip() else []
    return {key: values for key, values in keys.items() if values}


def said(error: Exception) -> str:
    """Return the text of an error in one line, for a finding."""
    return " ".join(str(error).split()) or type(error).__name__


class Verdict(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    WARNING = "warning"
    """The subject works but could be improved, or it could not be checked."""
    ERROR = "ERROR"
    """The subject fails or is unreliable."""
    SKIPPED = "skipped"
    """There is nothing to check: no such device, or the settings do without it."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor. ``remedy`` is a command, or a change in a file."""

    verdict: Verdict
    subject: str
    text: str
    remedy: str = ""

    @classmethod
    def good(cls, subject: str, text: str) -> Self:
        """Return a finding without a fault."""
        return cls(Verdict.GOOD, subject, text)

    @classmethod
    def warning(cls, subject: str, text: str, remedy: str = "") -> Self:
        """Return a warning."""
        return cls(Verdict.WARNING, subject, text, remedy)

    @classmethod
    def error(cls, subject: str, text: str, remedy: str) -> Self:
        """Return an error, which must have a remedy."""
        return cls(Verdict.ERROR, subject, text, remedy)

    @classmethod
    def skipped(cls, subject: str, text: str) -> Self:
        """Return a finding for a subject with nothing to check."""
        return cls(Verdict.SKIPPED, subject, text)
