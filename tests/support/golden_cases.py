"""Fixed units in fixed states for the golden bytes: what is measured, what is wrong, what has happened."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock

from altd.history.columns import columns_of
from altd.history.history import History
from altd.history.records import About, Batch, Sample, StateSample
from altd.history.store import Store
from altd.instruments.beam.instrument import QUANTITIES
from altd.instruments.beam.solver import Beam
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.instruments.row.measurement import quantities_of
from altd.measuring.instrument import NO_SOLUTION, Solution
from altd.publish.serial.parts_text import Past
from altd.reasons import Reason, Scope, Signal
from altd.records import Fault, Measurement, Value
from altd.records.sensors import Quality, SensorValue
from altd.selfcheck.records import LedState, PartVerdict, SelfCheck, TargetDrift, Verdict
from altd.status.availability import Before, RunningSpan
from altd.status.calibration_summary import CalibrationFigures
from altd.status.cause import Cause
from altd.status.conditions import Condition
from altd.status.event_log import EventKind
from altd.status.health import MEASURING, CameraTrouble, State
from altd.status.proof import Identity, unit_number
from altd.status.services import NoReportError, SelfCheckReport
from altd.status.state import TICK_S, StateEvents, UnitState
from altd.status.target_area import TargetArea
from altd.status.unit import UnitFacts
from altd.status.zero import Zero
from support.clock import FakeClock
from support.history import MAX_BYTES, US
from support.measurements import changed, measurement_of_row
from support.opcua import OpcUaUnit
from tools.pages.example import MEASURED, SERIAL, STAMP

AGE_S = 0.52
START_NS = 10**9
CALIBRATION: dict[str, Any] = {
    "unit": SERIAL, "created": "2026-11-02T09:30:00.000Z", "simulated": False, "exposures": 20,
    "recording": {"note": "workshop, stage 2", "sha256": "ab" * 32},
    "file": {"name": "calibration.json", "sha256": "cd" * 32, "checksum": "sha256:89abcdef" + "01" * 28},
    "expected_sigma": {"x_mm": 0.0041234, "y_mm": 0.0040987, "yaw_deg": 0.0011, "pitch_deg": 0.0012},
    "targets": [
        {
            "name": name, "z_mm": z_mm, "simulated": False, "width": 1440, "height": 1080, "map": "tensor",
            "camera": {"serial": f"C-{name}", "model": "mono", "driver": "aravis"}, "leds": 6,
            "flat": "laser", "x_mm": [-70.0, 70.0], "y_mm": [-55.0, 55.0], "left_out_px": 0.02104,
            "residuals": {"mean_mm": 0.0041, "std_mm": 0.0021, "max_mm": 0.0123},
            "repeatability_px": [0.012, 0.013], "fingerprint": {"hot_px": 31, "texture": None},
            "cross_check": {"map": "pinhole", "left_out_px": 0.03, "bound_px": 0.2, "largest_px": 0.05},
        }
        for name, z_mm in (("front", 0.0), ("rear", 280.0))
    ],
}  # fmt: skip
FILES = AsyncMock()
FILES.name, FILES.calibration.return_value = "calibration.json", b'{"format": "altd-calibration/1"}'
FILES.check_report.side_effect = FILES.report.side_effect = NoReportError("there is no report")


@dataclass
class GoldenUnit(OpcUaUnit):
    """A unit with a fixed identity, whose clock moves only by ``live``."""

    serial: str = SERIAL
    watched: list[Cause] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        health, published = self.health, self.published
        published.facts = UnitFacts(
            version=published.facts.version,
            serial=self.serial,
            unit_number=f"{self.identity.unit:08X}",
            spot_fit="compiled",
            calibration="2026-11-02, workshop, stage 2",
            config_sha256="0123abcd" * 8,
        )
        published.zero = Zero(health.events, 4711)
        published.calibration = CalibrationFigures.model_validate(CALIBRATION)
        published.calibration_files = FILES
        published.operating_hours = lambda: 812.51
        state = UnitState(self.board, health, self.clock, [lambda _: self.watched])
        published.state, self.availability = state.read, state.availability
        self.observer = StateEvents(health.events, state.read, published.self_check, self.clock)
        for name in ("camera front", "camera rear", MEASURING, "opcua"):
            health.component(name).set_state(State.OK)

    @property
    def past(self) -> Past:
        return Past(self.health.events, self.history, lambda: self.clock.utc(self.clock.monotonic_ns()))

    def put(self, of: Measurement) -> None:
        """Put a measurement on the board whose exposures' middle was ``AGE_S`` ago."""
        now_ns = self.clock.monotonic_ns()
        t_ns = now_ns - round(AGE_S * 1e9)
        time = None if of.time is None else self.clock.utc(t_ns)
        sensors = {
            key: replace(said, t_ns=now_ns - 125_000_000, expires_ns=now_ns + said.expires_ns)
            for key, said in of.from_sensors.items()
        }
        made = replace(of, t_ns=t_ns, last_exposure_ns=now_ns - 45_000_000, time=time, from_sensors=sensors)
        self.board.publish(made)

    def live(self, seconds: float, measurement: Measurement | None = None) -> None:
        """Let time pass; a measurement arrives in every tick of the state."""
        assert isinstance(self.clock, FakeClock)
        for _ in range(round(seconds / TICK_S)):
            self.clock.now_ns += round(TICK_S * 1e9)
            if measurement is not None:
                self.put(measurement)
            self.observer.observe()


Act = Callable[[GoldenUnit], object]


@dataclass(frozen=True)
class Case:
    """A unit that measures ``before`` for a time, then ``shown`` for a time, then nothing for ``then_s``."""

    shown: Measurement | None = MEASURED
    act: Act = lambda unit: None
    """Events between ``before`` and ``shown``."""
    before: Measurement | None = MEASURED
    before_s: float = 3.0
    for_s: float = TICK_S
    then_s: float = 0.0
    unit: dict[str, Any] = field(default_factory=dict)

    def made(self, history: Path | None = None) -> GoldenUnit:
        about = {"clock": FakeClock(START_NS), "history": History(history, "there is none")} | self.unit
        identity = Identity(unit_number(about.get("serial", SERIAL)), STAMP.identity.session)
        unit = GoldenUnit(**about, identity=identity)
        unit.live(self.before_s, self.before)
        self.act(unit)
        unit.live(self.for_s, self.shown)
        unit.live(self.then_s)
        return unit

    def record(self, path: Path) -> None:
        """Write the history of this unit: its last measurement, its state and its events."""
        unit = self.made()
        now_ns, report = unit.clock.monotonic_ns(), unit.published.state()
        wall_us = round(unit.clock.utc(now_ns).timestamp() * US)  # type: ignore[union-attr]
        worst = report.causes[0] if report is not None and report.causes else None
        fault = (0, "") if worst is None else (worst.signal.severity, str(worst.cause.kind))
        shown = unit.board.read()
        items = [StateSample(wall_us - US, fault), *([] if shown is None else [Sample(wall_us, shown)])]
        about = About(
            columns_of(unit.quantities, [area.name for area in unit.areas]), {"serial": unit.serial}
        )
        store = Store(path, MAX_BYTES, about)
        store.write(Batch(now_ns, wall_us + 2 * US, items, unit.health.events.after(0)))
        store.end(None)


OF_NOW = Solution(MEASURED.values, {}, MEASURED.motions).with_motion_in_sigma() or NO_SOLUTION


def invalid(*faults: Fault, of: Measurement = MEASURED) -> Measurement:
    return replace(of.without_numbers(faults), sequence=180, frames=0)


def warned(*reasons: Reason, of: Measurement = MEASURED) -> Measurement:
    return replace(of, status=tuple(Fault(reason, detail=f"{reason.brief}, 2 of 20") for reason in reasons))


def beam(*numbers: float, **fields: Any) -> Measurement:
    return changed(MEASURED, Beam(*numbers), {"front": numbers[:2], "rear": numbers[1::-1]}, **fields)  # type: ignore[dict-item]


def of_roll(quality: Quality, value: float | None, detail: str = "", expires_s: float = 1.0) -> Measurement:
    sigma, age_s = (None, None) if value is None else (0.012, 0.08)
    said = SensorValue(quality, detail, value, sigma, 0, age_s, round(expires_s * 1e9))
    return replace(MEASURED, quantities=WITH_ROLL).with_sensors({"roll_deg": said})


def seen(*conditions: Condition) -> Act:
    """Watches see these for the rest of the time, each somewhere else."""
    causes = [Cause(each, f"part {place}", f"0.{place} of it") for place, each in enumerate(conditions, 1)]
    return lambda unit: unit.watched.extend(causes)


def parts(state: State, trouble: CameraTrouble | None = None, /, **messages: str) -> Act:
    def act(unit: GoldenUnit) -> None:
        for name, message in messages.items():
            unit.health.component(name.replace("__", " ")).set_state(state, message, trouble)

    return act


OF_FRONT = PartVerdict("front", Verdict.GOOD, "", "mm", 0.001, 0.0015, 0.03, 0.1)


def checked(
    verdict: str,
    *reasons: str,
    cause: str = "schedule",
    lost: int = 0,
    of: PartVerdict = OF_FRONT,
    notes: str = "",
) -> Act:
    def act(unit: GoldenUnit) -> None:
        service = unit.published.self_check
        service.open(lambda: None)
        drift = TargetDrift("front", 6, 6, (LedState.USED,) * 6)
        check = SelfCheck(Verdict(verdict), {"front": drift}, {}, reasons, parts=(of,), notes=notes)
        time = datetime(2026, 11, 20, 8, 10, tzinfo=UTC)
        service.publish(SelfCheckReport(service.begin(), check, cause, time, lost))

    return act


def counting(unit: GoldenUnit) -> None:
    parts(State.DEGRADED, camera__front="loses frames: 3 in 10 s", kept__frames="the disk was too slow")(unit)
    for name, figures in (
        ("camera front", {"exposure_ms": 2.0, "gain_db": 0.5, "level": 0.021, "exposure_control": "auto"}),
        (MEASURING, {"skew_ms": 0.02, "diameter_front_px": 41.5, "peak_front": 200.25, "late": float("nan")}),
        ("temperature box", {"celsius": 41.0625}),
    ):
        unit.health.component(name).observe(figures)
    unit.health.component("camera front").count("lost", 3)
    unit.health.component(MEASURING).count("dropped_front", 2)
    unit.health.component(MEASURING).count("late_frames", 7)
    unit.health.component("temperature box").set_state(State.OK)


def silent(unit: GoldenUnit) -> None:
    unit.health.component("history").expect(2.0)
    unit.health.component("indicators").set_state(State.STARTING)


def zeroed(unit: GoldenUnit) -> None:
    unit.published.zero.set(unit.board, "modbus")


def uncalibrated(unit: GoldenUnit) -> None:
    unit.published.calibration = unit.published.calibration_files = None
    unit.published.facts = unit.published.facts.model_copy(update={"calibration": ""})


def long_past(unit: GoldenUnit) -> None:
    spans = (
        RunningSpan(60.0, 7200.0, 0.9975, "stale"),
        RunningSpan(90_000.0, 900_000.0, 0.5, "spot_missing"),
    )
    unit.availability.before = Before(2_000_000.0, spans)


def noted(unit: GoldenUnit) -> None:
    for kind in EventKind:
        unit.health.events.note(
            kind, f"{kind.meaning}: caf\u00e9 \x1b[1m", "front", None, {"code": str(kind), "n": 1}
        )
    for number in range(30):
        unit.health.events.note(EventKind.CONFIG, f"the settings, {number}", None, 3)


def of(scope: Scope, targets: Iterable[str | None]) -> tuple[Fault, ...]:
    found = [reason for reason in Reason if reason.scope is scope and reason is not Reason.REHEARSAL]
    where = list(targets)
    return tuple(
        Fault(reason, where[place % len(where)], f"for a person, {place}")
        for place, reason in enumerate(found)
    )


def with_signal(signal: Signal) -> tuple[Condition, ...]:
    return tuple(each for each in Condition if each.signal is signal)


WITH_ROLL = QUANTITIES.with_sensor("roll_deg")
ROLL = {"quantities": WITH_ROLL}
REHEARSAL = {"rehearsal": True}
FIVE, TEN = (tuple(f"t{number}" for number in range(1, count + 1)) for count in (5, 10))
MOVED_MM = {"t1": (0.0, -0.0), "t2": (1.25, -0.5), "t3": (-0.00004, 0.00006), "t4": (123.4567, -0.1)}
ROW = measurement_of_row(FIVE, MOVED_MM, time=MEASURED.time)
LOST = measurement_of_row(FIVE, {"t2": MOVED_MM["t2"]}, time=MEASURED.time, lost=("t4", "t5"))
PLATE = Measurement(
    160, 8_000_000_000, MEASURED.time, 20, OF_PLATE,
    {"a_mm": Value(12.3456, 0.004, 0.001), "b_mm": Value(-7.5, 0.005), "phi_deg": Value(-179.99996, 0.0021)},
    {},
)  # fmt: skip
DARK = "nothing is brighter than the background"
SPOTS = (Fault(Reason.SPOT_MISSING, "front", DARK), Fault(Reason.SPOT_MISSING, "rear", DARK))
SILENT = Fault(Reason.CAMERA_SILENT, "rear", "no frame for 3.2 s")
OF_LOST = (Fault(Reason.STUCK_CLEAR, "t4", "bright"), Fault(Reason.SPOT_MISSING, "t5"))
UNLIT = (Fault(Reason.LEDS_MISSING, None, "1 of 4"), Fault(Reason.LEDS_MISFIT))
SHAKEN = {key: Value(of.value, of.sigma and 0.05, of.sigma) for key, of in MEASURED.values.items()}


def of_row(names: tuple[str, ...], shown: Measurement, **more: Any) -> Case:
    corners = ((-40.0, -40.0), (40.0, -40.0), (0.0, 40.0))
    areas = tuple(TargetArea(name, 1000.0 * place, corners) for place, name in enumerate(names))
    return Case(shown, before=ROW, unit={"quantities": quantities_of(names), "areas": areas, **more})


def of_plate(shown: Measurement) -> Case:
    return Case(shown, before=PLATE, unit={"quantities": OF_PLATE, "areas": ()})


def failed(**more: str) -> Act:
    stated = {"modbus_tcp": "port 502 is in use", "lamps": "gone", "inclinometer": "no port", **more}
    return parts(State.FAILED, CameraTrouble.LOST, **stated)


CASES: dict[str, Case] = {
    "valid": Case(),
    "spots missing": Case(invalid(*SPOTS)),
    "starting": Case(None, before_s=0.0),
    "nothing measured": Case(None, before=None),
    "stale": Case(then_s=1.5),
    "each reason of a target": Case(invalid(*of(Scope.TARGET, ["front", "rear"]))),
    "each reason of the unit": Case(invalid(*of(Scope.UNIT, [None]))),
    "each warning": Case(replace(MEASURED, status=of(Scope.WARNING, [None])), for_s=12.0, unit=REHEARSAL),
    "several reasons": Case(invalid(SPOTS[0], SILENT, Fault(Reason.OUT_OF_STEP))),
    "warnings": Case(warned(Reason.EXPOSURES_LOST, Reason.GEOMETRY_SUSPECT, Reason.COMPENSATED), for_s=12.0),
    "no reason": Case(invalid()),
    "playback": Case(warned(Reason.PLAYBACK)),
    "simulated": Case(warned(Reason.SIMULATED)),
    "rehearsal": Case(warned(Reason.PLAYBACK, Reason.SIMULATED), unit=REHEARSAL),
    "rehearsal of cameras": Case(unit=REHEARSAL),
    "zero": Case(beam(-3.5, 4.9871, 1.1, -1.8, 0.003, 0.005, 0.0012, 0.0009), zeroed),
    "roll": Case(of_roll(Quality.GOOD, -0.123456), unit=ROLL),
    "roll reduced": Case(of_roll(Quality.REDUCED, 179.999996), unit=ROLL),
    "roll missing": Case(of_roll(Quality.NO_ANSWER, None, "it does not answer"), unit=ROLL, for_s=12.0),
    "roll old": Case(of_roll(Quality.GOOD, 0.5, expires_s=0.1), unit=ROLL, then_s=TICK_S),
    "roll without beam": Case(invalid(*SPOTS, of=of_roll(Quality.GOOD, 1.0)), unit=ROLL),
    "no motion": Case(replace(MEASURED, motions={})),
    "no time": Case(replace(MEASURED, time=None)),
    "limits": Case(beam(214748.3647, -214748.3648, 1e39, -1e300, 1e-9, 1e9, 0.0, 1e39, frames=70_000)),
    "largest counts": Case(replace(MEASURED, sequence=2**32 - 1, frames=65_535)),
    "count beyond": Case(replace(MEASURED, sequence=2**32 + 5)),
    "hidden vibration": Case(replace(MEASURED, values=SHAKEN)),
    "negative zero": Case(beam(-0.0, -0.00004, -0.0, -0.000004, 0.00004, 0.0, 0.000004, 0.00001)),
    "halves": Case(beam(0.00005, 2.00015, 0.00025, -1.000005, 0.00045, 0.00055, 0.000005, 0.000015)),
    "sigma with motion": Case(replace(MEASURED, values=OF_NOW.values, motions=OF_NOW.motions)),
    "maintenance": Case(act=seen(*with_signal(Signal.MAINTENANCE_REQUIRED)), for_s=12.0),
    "out of specification": Case(act=seen(*with_signal(Signal.OUT_OF_SPECIFICATION))),
    "failure": Case(act=seen(*with_signal(Signal.FAILURE))),
    "function check": Case(invalid(Fault(Reason.SELF_CHECKING)), seen(*with_signal(Signal.CHECK_FUNCTION))),
    "busy": Case(
        invalid(SILENT), parts(State.FAILED, CameraTrouble.BUSY, camera__rear="busy: another program uses it")
    ),
    "parts failed": Case(act=failed(camera__rear="lost", temperature__box="", stage="?")),
    "parts ended": Case(act=parts(State.ENDED, camera__front="the recording is at its end", mqtt="defect")),
    "parts degraded": Case(act=counting, for_s=12.0),
    "parts count": Case(act=counting),
    "parts silent": Case(act=silent, for_s=16.0),
    "just gone": Case(act=lambda unit: unit.live(1.0, invalid(*SPOTS))),
    "check good": Case(act=checked("good")),
    "check suspect": Case(act=checked("suspect", "front: moved by 0.04 mm", notes=("2 LEDs are dim",))),
    "check bad": Case(act=checked("bad", "front: moved by 0.2 mm", of=replace(OF_FRONT, error=None))),
    "check unknown": Case(act=checked("unknown", "too few LEDs", cause="request", lost=2)),
    "calibration due": Case(act=seen(Condition.CALIBRATION_DUE, Condition.CLOCK_WRONG), for_s=12.0),
    "availability": Case(act=long_past),
    "events": Case(act=noted),
    "another unit": Case(act=uncalibrated, unit={"serial": "Ä/7 #2,é" + "x" * 40}),
    "row": of_row(FIVE, ROW),
    "row in part": of_row(FIVE, replace(LOST, status=(*of(Scope.WARNING, FIVE), *OF_LOST)), rehearsal=True),
    "row lost": of_row(FIVE, invalid(Fault(Reason.BEAM_LOST, None, "behind t1"), of=ROW)),
    "row of ten": of_row(TEN, measurement_of_row(TEN, dict.fromkeys(TEN, (0.5, -0.25)), time=MEASURED.time)),
    "plate": of_plate(PLATE),
    "plate without lights": of_plate(invalid(*UNLIT, of=PLATE)),
}  # fmt: skip
