"""The nodes of each instrument, and which numbers of a row and of a plate a client may use."""

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.common.node import Node
from support import history as past
from support.clock import FakeClock
from support.measurements import measurement_of_row
from support.opcua import AREAS, OpcUaUnit, Written, connected, read
from support.places import ROOT

from altd.history.columns import columns_of
from altd.history.history import History
from altd.history.records import About, Sample
from altd.instruments.planar.instrument import QUANTITIES as OF_PLATE
from altd.instruments.row.measurement import quantities_of
from altd.publish.opcua.process import ServedUnit
from altd.publish.opcua.quality import Status
from altd.reasons import Reason
from altd.records import Fault, Measurement, Value
from tools.pages.example import SERIAL

NAMES = ("t1", "t2", "t3", "t4")
MOVED_MM = {"t1": (0.0, 0.0), "t3": (0.32, -0.24)}
STALE_AFTER_S = 12.5
ROUND = measurement_of_row(
    NAMES,
    MOVED_MM,
    lost=("t2",),
    status=(
        Fault(Reason.BEAM_ANGLE_UNKNOWN),
        Fault(Reason.CAMERA_SILENT, "t2"),
        Fault(Reason.ALARM_DISPLACEMENT, "t3"),
        Fault(Reason.NO_BASELINE, "t4"),
    ),
)
OF_T3 = {
    "t3_dx_mm": 0.32,
    "t3_dy_mm": -0.24,
    "t3_dx_mm.sigma": 0.004,
    "targets.t3.x_mm": 1.25,
    "targets.t3.x_mm.sigma": 0.01,
    "targets.t3.significance": 7.5,
}
OF_T2 = [key.replace("t3", "t2") for key in OF_T3]
POSE = Measurement(
    sequence=160,
    t_ns=0,
    time=None,
    frames=4,
    quantities=OF_PLATE,
    values={
        "a_mm": Value(18.75, 0.003, 0.001),
        "b_mm": Value(659.09, 0.003, 0.001),
        "phi_deg": Value(-49.2486, 0.0015, 0.0005),
    },
    targets={},
)


@dataclass
class Served:
    clock: FakeClock
    unit: OpcUaUnit
    server: ServedUnit
    client: Client

    async def measure(self, of: Measurement, sequence: int = 160, **changes: Any) -> None:
        self.unit.measure(sequence, of, **changes)
        await self.server.take(self.unit.line())

    async def read(self, *keys: str) -> dict[str, Written]:
        return await read(self.client, *keys)

    async def statuses(self, *keys: str) -> set[Status]:
        return {each.status for each in (await self.read(*keys)).values()}


@contextlib.asynccontextmanager
async def serving(**fields: Any) -> AsyncIterator[Served]:
    clock = FakeClock(10**12)
    unit = OpcUaUnit(clock, **fields)
    async with unit.served() as server, connected(unit.url) as client:
        yield Served(clock, unit, server, client)


def row(**fields: Any) -> contextlib.AbstractAsyncContextManager[Served]:
    areas = tuple(replace(AREAS[0], name=name) for name in NAMES)
    return serving(quantities=quantities_of(NAMES), areas=areas, stale_after_s=STALE_AFTER_S, **fields)


def plate(**fields: Any) -> contextlib.AbstractAsyncContextManager[Served]:
    return serving(quantities=OF_PLATE, areas=(), **fields)


async def nodes_below(node: Node) -> AsyncIterator[str]:
    """Identifier, BrowseName, parent and type of each node of the unit, in the order of the server."""
    kinds, forward = ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward
    for below in await node.get_references(kinds, forward):
        name, parent = below.BrowseName, node.nodeid.Identifier
        if below.NodeId.NamespaceIndex == node.nodeid.NamespaceIndex:
            kind = below.TypeDefinition.Identifier
            yield f"{below.NodeId.Identifier} {name.NamespaceIndex}:{name.Name} {parent} {kind}"
            async for further in nodes_below(Node(node.session, below.NodeId)):
                yield further


async def test_the_nodes_of_a_beam_are_those_that_are_published() -> None:
    published = (ROOT / "tests/support/opcua_beam_nodes.txt").read_text().splitlines()
    async with serving() as on:
        assert [each async for each in nodes_below(on.client.get_node("ns=2;s=unit"))] == published


async def test_a_row_has_nodes_for_each_place_and_a_plate_for_its_pose() -> None:
    async with row() as on:
        found = [each async for each in nodes_below(on.client.get_node("ns=2;s=unit"))]
        unit = await on.client.get_node("ns=2;s=targets.t3.dx_mm_per_day.EngineeringUnits").read_value()
        area = await on.client.get_node("ns=2;s=targets.t3.x_mm.EURange").read_value()
    keys = {line.split()[0] for line in found}
    for name in NAMES:
        of_place = {line.split()[0] for line in found if line.split()[2] == f"targets.{name}"}
        assert of_place == {f"{name}_dx_mm", f"{name}_dy_mm"} | {
            f"targets.{name}.{key}"
            for key in ("x_mm", "y_mm", "dx_mm_per_day", "dy_mm_per_day", "significance", "valid", "status")
        }
    assert {"measured", "t1_dx_mm.sigma", "targets.t1.dy_mm_per_day.sigma"} <= keys
    assert not {"x_mm", "yaw_deg", "measured.sigma", "t1_dx_mm.sigma_now"} & keys
    assert (unit.UnitId, unit.DisplayName.Text, unit.Description.Text) == (-1, "mm/d", "millimetre per day")
    assert (area.Low, area.High) == (-70.0, 70.0)
    async with plate() as on:
        found = [each async for each in nodes_below(on.client.get_node("ns=2;s=unit"))]
    keys = {line.split()[0] for line in found}
    assert {"a_mm", "b_mm.sigma", "phi_deg", "phi_deg.EngineeringUnits"} <= keys
    assert not {key for key in keys if key.startswith(("targets", "x_mm", "yaw"))}
    assert not {key for key in keys if key.endswith("sigma_now")}


async def test_a_place_is_good_whatever_others_do_and_a_lost_one_is_bad_with_its_reason() -> None:
    async with row() as on:
        await on.measure(ROUND)
        found = await on.read(*OF_T3, *OF_T2, "measured", "valid")
        assert {key: found[key].value for key in OF_T3} == OF_T3
        assert {found[key].status for key in (*OF_T3, "measured", "valid")} == {Status.GOOD}
        assert found["measured"].value == 3.0
        for key in OF_T2:
            assert (found[key].value, found[key].status) == (None, Status.BAD_SENSOR_FAILURE)
        said = await on.read(*(f"targets.{name}.{key}" for name in NAMES for key in ("valid", "status")))
        assert {each.status for each in said.values()} == {Status.GOOD}
        assert [each.value for each in said.values()] == [
            *(True, []),
            *(False, ["camera_silent"]),
            *(True, ["alarm_displacement"]),
            *(True, ["no_baseline"]),
        ]
        found = await on.read("targets.t4.x_mm", "t4_dx_mm", "t4_dx_mm.sigma", "targets.t3.dx_mm_per_day")
        assert [each.value for each in found.values()] == [1.25, None, None, None]
        assert [each.status for each in found.values()] == [Status.GOOD, *[Status.BAD] * 3]


async def test_until_the_baseline_is_complete_no_displacement_is_a_number() -> None:
    async with row() as on:
        await on.measure(measurement_of_row(NAMES, status=(Fault(Reason.BASELINE_INCOMPLETE),)))
        found = await on.read(*(f"{name}_d{axis}_mm" for name in NAMES for axis in "xy"))
        assert {(each.value, each.status) for each in found.values()} == {(None, Status.BAD)}
        assert (await on.read("targets.t1.x_mm"))["targets.t1.x_mm"].status is Status.GOOD


async def test_a_place_that_is_lost_keeps_no_number_of_the_round_before() -> None:
    async with row() as on:
        await on.measure(ROUND)
        disagree = (Fault(Reason.STABLE_DISAGREE), Fault(Reason.SPOT_MISSING, "t3"))
        await on.measure(measurement_of_row(NAMES, lost=("t3",), status=disagree), 161)
        found = await on.read(*OF_T3, "t1_dx_mm")
        assert {(each.value, each.status) for each in found.values()} == {(None, Status.BAD)}
        silent = tuple(Fault(Reason.CAMERA_SILENT, name) for name in NAMES)
        await on.measure(ROUND, 162, values={}, targets={}, status=silent)
        found = await on.read(*OF_T3, "targets.t1.x_mm")
        assert {(each.value, each.status) for each in found.values()} == {(None, Status.BAD_SENSOR_FAILURE)}
        assert (await on.read("targets.t3.valid"))["targets.t3.valid"].value is False


async def test_a_round_is_fresh_as_long_as_the_row_says_and_then_none_of_it_is_a_number() -> None:
    flags = ("valid", "targets.t3.valid", "targets.t3.status")
    async with row() as on:
        await on.measure(ROUND)
        on.clock.now_ns += round((STALE_AFTER_S - 0.01) * 1e9)
        await on.server.take(on.unit.line())
        assert await on.statuses(*OF_T3, *flags) == {Status.GOOD}
        on.clock.now_ns += 20_000_000
        await on.server.live.withdraw_stale()
        assert await on.statuses(*OF_T3, *OF_T2, *flags) == {Status.BAD_NO_COMMUNICATION}
        await on.server.take(on.unit.line())
        found = await on.read(*OF_T3, *OF_T2, *flags, "status")
        assert found.pop("status").value[-1] == "stale"
        assert {(each.value, each.status) for each in found.values()} == {(None, Status.BAD_NO_COMMUNICATION)}


@pytest.mark.parametrize(
    ("instrument", "of", "reason", "numbers", "flags"),
    [
        (row, ROUND, Reason.SIMULATED, [*OF_T3, "measured"], ["valid", "targets.t3.valid"]),
        (plate, POSE, Reason.PLAYBACK, ["a_mm", "a_mm.sigma", "b_mm", "phi_deg"], ["valid"]),
    ],
)
async def test_numbers_that_are_not_from_cameras_are_never_good(
    instrument: Any, of: Measurement, reason: Reason, numbers: list[str], flags: list[str]
) -> None:
    status = (*of.status, Fault(reason))
    async with instrument() as live:
        await live.measure(of, status=status)
        found = await live.read(*numbers)
        assert {(each.value, each.status) for each in found.values()} == {(None, Status.BAD_OUT_OF_SERVICE)}
        assert {each.value for each in (await live.read(*flags)).values()} == {False}
    async with instrument(rehearsal=True) as rehearsing:
        await rehearsing.measure(of, status=status)
        assert await rehearsing.statuses(*numbers, *flags) == {Status.UNCERTAIN_SIMULATED_VALUE}


async def test_a_round_of_another_run_with_another_calibration_changes_nothing() -> None:
    async with row() as on:
        before = OpcUaUnit(on.clock, quantities=on.unit.quantities, areas=on.unit.areas)
        before.measure(159, ROUND)
        await on.server.take(before.line())
        assert await on.statuses(*OF_T3) == {Status.BAD_WAITING_FOR_INITIAL_DATA}
        assert on.server.live.lines_refused == 1


async def test_a_plate_has_its_pose_with_sigma_or_no_number() -> None:
    pose = {"a_mm": 18.75, "b_mm": 659.09, "phi_deg": -49.2486, "b_mm.sigma": 0.003, "phi_deg.sigma": 0.0015}
    async with plate() as on:
        await on.measure(POSE)
        found = await on.read(*pose, "valid")
        assert {key: found[key].value for key in pose} == pose
        assert {each.status for each in found.values()} == {Status.GOOD}
        for sequence, reason, status in (
            (161, Reason.LEDS_MISSING, Status.BAD),
            (162, Reason.CAMERA_SILENT, Status.BAD_SENSOR_FAILURE),
            (163, Reason.WRONG_CAMERA, Status.BAD_CONFIGURATION_ERROR),
        ):
            await on.measure(POSE, sequence, values={}, status=(Fault(reason),))
            found = await on.read(*pose, "valid", "status")
            assert {(found[key].value, found[key].status) for key in pose} == {(None, status)}
            assert (found["valid"].value, found["status"].value) == (False, [str(reason)])


async def test_the_history_of_a_place_is_bad_where_it_was_lost(tmp_path: Path) -> None:
    about = About(columns_of(quantities_of(NAMES), NAMES), {"serial": SERIAL, "version": "1"})
    store = past.store(tmp_path, about)
    simulated = replace(ROUND, status=(*ROUND.status, Fault(Reason.SIMULATED), Fault(Reason.REHEARSAL)))
    lost = measurement_of_row(NAMES, lost=("t3",), status=(Fault(Reason.OUT_OF_RANGE, "t3"),))
    rounds = [
        replace(of, sequence=number, time=datetime.fromtimestamp(past.START_S + number, UTC))
        for number, of in enumerate((ROUND, lost, simulated))
    ]
    samples = [Sample((past.START_S + number) * past.US, of) for number, of in enumerate(rounds)]
    store.write(past.batch(past.START_S + 4, samples))
    store.end(None)
    span = [datetime.fromtimestamp(past.START_S + second, UTC).replace(tzinfo=None) for second in (-1, 9)]
    async with row(history=History(tmp_path / "history.db")) as on:
        for key, value in (("t3_dx_mm", 0.32), ("targets.t3.x_mm", 1.25)):
            kept = await on.client.get_node(f"ns=2;s={key}").read_raw_history(*span)
            assert [(each.Value.Value, Status(each.StatusCode.value)) for each in kept] == [
                (value, Status.GOOD),
                (None, Status.BAD_OUT_OF_RANGE),
                (value, Status.UNCERTAIN_SIMULATED_VALUE),
            ]
        kept = await on.client.get_node("ns=2;s=t2_dx_mm").read_raw_history(*span)
        assert [Status(each.StatusCode.value) for each in kept] == [
            *(Status.BAD_SENSOR_FAILURE, Status.BAD, Status.BAD_SENSOR_FAILURE)
        ]
