"""The components of altd as CycloneDX 1.6 in JSON, from the locks: ``python -m tools.sbom >FILE``.

It lists the dependencies of a unit, with licences and the components inside wheels, without test tools. The
same locks give the same bytes.
"""

import json
import re
import sys
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from altd import __version__
from tools.licences.accepted import PARTS
from tools.licences.check import licence_of
from tools.licences.installed import LOCKS, NotAsLockedError, Package, run_time_packages

_LOCKED = re.compile(r"^([a-z0-9.-]+)==\S+.*((?:\n    --hash=sha256:[0-9a-f]{64}(?: \\)?)+)", re.MULTILINE)


def sbom(project: Path) -> dict[str, Any]:
    """Build the document; raises NotAsLockedError if the installed packages do not match the locks."""
    packages = run_time_packages(project)
    hashes = {
        name: re.findall("[0-9a-f]{64}", lines)
        for lock in reversed(LOCKS)
        for name, lines in _LOCKED.findall((project / lock).read_text())
    }
    altd = {
        "type": "application",
        "bom-ref": "altd",
        "name": "altd",
        "version": __version__,
        "licenses": _licences("Apache-2.0"),
    }
    components = [_component(package, hashes[package.name]) for package in packages]
    content = {
        "metadata": {"component": altd},
        "components": components,
        "dependencies": _dependencies(packages),
    }
    serial = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(content, sort_keys=True))
    head = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
    }
    return head | content


def _component(package: Package, hashes: Sequence[str]) -> dict[str, Any]:
    purl = _purl(package)
    files = {
        "type": "distribution",
        "url": purl,
        "hashes": [{"alg": "SHA-256", "content": h} for h in hashes],
    }
    parts = [
        {"type": "library", "name": part.name, "licenses": _licences(part.licence)}
        for part in PARTS
        if part.package == package.name and part.is_bundled
    ]
    return {
        "type": "library",
        "bom-ref": purl,
        "name": package.name,
        "version": package.version,
        "purl": purl,
        "licenses": _licences(licence_of(package)),
        "externalReferences": [files],
        **({"components": parts} if parts else {}),
    }


def _licences(expression: str | None) -> list[dict[str, Any]]:
    return [{"expression": expression}] if expression else []


def _purl(package: Package) -> str:
    return f"pkg:pypi/{package.name}@{package.version}"


def _dependencies(packages: Sequence[Package]) -> list[dict[str, Any]]:
    def needs(name: str) -> list[str]:
        return [_purl(package) for package in packages if name in package.needed_by]

    direct = {"ref": "altd", "dependsOn": needs("altd")}
    return [direct, *({"ref": _purl(package), "dependsOn": needs(package.name)} for package in packages)]


if __name__ == "__main__":
    try:
        print(json.dumps(sbom(Path()), indent=1, ensure_ascii=False))
    except NotAsLockedError as error:
        sys.exit(f"sbom: {error}")
