"""Packages that altd needs at run time, and their metadata."""

import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.metadata import Distribution, PackageMetadata, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tools.licences.accepted import STATED

LOCKS = ("requirements.lock", "aravis.lock")
_DEVELOPMENT_EXTRAS = ("docs", "test")
"""Extras of ``pyproject.toml`` for development only."""
_LOCK_ENVIRONMENT = {
    "implementation_name": "cpython",
    "os_name": "posix",
    "platform_machine": "x86_64",
    "platform_python_implementation": "CPython",
    "platform_system": "Linux",
    "python_full_version": "3.11.0",
    "python_version": "3.11",
    "sys_platform": "linux",
}
"""Platform for which the locks are resolved, so that the result is the same on every machine."""
_CLASSIFIER = re.compile(r"License :: (?:OSI Approved :: )?(.+)")
_LICENCE_FILE_PATH = re.compile(
    r".*/[^/]*(licen[cs]e|copying|notice)[^/]*(?<!\.py)(?<!\.pyc)|[^/]+\.dist-info/licenses/.+", re.IGNORECASE
)
_TEXTS = {
    kind: re.compile(rf"^[#\s]*{title},?[\s_*]+Version", re.MULTILINE | re.IGNORECASE)
    for kind, title in {
        "AGPL": "GNU Affero General Public License",
        "GPL": "GNU General Public License[ \t]*$",  # on a line of its own: ignores mere mentions
        "LGPL": "GNU (Lesser|Library) General Public License",
        "MPL": "Mozilla Public License",
    }.items()
}
"""Patterns of the title lines of complete licence texts."""


@dataclass(frozen=True, slots=True)
class Component:
    """Component that a package's metadata name, with the licence stated there."""

    name: str
    licence: str


@dataclass(slots=True)
class Package:
    """Package that altd needs at run time. If it is not installed, the data are those of ``STATED``.

    ``line`` is the licence field, or its first line and "…" if it holds a complete text; ``libraries`` are
    the compiled libraries in its wheel, as paths below ``site-packages``; ``texts`` are the kinds of licences
    whose complete texts are among its licence files.
    """

    name: str
    version: str
    expression: str | None = None
    line: str | None = None
    classifiers: tuple[str, ...] = ()
    requires: tuple[Requirement, ...] = ()
    libraries: tuple[str, ...] = ()
    components: tuple[Component, ...] = ()
    texts: frozenset[str] = frozenset()
    is_installed: bool = True
    needed_by: set[str] = field(default_factory=set)

    @property
    def declared(self) -> str:
        """Licence as the metadata declare it, in one line."""
        declared = [part for part in (self.expression, self.line) if part]
        return "; ".join([*declared, *self.classifiers])


class NotAsLockedError(Exception):
    """The environment does not match the locks; the message is one line."""


def run_time_packages(project: Path) -> list[Package]:
    """All packages that altd needs with every extra of a unit, by name; ``needed_by`` may contain altd.

    Raises NotAsLockedError if a package is missing or its version differs from the project's lock.
    """
    about = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    extras = about.get("optional-dependencies", {})
    lines = [
        *about["dependencies"],
        *(line for name in extras if name not in _DEVELOPMENT_EXTRAS for line in extras[name]),
    ]
    locked = {name: dict(_versions(project / name)) for name in LOCKS}
    found: dict[str, Package] = {}
    wanted = [(about["name"], Requirement(line)) for line in lines]
    while wanted:
        by, requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        if name not in found:
            found[name] = _locked_package(name, locked)
        if by in found[name].needed_by:
            continue
        found[name].needed_by.add(by)
        wanted += [(name, one) for one in found[name].requires if _applies(one, requirement.extras)]
    return [found[name] for name in sorted(found)]


def _applies(requirement: Requirement, extras: set[str]) -> bool:
    if requirement.marker is None:
        return True
    return any(requirement.marker.evaluate({**_LOCK_ENVIRONMENT, "extra": extra}) for extra in ("", *extras))


def _versions(lock: Path) -> Iterator[tuple[str, str]]:
    return iter(re.findall(r"^([a-z0-9.-]+)==([^\s;]+)", lock.read_text(), re.MULTILINE))


def _locked_package(name: str, locked: dict[str, dict[str, str]]) -> Package:
    version = next((versions[name] for versions in locked.values() if name in versions), None)
    if version is None:
        raise NotAsLockedError(f"{name} is in no lock: make lock")
    try:
        package = _package(name, distribution(name))
    except PackageNotFoundError:
        if name in locked["requirements.lock"] or name not in STATED:  # aravis.lock packages are compiled
            raise NotAsLockedError(f"{name} {version} is not installed: make venv") from None
        requires = tuple(map(Requirement, STATED[name].requires))
        return Package(name, version, line=STATED[name].declared, requires=requires, is_installed=False)
    if package.version != version:
        raise NotAsLockedError(f"{name} {package.version} is installed, the lock has {version}: make venv")
    return package


def _package(name: str, installed: Distribution) -> Package:
    about = installed.metadata
    classifiers = [_CLASSIFIER.fullmatch(line) for line in about.get_all("Classifier") or ()]
    licence = (_first(about, "License") or "").strip().splitlines()
    files = [str(path) for path in installed.files or ()]
    texts = [_text(installed, path) for path in files if _LICENCE_FILE_PATH.fullmatch(path)]
    return Package(
        name,
        installed.version,
        expression=_first(about, "License-Expression"),
        line=f"{licence[0].strip()} …" if len(licence) > 1 else next(iter(licence), None),
        classifiers=tuple(match[1] for match in classifiers if match),
        requires=tuple(map(Requirement, installed.requires or ())),
        libraries=tuple(path for path in files if re.match(r"[^/]+\.libs/", path)),
        components=tuple(
            [one for path in files if "/sboms/" in path for one in _in_cyclonedx(_text(installed, path))]
            + [one for text in texts for one in _in_licence_file(text)]
        ),
        texts=frozenset(kind for kind, begin in _TEXTS.items() if any(map(begin.search, texts))),
    )


def _first(about: PackageMetadata, key: str) -> str | None:
    return next(iter(about.get_all(key) or ()), None)


def _text(installed: Distribution, path: str) -> str:
    return Path(str(installed.locate_file(path))).read_text(encoding="utf-8", errors="replace")


def _in_cyclonedx(text: str) -> Iterator[Component]:
    """Yield the components of a CycloneDX list, except system copies: ``libraries`` has their files."""
    listed: list[dict[str, Any]] = json.loads(text).get("components", [])
    for part in listed:
        if part.get("purl", "").startswith(("pkg:rpm/", "pkg:deb/", "pkg:pypi/", "pkg:apk/")):
            continue
        licences = [
            entry.get("expression") or entry["license"].get("id") or entry["license"].get("name", "")
            for entry in part.get("licenses", [])
        ]
        yield Component(part["name"], " AND ".join(f"({one})" if " " in one else one for one in licences))


def _in_licence_file(text: str) -> Iterator[Component]:
    """Yield the components that a licence file lists by ``Name:`` and ``License:``, as numpy's does."""
    for entry in re.split(r"^(?=Name: )", text, flags=re.MULTILINE)[1:]:
        named = re.match(r"Name: (.+)", entry)
        licence = re.search(r"^License:[ \t]*(.*)$", entry, re.MULTILINE)
        if named:
            yield Component(named[1].strip(), licence[1].strip() if licence else "")
