"""The Sparkplug profile at a broker that answers as a test chooses. A foreign decoder: the system tests."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from support.clock import FakeClock, settle
from support.measurements import measurement
from support.mqtt import ChosenBroker, Published, PublishingUnit

from altd.instruments.beam.instrument import QUANTITIES
from altd.publish.mqtt import broker as connection
from altd.publish.mqtt.sparkplug import Metric, Payload, Quality, measurement_metrics
from altd.reasons import Reason
from altd.records import Fault, Measurement, sensors
from altd.records.sensors import SensorValue
from altd.status.board import Board
from altd.status.health import State

COMMAND = "spBv1.0/g/NCMD/ALT-0007"
REBIRTH = b"\x12\x1a\x0a\x14Node Control/Rebirth\x20\x0b\x70\x01"


def made(port: int, **more: Any) -> PublishingUnit:
    return PublishingUnit.made(port, sparkplug={"group": "g"}, **more)


def message(payload: bytes, topic: str = COMMAND, flags: int = 0) -> bytes:
    """PUBLISH from a broker; ``flags``: QoS and retain."""
    number = b"\x00\x07" if flags & 6 else b""
    body = len(topic).to_bytes(2) + topic.encode() + number + b"\x00" + payload
    assert len(body) < 16384
    length = bytes([len(body)]) if len(body) < 128 else bytes([len(body) & 127 | 128, len(body) >> 7])
    return bytes([0x30 | flags]) + length + body


def value_of(told: Published, name: str) -> Any:
    (metric,) = (each for each in Payload.FromString(told.data).metrics if each.name == name)
    return next(
        (getattr(metric, f) for f in ("double_value", "long_value", "boolean_value") if metric.HasField(f)),
        None,
    )


async def settled(broker: ChosenBroker, condition: Callable[[], bool]) -> None:
    """Wait on the sockets of this process."""
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.001)


@pytest.mark.parametrize("group", ["plant 1", "Werk Süd (4)", "$line"])
async def test_a_group_has_any_characters_but_the_reserved_ones(group: str) -> None:
    """Sparkplug 3.0, 4.1.2: all of UTF-8 except + / #."""
    async with ChosenBroker() as broker:
        unit = PublishingUnit.made(broker.port, sparkplug={"group": group})
        async with unit.running():
            assert (await broker.until("ALT-0007")).topic == f"spBv1.0/{group}/NBIRTH/ALT-0007"


LIVE, PLAYED = measurement(), measurement(160, 0, Reason.PLAYBACK)


@pytest.mark.parametrize(
    ("shown", "quality", "without", "is_historical"),
    [
        (LIVE, Quality.GOOD, None, False),
        (measurement(160, 0, Reason.ROLL_MISSING), Quality.GOOD, None, False),
        (PLAYED, Quality.BAD, None, True),
        (measurement(160, 0, Reason.SIMULATED), Quality.BAD, None, True),
        (measurement(160, 0, Reason.REHEARSAL), Quality.BAD, None, True),
        (PLAYED.without_numbers((Fault(Reason.NOT_LIVE), *PLAYED.status)), None, Quality.BAD, True),
        (LIVE.without_numbers((Fault(Reason.SPOT_MISSING, "front"),)), None, Quality.BAD, False),
        (LIVE.without_numbers((Fault(Reason.STALE),)), None, Quality.STALE, False),
        (None, None, Quality.BAD, False),
    ],
)
def test_only_what_is_measured_now_is_good_and_no_old_number_stays(
    shown: Measurement | None, quality: Quality | None, without: Quality | None, is_historical: bool
) -> None:
    clock = FakeClock(10**9)
    metrics = {each.name: each for each in measurement_metrics(shown, Board(clock, 1.0, QUANTITIES), clock)}
    assert len(metrics) == 15
    for key in ("x_mm", "y_mm", "yaw_deg", "pitch_deg"):
        for name in (key, f"sigma/{key}"):
            assert (metrics[name].value is None) == (quality is None)
            assert metrics[name].quality is (without if quality is None else quality)
            assert metrics[name].is_historical is (is_historical and quality is not None)
    assert metrics["valid"].value is (quality is not None)
    assert metrics["valid"].is_historical is is_historical
    assert metrics["status"].value == " ".join(map(str, shown.status)) if shown else "warming_up"


def test_what_went_stale_is_later_than_the_values_before_it() -> None:
    """A host may keep the newer of two values."""
    clock = FakeClock(10**9)
    board = Board(clock, 1.0, QUANTITIES)

    def time_ms(shown: Measurement) -> int:
        return measurement_metrics(shown, board, clock)[0].time_ms

    board.publish(LIVE)
    before_ms = time_ms(LIVE)
    clock.now_ns += 10 * 10**9
    stale = board.read()
    assert stale is not None
    assert time_ms(stale) > before_ms
    assert not stale.valid


def test_roll_has_its_own_time_and_stays_when_the_beam_is_lost() -> None:
    clock, quantities = FakeClock(10**9), QUANTITIES.with_sensor("roll_deg")
    said = SensorValue(sensors.Quality.GOOD, value=1.25, sigma=0.1, t_ns=5 * 10**8, expires_ns=10**10)
    lost = (
        measurement().without_numbers((Fault(Reason.SPOT_MISSING, "front"),)).with_sensors({"roll_deg": said})
    )
    metrics = {each.name: each for each in measurement_metrics(lost, Board(clock, 1.0, quantities), clock)}
    roll: Metric = metrics["roll_deg"]
    assert (roll.value, roll.quality) == (1.25, Quality.GOOD)
    assert roll.time_ms == round(clock.utc(5 * 10**8).timestamp() * 1e3) != metrics["x_mm"].time_ms
    assert metrics["x_mm"].value is None


COMMANDS = {
    "nothing": message(b""),
    "noise": message(b"\xff" * 40),
    "a length beyond the end": message(b"\x12\xff\xff\xff\xff\x0f"),
    "many torn metrics": message(b"\x12" * 3000),
    "torn": message(REBIRTH[:-1]),
    "false": message(REBIRTH[:-1] + b"\x00"),
    "as a number": message(REBIRTH.replace(b"\x70\x01", b"\x50\x01")),
    "another case": message(REBIRTH.replace(b"Node Control/Rebirth", b"node control/rebirth")),
    "another command": message(REBIRTH.replace(b"Node Control/Rebirth", b"Node Control/Reboot!")),
    "no UTF-8": message(REBIRTH.replace(b"Node Control/Rebirth", b"x_mm\xff\xfe Contr/Rebirth")),
    "an alias": message(b"\x12\x06\x10\x01\x20\x0b\x70\x01"),
    "retained": message(REBIRTH, flags=1),
    "retained, with QoS 1": message(REBIRTH, flags=3),
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
async def test_whatever_else_a_command_asks_for_is_refused_and_counted(command: bytes) -> None:
    async with ChosenBroker() as broker:
        unit = made(broker.port)
        async with unit.running():
            await broker.until("NBIRTH/ALT-0007")
            broker.tell(command)
            await settled(broker, lambda: unit.component.counters.get("commands_refused", 0) == 1)
            assert "rebirths_requested" not in unit.component.counters
            broker.tell(message(REBIRTH, flags=2))
            await broker.until("NBIRTH/ALT-0007")
            assert unit.component.state is State.OK


async def test_a_flood_of_requests_gives_one_birth_a_second() -> None:
    """At most one message in ``REBIRTH_INTERVAL_S``, with what is measured then."""
    clock = FakeClock(10**9)
    async with ChosenBroker() as broker:
        unit = made(broker.port, clock=clock, every_measurement=True)
        async with unit.running():
            await broker.until("NBIRTH/ALT-0007")
            await unit.until(State.OK)
            for wanted in (500, 1000):
                broker.tell(message(REBIRTH) * 500)
                await settled(broker, lambda: unit.component.counters.get("rebirths_requested", 0) == wanted)  # noqa: B023
                unit.measure(wanted)
                await settle()
                assert broker.published.empty(), "data between the request and the birth"
                await clock.advance(0.1)
                assert value_of(await broker.until(""), "sequence") == wanted
                await settle()
                assert broker.published.empty()


async def test_data_that_is_due_when_a_birth_is_asked_for_is_not_sent() -> None:
    """tck-id-operational-behavior-data-commands-rebirth-action-1: it stops immediately."""
    clock = FakeClock(10**9)
    async with ChosenBroker() as broker:
        unit = made(broker.port, clock=clock, every_measurement=True)
        async with unit.running():
            await broker.until("NBIRTH/ALT-0007")
            await unit.until(State.OK)
            await settle()
            unit.measure(1)  # the command comes in the same turn of the loop
            unit.publisher._take_command(REBIRTH, False)  # type: ignore[union-attr]  # noqa: SLF001
            await clock.advance(0.1)
            assert (await broker.until("")).topic.endswith("NBIRTH/ALT-0007")


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        (message(REBIRTH, "spBv1.0/g/NCMD/ALT-0008"), "on another topic than that of commands"),
        (message(REBIRTH, "spBv1.0/STATE/host"), "on another topic"),
        (message(b"x", "#"), "on another topic"),
        (message(REBIRTH, flags=4), "with QoS 2"),
        (bytes.fromhex("30 07 0000 03 23 0001 78"), "on another topic"),
        (message(b"x" * 12_000) * 10, "the broker sends more than acknowledgements"),
        (message(REBIRTH) * 3000, "the broker sends more than acknowledgements"),
        (b"\x30\xff\xff\xff\x7f" + bytes(100_000), "the broker sends more than acknowledgements"),
    ],
)
async def test_what_a_broker_may_not_send_ends_the_connection(told: bytes, sentence: str) -> None:
    async with ChosenBroker() as broker:
        unit = made(broker.port)
        async with unit.running():
            await unit.until(State.OK)
            broker.tell(told)
            await unit.until(State.FAILED, sentence)
            await unit.until(State.OK)


@pytest.mark.parametrize(("granted", "why"), [(0x87, "Not authorized"), (0, "Granted QoS 0")])
async def test_without_its_subscription_it_is_never_born(granted: int, why: str) -> None:
    async with ChosenBroker(granted=granted) as broker:
        unit = made(broker.port)
        async with unit.running():
            await unit.until(State.FAILED, f"refuses the subscription of {COMMAND}: {why}")
        assert broker.published.empty(), "a birth must be the first message"


async def test_a_message_waits_until_the_broker_has_read_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """QoS 0 has no acknowledgement: what waits in a broker's socket would be old when it continues."""
    async with ChosenBroker() as broker:
        unit = made(broker.port, every_measurement=True)
        async with unit.running():
            await unit.until(State.OK)
            broker.answers_pings = False
            unit.measure(0)
            while value_of(told := await broker.until(""), "sequence") != 0:
                pass
            for sequence in range(1, 101):
                unit.measure(sequence)
                await settle()
            assert broker.published.empty()
            broker.answers_pings = True
            broker.tell(b"\xd0\x00")
            told = await broker.until("NDATA/ALT-0007")
            assert value_of(told, "sequence") == 100
            monkeypatch.setattr(connection, "ACK_TIMEOUT_S", 0.05)
            broker.answers_pings = False
            await unit.until(State.FAILED, "has not acknowledged a message for 0.05 s")


async def test_the_number_of_births_counts_connections_that_were_made_and_wraps() -> None:
    async with ChosenBroker() as broker:
        port = broker.port
    unit = made(port)
    async with unit.running():
        for _ in range(3):
            await unit.until(State.FAILED, "Connection refused")
        async with ChosenBroker(port=port) as broker:
            assert value_of(await broker.until("NBIRTH/ALT-0007"), "bdSeq") == 0
            for expected, number in ((1, 0), (0, 255)):
                unit.publisher._bd_seq = number  # type: ignore[union-attr]  # noqa: SLF001
                broker.tell(b"\xe0\x00")
                assert value_of(await broker.until("NBIRTH/ALT-0007"), "bdSeq") == expected


async def test_without_the_time_there_is_no_birth(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock(10**9)
    monkeypatch.setattr(clock, "utc", lambda t_ns: None)
    async with ChosenBroker() as broker:
        unit = made(broker.port, clock=clock)
        async with unit.running():
            await unit.until(State.FAILED, "the unit does not know the UTC")
        assert broker.published.empty()
