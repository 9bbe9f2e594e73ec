"""Find packages and bundled components whose licences are not compatible with Apache-2.0."""

import platform
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch

from tools.licences.accepted import ACCEPTED, PARTS, POSITIONS, PURPOSES, STATED, TEXTS
from tools.licences.installed import Component, Package
from tools.licences.spdx import canonical, is_accepted, is_own_text, names

_CLASSIFIERS = {
    "Apache Software License": {"Apache-2.0"},
    "BSD License": {"BSD-2-Clause", "BSD-3-Clause"},
    "MIT License": {"MIT"},
    "Python Software Foundation License": {"PSF-2.0"},
}
"""Licences that a classifier can mean; the first three do not determine a version or variant."""
_EXACT = ("MIT License",)


def licence_of(package: Package) -> str | None:
    """SPDX expression of a package; None if its metadata state none or contradict each other.

    It is taken from the metadata: the expression, else the licence field if that is an SPDX expression, else
    a classifier with only one meaning. If there are classifiers too, each must match. For a package in
    ``STATED`` that entry is the result, as long as the package's metadata are unchanged.
    """
    if package.name in STATED:
        stated = STATED[package.name]
        return stated.licence if package.declared == stated.declared else None
    declared = canonical(package.expression or package.line or "")
    if declared is None and not package.expression and not package.line and len(package.classifiers) == 1:
        declared = next((next(iter(_CLASSIFIERS[one])) for one in package.classifiers if one in _EXACT), None)
    if declared is None:
        return None
    fits = all(_CLASSIFIERS.get(one, set()) & names(declared) for one in package.classifiers)
    return declared if fits else None


def faults(packages: Iterable[Package]) -> Iterator[str]:
    """Yield one line for each problem."""
    for package in packages:
        yield from _licence_faults(package)
        if package.is_installed:
            yield from _bundled_faults(package)
            yield from _outdated_faults(package)


def _licence_faults(package: Package) -> Iterator[str]:
    named = f"{package.name} {package.version}"
    licence = licence_of(package)
    if licence is None and package.name in STATED:
        yield f"{named} says {package.declared!r}, no longer {STATED[package.name].declared!r}: read it again"
    elif licence is None:
        yield f"{named} does not say its licence as one SPDX expression: {package.declared or 'nothing'!r}"
    elif not is_accepted(licence, _accepted_for(package.name)):
        yield f"{named} is {licence}, which does not go with Apache-2.0 (needed by {_dependents(package)})"
    if "altd" in package.needed_by and package.name not in PURPOSES:
        yield f"{named}: nothing says what altd needs it for"


def _dependents(package: Package) -> str:
    return ", ".join(sorted(package.needed_by))


def _accepted_for(name: str) -> frozenset[str]:
    return ACCEPTED | (POSITIONS[name].licences if name in POSITIONS else frozenset())


def _bundled_faults(package: Package) -> Iterator[str]:
    parts = [part for part in PARTS if part.package == package.name]
    for part in parts:
        if not part.reason and not is_accepted(part.licence, ACCEPTED):
            yield f"{package.name} brings {part.name} along, {part.licence}: nothing says why that goes"
    for library in package.libraries:
        if not any(fnmatch(library, pattern) for part in parts for pattern in part.files):
            yield f"{package.name} {package.version} brings {library} along, whose licence was not checked"
    known = {part.component: part.licence for part in parts if part.component}
    for component in package.components:
        yield from _component_faults(package, component, known)
    for kind in sorted(package.texts):
        if (package.name, kind) not in TEXTS:
            yield f"{package.name} {package.version} has a whole licence text, {kind}, of an unknown part"


def _component_faults(package: Package, component: Component, known: dict[str, str]) -> Iterator[str]:
    named = f"{component.name} in {package.name} {package.version}"
    if component.name not in known:
        if not is_accepted(component.licence, ACCEPTED):
            licence = component.licence or "of no stated licence"
            yield f"{named} is {licence}, which does not go with Apache-2.0"
    elif component.licence and not _is_same_licence(known[component.name], component.licence):
        yield f"{named} is {component.licence}, no longer {known[component.name]}: read it again"


def _is_same_licence(known: str, declared: str) -> bool:
    """Whether the licence is unchanged; always true if SPDX has no name for it."""
    return is_own_text(known) or canonical(declared) == known


def _outdated_faults(package: Package) -> Iterator[str]:
    """Yield outdated entries about a package, judged by its wheel for x86_64."""
    if platform.machine() != "x86_64":
        return
    there = {component.name for component in package.components}
    for part in (part for part in PARTS if part.package == package.name):
        missing = [one for one in part.files if not any(fnmatch(path, one) for path in package.libraries)]
        if missing or (part.component and part.component not in there):
            yield f"{package.name} {package.version} does not bring {part.name} along any more"
    for name, kind in TEXTS:
        if name == package.name and kind not in package.texts:
            yield f"{package.name} {package.version} does not have the text of its {kind} any more"
