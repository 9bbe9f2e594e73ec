"""The unit as its interfaces know it: views of one instant, and the services that answer requests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Literal

from altd.records import Measurement, Quantities
from altd.status.answer import Answer
from altd.status.board import Board
from altd.status.calibration_summary import CalibrationFigures, CalibrationIdentity
from altd.status.cause import ShownCause, StateReport
from altd.status.health import ComponentReport, Health
from altd.status.proof import Identity, Stamp
from altd.status.services import (
    CalibrationFiles,
    PictureService,
    RecordingService,
    SelfCheckReport,
    SelfCheckService,
)
from altd.status.target_area import TargetArea
from altd.status.zero import Zero, ZeroState


class UnitFacts(Answer):
    """Constants of a unit; empty: not known."""

    kind: Literal["", "desk"] = ""
    """`desk`: a unit on a desk, which steers no machine; absent: a machine's unit."""
    version: str = ""
    serial: str = ""
    unit_number: str = ""
    """CRC-32 of the serial number, as `unit` in every message."""
    spot_fit: str = ""
    """Spot fit in use: `compiled`, or `numpy` and the reason; numpy finds the same and takes more CPU."""
    calibration: str = ""
    calibration_valid_until: str = ""
    """Date at which the calibration is `calibration_due_days` old, UTC."""
    time_zone: str = ""
    """IANA name of the computer's time zone, for people: all times are UTC. Empty also if it is UTC."""
    config_sha256: str = ""
    """SHA-256 of the config file as the daemon read it."""

    @property
    def known(self) -> dict[str, str]:
        """Known facts by name."""
        return self.model_dump(exclude_defaults=True)

    @property
    def product(self) -> str:
        """Name of the product in identifications."""
        return "Active Laser Target on a desk" if self.kind else "Active Laser Target"


@dataclass(frozen=True, slots=True)
class DiagnosticPart:
    """One file of the diagnostics; ``meaning`` describes it in a few words.

    ``make`` returns its content and runs in a thread; an exception in it loses only this part.
    """

    name: str
    meaning: str
    make: Callable[[], bytes]


@dataclass(frozen=True)
class UnitView:
    """The unit at one instant: what interfaces show, and all that they show.

    It is for one answer, which is made without an await: state and components are determined when they are
    first read, as they cost more than all else.
    """

    now_ns: int
    utc: datetime | None
    """Time of day of ``now_ns``; None: not known."""
    running_ns: int
    """Time since the daemon started."""
    operating_hours: float | None
    """Operating hours of the unit over its life; None: not known."""
    identity: Identity
    facts: UnitFacts
    quantities: Quantities
    """Quantities of the measurements; known before the first one."""
    measurement: Measurement | None
    """The current measurement; None: no measurement has been made yet."""
    age_s: float | None
    """Time since the middle of the exposures of the latest measurement; None before the first."""
    published: int
    """Number of measurements published so far."""
    health: Health
    read_state: Callable[[], StateReport | None]
    targets: tuple[TargetArea, ...]
    """Targets in beam order."""
    calibration: CalibrationFigures | None
    self_check: SelfCheckReport | None
    """The last self-check; None: there was none since the start."""
    no_self_check: str
    """Reason why the unit cannot check itself; empty: it can."""
    zero: ZeroState
    stamp: Stamp | None
    """Stamp of the message that shows this view; None: it has none."""

    @cached_property
    def state(self) -> StateReport | None:
        """State of the unit; None: it is not determined."""
        return self.read_state()

    @cached_property
    def components(self) -> tuple[ComponentReport, ...]:
        """Reports of the components in the order in which they started."""
        return tuple(component.report() for component in self.health)

    def component(self, name: str) -> ComponentReport | None:
        """Return the report of a component; None: there is no such component."""
        return next((component for component in self.components if component.name == name), None)

    @property
    def causes(self) -> tuple[ShownCause, ...]:
        """Causes of the unit's state, the worst first."""
        return () if self.state is None else self.state.causes

    @property
    def calibration_identity(self) -> CalibrationIdentity:
        """Identity of the loaded calibration."""
        if self.calibration is None:
            return CalibrationIdentity(created=None, checksum=None, simulated=None)
        return self.calibration.identity


class PublishedUnit:
    """A unit with its interfaces. ``state`` returns its present state; None: it is not determined.

    ``diagnostics`` are contents of the diagnostics beyond what every interface shows.
    """

    def __init__(  # noqa: PLR0913  what there is to publish
        self,
        board: Board,
        health: Health,
        facts: UnitFacts = UnitFacts(),  # noqa: B008  frozen
        targets: tuple[TargetArea, ...] = (),
        state: Callable[[], StateReport | None] = lambda: None,
        calibration: CalibrationFigures | None = None,
        calibration_files: CalibrationFiles | None = None,
        diagnostics: tuple[DiagnosticPart, ...] = (),
    ) -> None:
        self.board = board
        self.health = health
        self.facts = facts
        self.targets = targets
        self.state = state
        self.clock = health.clock
        self.events = health.events
        self.calibration = calibration
        self.calibration_files = calibration_files
        self.diagnostics = diagnostics
        self.self_check = SelfCheckService(self.events)
        self.zero = Zero(self.events)
        self.operating_hours: Callable[[], float | None] = lambda: None
        """Returns the unit's operating hours; None: not known."""
        self.recordings = RecordingService("this unit keeps no frames")
        self.pictures = PictureService("this unit shows no pictures")

    def view(self, stamp: Stamp | None = None) -> UnitView:
        """Return the unit at this moment, for a message with this stamp."""
        now_ns, board = self.clock.monotonic_ns(), self.board
        return UnitView(
            now_ns=now_ns,
            utc=self.clock.utc(now_ns),
            running_ns=board.running_ns(),
            operating_hours=self.operating_hours(),
            identity=board.identity,
            facts=self.facts,
            quantities=board.quantities,
            measurement=board.read(),
            age_s=board.age_s(),
            published=board.published,
            health=self.health,
            read_state=self.state,
            targets=self.targets,
            calibration=self.calibration,
            self_check=self.self_check.latest,
            no_self_check=self.self_check.unavailable,
            zero=self.zero.state,
            stamp=stamp,
        )
