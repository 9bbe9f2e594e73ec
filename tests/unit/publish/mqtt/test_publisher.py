"""The publisher at a broker that answers as a test chooses: late, never, with refusals, with nonsense."""

import asyncio
import json
import logging
import socket
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.clock import settle
from support.mqtt import CONNECTED, DISCONNECT, PUBLISH, ChosenBroker, Published, PublishingUnit

from altd.errors import BadInputError
from altd.publish.mqtt import broker as connection
from altd.publish.mqtt import connecting, publisher
from altd.reasons import Reason
from altd.records import Fault
from altd.status.health import State

PUBLISH_TO_UNIT = bytes.fromhex("30 06 00 01 61 00 78 79")


@pytest.fixture(autouse=True)
def nothing_is_logged(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """But for supervision's own line: no broker makes the unit log what it sends."""
    with caplog.at_level(logging.DEBUG):
        yield
    lines = [record for record in caplog.records if record.name not in ("altd", "asyncio")]
    lines += [
        record for record in caplog.records if record.name == "asyncio" and record.levelno > logging.DEBUG
    ]
    assert lines == []


def crc_holds(line: str) -> bool:
    body, _, crc = line.rpartition(', "crc32": "')
    return f"{zlib.crc32(body.encode()):08X}" == crc.removesuffix('"}')


async def test_who_it_is_comes_first_and_online_when_all_the_rest_is_there() -> None:
    async with ChosenBroker() as broker:
        unit = PublishingUnit.made(broker.port, home_assistant="homeassistant")
        async with unit.running():
            first = [await asyncio.wait_for(broker.published.get(), 60) for _ in range(5)]
            assert await unit.until(State.OK) == "connected, without TLS"
    assert [message.topic.rpartition("/")[2] for message in first] == [
        "birth",
        "config",
        "state",
        "availability",
        "summary",
    ]
    assert [message.qos for message in first] == [1] * 5
    assert [message.retain for message in first] == [True] * 4 + [False], "no number is retained"
    assert [message.expiry_s for message in first] == [None, 3600, 30, 30, 2]
    assert crc_holds(first[0].payload)
    assert crc_holds(first[2].payload)
    assert [json.loads(first[n].payload)["message"] for n in (0, 2, 4)] == [1, 2, 3]


async def test_it_says_offline_itself_when_it_ends_in_order() -> None:
    async with ChosenBroker() as broker:
        async with PublishingUnit.made(broker.port).running():
            await broker.until("summary")
        last = await broker.until("availability")
        while not broker.published.empty():
            last = broker.published.get_nowait()
        assert (last.payload, last.retain, last.expiry_s) == ("offline", True, None)
        assert await broker.ends.get() == DISCONNECT


async def test_it_leaves_the_will_to_a_broker_that_does_not_take_offline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """DISCONNECT would make the broker forget the will, and `online` would stay."""
    monkeypatch.setattr(connection, "GOODBYE_TIMEOUT_S", 0.05)
    async with ChosenBroker() as broker:
        async with PublishingUnit.made(broker.port).running():
            await broker.until("summary")
            broker.answer = lambda number: b""
        assert await broker.ends.get() == PUBLISH


async def test_a_name_that_is_not_resolved_holds_one_thread_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Asyncio's pool has few threads; other parts use it, and the end of the process waits for them."""
    may_end, lookups = threading.Event(), list[str]()

    def hang(host: str, *_: object, **__: object) -> list[object]:
        lookups.append(f"{host} in {threading.current_thread().name}")
        may_end.wait(60)
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", hang)
    monkeypatch.setattr(connection, "CONNECT_TIMEOUT_S", 0.05)
    unit = PublishingUnit.made(1, host="broker.example")
    async with unit.running():
        for _ in range(3):
            await unit.until(State.FAILED, "no answer within 0.05 s")
            unit.component.set_state(State.STARTING)
        assert lookups == ["broker.example in mqtt connect"]
        may_end.set()
        await unit.until(State.FAILED, "Temporary failure in name resolution")
        assert len(lookups) > 1


async def test_every_measurement_is_sent_once_and_then_that_it_is_stale() -> None:
    async with ChosenBroker() as broker:
        unit = PublishingUnit.made(broker.port, every_measurement=True)
        async with unit.running():
            await broker.until("availability")
            seen = []
            for sequence in range(3):
                unit.measure(sequence)
                seen.append(json.loads((await broker.until("measurement")).payload))
            unit.measure(3, t_ns=0, last_exposure_ns=0)
            stale = await broker.until("measurement")
            for _ in range(3):
                assert (await broker.until("")).topic.endswith(("summary", "state")), "it was sent again"
    assert [told["sequence"] for told in seen] == [0, 1, 2]
    assert all(told["valid"] for told in seen)
    assert json.loads(stale.payload)["status"] == ["stale"]
    assert crc_holds(stale.payload)
    assert json.loads(stale.payload)["x_mm"] is None


async def test_a_message_is_made_when_the_one_before_is_acknowledged_and_what_it_skips_is_counted() -> None:
    async with ChosenBroker() as broker:
        unit = PublishingUnit.made(broker.port, every_measurement=True)
        held: list[int] = []
        async with unit.running():
            await broker.until("availability")
            broker.answer = lambda number: held.append(number) or b""  # type: ignore[func-returns-value]
            unit.measure(0)
            await broker.until("")
            for sequence in range(1, 101):
                unit.measure(sequence)
                await settle()
            assert broker.published.empty(), "more than one message is on its way"
            assert len(held) == 1


async def test_a_broker_that_acknowledges_nothing_is_left_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "ACK_TIMEOUT_S", 0.05)
    monkeypatch.setattr(connection, "GOODBYE_TIMEOUT_S", 0.01)
    async with ChosenBroker(answer=lambda number: b"") as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            await unit.until(State.FAILED, "the broker has not acknowledged a message for 0.05 s")
            for _ in range(5):
                await asyncio.wait_for(broker.ends.get(), 60)
            broker.answer = ChosenBroker.answer
            await unit.until(State.OK)
            session = json.loads((await broker.until("summary")).payload)["session"]
    assert session == f"{unit.board.identity.session:08X}", (
        "the session is the daemon's, not the connection's"
    )


@pytest.mark.parametrize(
    ("greeting", "sentence"),
    [
        (bytes.fromhex("20 03 00 86 00"), "the broker refuses the unit: Bad user name or password; see"),
        (bytes.fromhex("20 03 00 84 00"), "the broker refuses the unit: Unsupported protocol version"),
        (bytes.fromhex("20 02 00 01"), "the broker refuses the unit: Unsupported protocol version"),
        (b"HTTP/1.1 400 Bad Request\r\n" + bytes(100), "the broker sent data that is not MQTT"),
        (
            bytes.fromhex("20 06 00 00 03 21 0000"),
            "the broker sent data that is not MQTT",
        ),
        (CONNECTED + PUBLISH_TO_UNIT, "the unit has no subscription"),
        (bytes.fromhex("20 03 00 95 00"), "the broker accepts only shorter messages"),
        (CONNECTED + bytes.fromhex("e0 02 8e 00"), "another client uses this identifier; check the serial"),
        (CONNECTED + bytes.fromhex("e0 02 95 00"), "the broker accepts only shorter messages"),
        (CONNECTED + bytes.fromhex("e0 02 8b 00"), "the broker ended the connection: Server shutting down"),
        (CONNECTED + bytes.fromhex("e0 02 9d 00"), "the broker ended the connection: Server moved"),
        (bytes.fromhex("20 03 00 9c 00"), "the broker refuses the unit: Use another server"),
        (CONNECTED * 2, "the broker sent data that is not MQTT"),
        (CONNECTED + bytes.fromhex("f0 02 18 00"), "the broker sent data that is not MQTT"),
        (CONNECTED + b"\x30\xff\xff\xff\x7f" + bytes(300_000), "the broker sends more than acknowledgements"),
        (CONNECTED + bytes.fromhex("3408 000161 0001 00 7879") * 10_000, "more than acknowledgements"),
        (CONNECTED + bytes.fromhex("3605 0001 61 00 78"), "the broker sent data that is not MQTT"),
        (CONNECTED + bytes.fromhex("4006 0001 00 ff ff ff"), "the broker sent data that is not MQTT"),
        (CONNECTED + b"\xd0\xff\xff\xff\xff\xff", "the broker sent data that is not MQTT"),
    ],
)
async def test_what_a_broker_may_not_send_ends_the_connection_with_a_sentence(
    greeting: bytes, sentence: str
) -> None:
    async with ChosenBroker(greeting) as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            await unit.until(State.FAILED, sentence)
            broker.greeting = CONNECTED
            await unit.until(State.OK)


def greeting_with(properties: str) -> bytes:
    packed = bytes.fromhex(properties)
    return bytes([0x20, len(packed) + 3, 0, 0, len(packed)]) + packed


@pytest.mark.parametrize(
    ("refusal", "properties", "sentence", "qos", "retain"),
    [
        ("20 03 00 9a 00", "25 00", "the broker keeps no retained messages", 1, False),
        ("20 03 00 9b 00", "24 00", "the broker supports only QoS 0", 0, True),
    ],
)
async def test_what_a_broker_cannot_do_is_named_and_not_asked_of_it(
    refusal: str, properties: str, sentence: str, qos: int, retain: bool
) -> None:
    """It refuses the will of the first connection, as it must (MQTT 5, 3.2.2.3.4 and 3.2.2.3.5)."""
    async with ChosenBroker(bytes.fromhex(refusal)) as broker:
        unit = PublishingUnit.made(broker.port, home_assistant="homeassistant")
        async with unit.running():
            failed = await unit.until(State.FAILED, sentence)
            broker.greeting = greeting_with(properties)
            assert await unit.until(State.OK) == f"connected, without TLS; {sentence}"
            sent = [await broker.until("") for _ in range(6)]
        last = await broker.until("availability")
        while not broker.published.empty():
            last = broker.published.get_nowait()
    assert "password" not in failed
    assert (broker.wills[0], broker.wills[-1]) == ((1, True), (qos, retain))
    assert {each.qos for each in sent} == {qos}
    assert any(each.retain for each in sent) is retain
    assert (last.payload, last.qos, last.retain) == ("offline", qos, retain)


async def test_a_broker_of_qos_0_that_stops_reading_gets_no_second_message() -> None:
    async with ChosenBroker(greeting_with("24 00"), answers_pings=False) as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            assert (await broker.until("birth")).qos == 0
            for _ in range(10):
                await settle()
            assert broker.published.empty()


async def test_a_message_that_is_too_long_for_the_broker_is_named_and_not_sent() -> None:
    async with ChosenBroker(greeting_with("27 000003e8")) as broker:
        unit = PublishingUnit.made(broker.port, home_assistant="homeassistant")
        async with unit.running():
            await broker.until("summary")
            said = await unit.until(State.DEGRADED)
            assert said.startswith(
                "the broker accepts only 1000 bytes in a message; not sent: altd/ALT-0007/birth (1"
            )
            assert "homeassistant/device/altd_1e4b2d8e/config" in said
            assert unit.component.counters["messages_too_long"] == 2
            assert broker.begins.qsize() == 1
            broker.greeting = greeting_with("27 00010000")
            broker.tell(bytes.fromhex("e0 02 8b 00"))
            assert await unit.until(State.OK) == "connected, without TLS"


async def test_no_more_messages_wait_for_acknowledgement_than_the_broker_accepts() -> None:
    """Receive Maximum 1, and two tasks that send."""
    async with ChosenBroker(greeting_with("21 0001")) as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            await unit.until(State.OK)
            session = unit.publisher._connection(None, None)  # noqa: SLF001
        async with session:
            broker.answer = lambda number: b""
            while not broker.published.empty():
                broker.published.get_nowait()
            sending = [asyncio.create_task(session.send(name, "1", expiry_s=None)) for name in "ab"]
            assert (await broker.until("a")).data == b"1"
            for _ in range(10):
                await settle()
            assert broker.published.empty()
            for each in sending:
                each.cancel()
            await asyncio.gather(*sending, return_exceptions=True)


async def test_a_connection_begins_clean_keeps_no_session_and_takes_the_brokers_keep_alive() -> None:
    """MQTT 5, 3.1.2, 3.2.2.3.14, and 3.4.2.1: 0x10, no subscriber, is no error."""
    slow = greeting_with("13 0001")
    async with ChosenBroker(slow, answer=lambda number: b"\x40\x03" + number.to_bytes(2) + b"\x10") as broker:
        unit = PublishingUnit.made(broker.port)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(connecting, "INTERVAL_S", 1000.0)
            async with unit.running():
                await unit.until(State.OK)
                for _ in range(2):
                    await asyncio.wait_for(broker.pings.get(), 20)
    head = b"\x00\x04MQTT\x05" + bytes([0b0010_1110]) + (10).to_bytes(2)
    properties = b"\x08\x21\x00\x08\x27\x00\x00\x10\x00"  # Receive Maximum and Maximum Packet Size alone
    topic, message = b"altd/ALT-0007/availability", b"offline"
    will = b"\x00" + len(topic).to_bytes(2) + topic + len(message).to_bytes(2) + message
    assert broker.connects == [head + properties + b"\x00\x0daltd_1e4b2d8e" + will]


async def test_a_message_that_the_broker_refuses_is_a_failure_though_it_is_acknowledged() -> None:
    async with ChosenBroker(answer=lambda number: b"\x40\x03" + number.to_bytes(2) + b"\x87") as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            await unit.until(State.FAILED, "the broker refuses a message: Not authorized")


async def test_an_acknowledgement_of_another_message_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "ACK_TIMEOUT_S", 0.05)
    monkeypatch.setattr(connection, "GOODBYE_TIMEOUT_S", 0.01)
    async with ChosenBroker(answer=lambda number: b"\x40\x02" + (number ^ 1).to_bytes(2)) as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            await unit.until(State.FAILED, "has not acknowledged")
            assert broker.published.qsize() <= broker.begins.qsize() * 2


async def test_nothing_is_queued_while_there_is_no_broker() -> None:
    async with ChosenBroker() as broker:
        port = broker.port
    unit = PublishingUnit.made(port, every_measurement=True)
    async with unit.running():
        await unit.until(State.FAILED, "Connection refused")
        for sequence in range(50):
            unit.measure(sequence)
        unit.measure(50, status=(Fault(Reason.PLAYBACK),))
        async with ChosenBroker(port=port) as broker:
            told = [json.loads((await broker.until("measurement")).payload)["sequence"]]
            summary = json.loads((await broker.until("summary")).payload)
            await unit.until(State.OK)
            unit.measure(51)
            told.append(json.loads((await broker.until("measurement")).payload)["sequence"])
    assert told == [50, 51], "the newest alone"
    assert (summary["count"], summary["status"]) == (1, ["not_live", "playback"])
    assert unit.component.counters["measurements_skipped"] == 50


async def test_a_cancelled_connection_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """At any point of it: before the broker's CONNACK, and before the first acknowledgement."""
    async with ChosenBroker(greeting=b"") as broker:
        async with PublishingUnit.made(broker.port).running():
            await asyncio.wait_for(broker.begins.get(), 60)
        await asyncio.wait_for(broker.ends.get(), 60)
        for steps in range(12):
            async with PublishingUnit.made(broker.port).running():
                for _ in range(steps):
                    await asyncio.sleep(0)
        for _ in range(broker.begins.qsize()):
            await asyncio.wait_for(broker.ends.get(), 60)


async def test_the_state_is_sent_when_it_changes_and_again_before_it_expires(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(publisher, "REFRESH_INTERVAL_S", 1000.0)
    async with ChosenBroker() as broker:
        unit = PublishingUnit.made(broker.port)
        async with unit.running():
            assert json.loads((await broker.until("state")).payload)["signal"] == "check_function"
            unit.health.component("camera front").set_state(State.FAILED, "no cable")
            states: list[Published] = []
            while not any('"camera_failed"' in state.payload for state in states):
                states.append(await broker.until("state"))
            assert "no cable" in states[-1].payload
            monkeypatch.setattr(publisher, "REFRESH_INTERVAL_S", 0.0)
            unit.publisher._refresh_ns = 0  # noqa: SLF001
            again = await broker.until("availability")
            assert (again.payload, again.expiry_s) == ("online", 30)


def test_files_that_cannot_be_used_are_named_at_the_start(tmp_path: Path) -> None:
    login = tmp_path / "login"
    for content, mode, sentence in (
        ("unit\nsecret\n", 0o644, "others than its owner may read or write it"),
        ("unit\n", 0o600, "must have two lines: the user name and the password"),
        ("\nsecret\n", 0o600, "must have two lines"),
    ):
        login.write_text(content)
        login.chmod(mode)
        with pytest.raises(BadInputError, match=sentence):
            PublishingUnit.made(1, credentials=login)
    with pytest.raises(BadInputError, match=r"ca\.pem: No such file"):
        PublishingUnit.made(1, ca=tmp_path / "ca.pem")
