"""Fixtures: a clock that a test moves, and a board and health that tell its time."""

from datetime import datetime

import pytest

from altd.instruments.beam.instrument import QUANTITIES
from altd.selfcheck.records import SelfCheck, Verdict
from altd.status.board import Board
from altd.status.calibration_summary import CalibrationFigures, CalibrationFileFacts, CalibrationRecording
from altd.status.health import Health
from altd.status.proof import Identity
from altd.status.services import SelfCheckReport
from altd.status.unit import PublishedUnit, UnitFacts
from support.clock import FakeClock


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock(8_000_000_000)


@pytest.fixture
def board(clock: FakeClock) -> Board:
    return Board(clock, 1.0, QUANTITIES, Identity.drawn("ALT-0007"))


@pytest.fixture
def health(clock: FakeClock) -> Health:
    return Health(clock)


@pytest.fixture
def published(board: Board, health: Health) -> PublishedUnit:
    facts = UnitFacts(version="0.1.0", serial="ALT-0007", calibration="2026-11-02")
    return PublishedUnit(board, health, facts)


def checked(
    number: int, *reasons: str, verdict: str = "good", time: datetime | None = None
) -> SelfCheckReport:
    """Return the report of a check of no target."""
    return SelfCheckReport(number, SelfCheck(Verdict(verdict), {}, {}, reasons), "request", time)


def figures_of(created: str, checksum: str, *, simulated: bool = False) -> CalibrationFigures:
    """Return figures of a calibration that are no more than its identity."""
    file = CalibrationFileFacts(name="cal.json", sha256=None, checksum=checksum)
    return CalibrationFigures(
        unit="",
        created=created,
        simulated=simulated,
        recording=CalibrationRecording(note="", sha256=""),
        file=file,
        exposures=20,
        expected_sigma={},
        targets=[],
    )
