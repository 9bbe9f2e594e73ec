"""All checks, in the reading order of a technician."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from altd.app.settings import load_settings
from altd.config import Config
from altd.config.drivers import DRIVERS
from altd.devices.nodes import check_permission, node_paths
from altd.doctor import keeping, network, system
from altd.process.machine import Finding, Machine, Verdict
from altd.records import counted

Check = Callable[[], Iterator[Finding]]


def examine(place: Path | None, machine: Machine | None = None) -> list[Finding]:
    """Return the findings for the config file, or in general; raises BadInputError for the file."""
    machine = machine or Machine()
    config = None if place is None else load_settings(place)
    findings: list[Finding] = []
    for name, check in _checks(config, place, machine).items():
        try:
            findings += check()
        except Exception as error:  # a check that fails on an unusual computer must not hide the others
            findings.append(Finding.warning(name, f"could not be checked: {type(error).__name__}: {error}"))
    return findings


def _checks(config: Config | None, place: Path | None, machine: Machine) -> dict[str, Check]:
    general: dict[str, Check] = {
        "libraries": lambda: system.libraries(config),
        "clock": lambda: system.clock(system.now(), system.clock_is_kept()),
        "processors": lambda: system.processors(machine, time.sleep),
        "disk": lambda: system.disk(machine),
    }
    if config is None or place is None:
        return general | {"devices": lambda: found_devices(machine)}
    return general | {
        "desk unit": lambda: system.desk(config),
        "calibration": lambda: system.calibration(config, place),
        **{
            driver.heading: partial(driver.check, tables, machine)
            for driver, tables in config.tables_by_driver().items()
        },
        "listening": lambda: network.listening(config, machine),
        "broker": lambda: network.broker(config),
        "history": lambda: keeping.history(config, machine),
        "kept frames": lambda: keeping.recordings(config, machine),
        "local socket": lambda: keeping.local_socket(config, machine),
    }


def found_devices(machine: Machine) -> Iterator[Finding]:
    """Check without a config whether the existing devices may be opened."""
    for what, *patterns in (driver.nodes for driver in DRIVERS if driver.nodes):
        paths = [path for pattern in patterns for path in node_paths(pattern, machine)]
        for path in paths:
            yield from check_permission(f"{what} {path}", path, machine)
        if not paths:
            yield Finding.skipped(what, "none present")


def in_lines(findings: list[Finding]) -> list[str]:
    """Return the findings for a person, the remedy below each, and their numbers by verdict."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.verdict:<7} {finding.subject}: {finding.text}")
        if finding.remedy:
            lines.append(f"        fix: {finding.remedy}")
    errors, warnings, goods, skips = (
        sum(finding.verdict is verdict for finding in findings)
        for verdict in (Verdict.ERROR, Verdict.WARNING, Verdict.GOOD, Verdict.SKIPPED)
    )
    counts = f"{counted(errors, 'error')}, {counted(warnings, 'warning')}, {goods} good"
    lines.append(f"{counts}, {skips} skipped" if skips else counts)
    return lines
