"""Compare the locks with a stored list of advisories, without a network: ``python -m tools.audit``.

Prints one line for each locked package that an advisory affects; the exit status is then 1. ``--update FOLDER
SOURCE`` writes the list from a folder of OSV records in JSON, such as the unpacked export of an advisory
database.
"""

import argparse
import json
import re
import sys
from collections.abc import Iterator, Mapping
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name
from packaging.version import Version

from tools.licences.installed import LOCKS

LIST = Path(__file__).with_name("advisories.json")
_OLD_DAYS = 90


def locked(project: Path) -> dict[str, set[Version]]:
    """Locked versions by package name."""
    found: dict[str, set[Version]] = {}
    for lock in LOCKS:
        for name, version in re.findall(
            r"^([a-z0-9.-]+)==([^\s;]+)", (project / lock).read_text(), re.MULTILINE
        ):
            found.setdefault(canonicalize_name(name), set()).add(Version(version))
    return found


def faults(packages: Mapping[str, set[Version]], advisories: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a line for each locked version that an advisory affects."""
    for advisory in advisories:
        for of in advisory["affected"]:
            name = canonicalize_name(of["package"]["name"])
            for version in sorted(packages.get(name, ())):
                if _is_affected(version, of):
                    yield f"{name} {version}: {advisory['id']}"


def _is_affected(version: Version, of: Mapping[str, Any]) -> bool:
    """Whether the advisory affects the version, by its list or a range (OSV schema, "affected")."""
    ranges = [each["events"] for each in of.get("ranges", ()) if each["type"] != "GIT"]
    is_listed = any(Version(each) == version for each in of.get("versions", ()))
    return is_listed or any(_is_within(version, events) for events in ranges)


def _is_within(version: Version, events: list[dict[str, str]]) -> bool:
    """Whether the last event at or before the version introduces the fault."""
    is_within = False
    for event in sorted(events, key=lambda event: Version(*event.values())):
        ((kind, at),) = event.items()
        if kind == "introduced" and Version(at) <= version:
            is_within = True
        elif (kind == "fixed" and Version(at) <= version) or (
            kind == "last_affected" and Version(at) < version
        ):
            is_within = False
    return is_within


def updated(folder: Path, packages: Mapping[str, set[Version]], source: str, today: date) -> dict[str, Any]:
    """Return the list to store: the folder's records that affect a locked package and are not withdrawn."""
    advisories = []
    for path in sorted(folder.rglob("*.json")):
        record = json.loads(path.read_text())
        about = [
            {key: of[key] for key in ("package", "ranges", "versions") if key in of}
            for of in record.get("affected", ())
            if of["package"]["ecosystem"] == "PyPI" and canonicalize_name(of["package"]["name"]) in packages
        ]
        if about and "withdrawn" not in record:
            advisories.append({"id": record["id"], "modified": record["modified"], "affected": about})
    return {"date": str(today), "source": source, "advisories": advisories}


def main() -> int:
    """Check the locks, or update the list first; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tools.audit", description=__doc__)
    parser.add_argument("--update", nargs=2, metavar=("FOLDER", "SOURCE"), help="replace the list")
    options = parser.parse_args()
    packages, today = locked(Path()), datetime.now(UTC).date()
    if options.update:
        folder, source = options.update
        LIST.write_text(json.dumps(updated(Path(folder), packages, source, today), indent=1) + "\n")
    stored = json.loads(LIST.read_text())
    advisories, days = stored["advisories"], (today - date.fromisoformat(stored["date"])).days
    found = list(faults(packages, advisories))
    for fault in found:
        print(f"audit: {fault}", file=sys.stderr)
    old = ": too old to rely on, see docs/security.md" if days > _OLD_DAYS else ""
    print(f"audit: {len(packages)} packages against {len(advisories)} advisories, a list of {days} days{old}")
    print(f"audit: source: {stored['source']}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
