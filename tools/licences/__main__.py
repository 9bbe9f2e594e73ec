"""``python -m tools.licences [FOLDER]``: one line for each licence problem; the exit status is then 1."""

import sys
from pathlib import Path

from tools.licences.check import faults
from tools.licences.installed import NotAsLockedError, run_time_packages


def main(project: Path) -> int:
    """Check the licences of the project in a folder."""
    try:
        packages = run_time_packages(project)
    except NotAsLockedError as error:
        print(f"licences: {error}", file=sys.stderr)
        return 1
    found = list(faults(packages))
    for fault in found:
        print(f"licences: {fault}", file=sys.stderr)
    if not found:
        print(f"licences: all {len(packages)} packages that altd runs on go with Apache-2.0")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(*sys.argv[1:2])))
