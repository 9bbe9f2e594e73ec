"""A tree that looks like a computer, and a config for it."""

import grp
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from altd.config import Config
from altd.process.machine import Account, Finding, Machine, Verdict

SOMEBODY = Account("somebody", 4242, frozenset({4242}))


@dataclass
class Tree:
    """Files below a folder; ``machine`` is the computer that they make."""

    root: Path
    account: Account = SOMEBODY

    @property
    def machine(self) -> Machine:
        return Machine(self.root, self.account)

    def _place(self, path: str) -> Path:
        place = self.root / path.lstrip("/")
        place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def write(self, path: str, text: object) -> None:
        self._place(path).write_text(f"{text}\n")

    def link(self, path: str, to: str | Path) -> None:
        self._place(path).symlink_to(to)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    (tmp_path / "computer").mkdir()
    return Tree(tmp_path / "computer")


@pytest.fixture
def terminal() -> Any:
    """A character device of our own, a pseudo terminal, which does not belong to the group of root."""
    ends = os.openpty()
    device = Path(os.ttyname(ends[1]))
    if device.stat().st_gid == 0:
        os.chown(device, -1, grp.getgrnam("daemon").gr_gid)
    yield device
    for end in ends:
        os.close(end)


def configured(**tables: Any) -> Config:
    """A config with these tables."""
    targets = [{"name": name, "z_mm": z_mm, "camera": name} for name, z_mm in (("front", 0), ("rear", 280))]
    unit = {"serial": "ALT-0007", "calibration": "/nowhere/calibration.json"}
    cameras = tables.pop("cameras", {})
    measuring = {"pair_by": "time"} if cameras else {}
    given = {"unit": unit, "targets": targets, "cameras": cameras, "measuring": measuring}
    return Config.model_validate(given | tables)


def driver_findings(config: Config, tree: Tree) -> list[Finding]:
    """Findings of the drivers of the config."""
    checks = (driver.check(tables, tree.machine) for driver, tables in config.tables_by_driver().items())
    return [finding for check in checks for finding in check]


def says(findings: list[Finding], verdict: Verdict, words: str) -> Finding:
    """The finding with that verdict whose sentence has these words."""
    found = [finding for finding in findings if finding.verdict is verdict and words in finding.text]
    assert len(found) == 1, findings
    assert found[0].remedy or verdict is not Verdict.ERROR
    return found[0]
