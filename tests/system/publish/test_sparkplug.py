"""The unit as a Sparkplug edge node: a session with Debian's mosquitto, held against the specification.

One session is recorded: what the unit sends, packet by packet, and what mosquitto_sub hears, both decoded by
the npm package ``sparkplug-payload``. Each check names the requirements (``tck-id-…``) that it proves.
"""

import asyncio
import itertools
from collections.abc import Callable

import pytest
from support.mqtt import DISCONNECT, PINGREQ, PUBLISH, SUBSCRIBE
from support.sparkplug import BIRTH, COMMAND, DATA, DEATH, MEASUREMENTS, Recorded, record

from altd.publish.mqtt import connecting
from altd.runtime import supervision

REBIRTH = "Node Control/Rebirth"
TYPES = {"Int64", "Double", "Boolean", "String"}
QUALITIES = {0, 192, 500}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    with pytest.MonkeyPatch.context() as patch:
        for place, name, value in (
            (connecting, "INTERVAL_S", 0.05),
            (connecting, "MAX_JITTER_S", 0.0),
            (supervision, "MIN_BACKOFF_S", 0.02),
            (supervision, "MAX_BACKOFF_S", 0.02),
        ):
            patch.setattr(place, name, value)
        return asyncio.run(record(tmp_path_factory.mktemp("session")))


Check = Callable[[Recorded], None]
CHECKS: dict[str, Check] = {}


def proves(*identifiers: str) -> Callable[[Check], Check]:
    def add(check: Check) -> Check:
        CHECKS.update(dict.fromkeys(identifiers, check))
        return check

    return add


@proves(
    "intro-group-id-string",
    "intro-group-id-chars",
    "intro-edge-node-id-string",
    "intro-edge-node-id-chars",
    "topic-structure",
    "topic-structure-namespace-a",
    "topic-structure-namespace-valid-group-id",
    "topic-structure-namespace-valid-edge-node-id",
    "topic-structure-namespace-device-id-non-associated-message-types",
    "topics-nbirth-topic",
    "topics-ndata-topic",
    "topics-ndeath-topic",
    "message-flow-edge-node-birth-publish-nbirth-topic",
)
def topics(session: Recorded) -> None:
    assert {message.topic for message in session.sent} == {BIRTH, DATA, DEATH}
    assert {message.topic for message in session.heard} == {BIRTH, DATA, DEATH, COMMAND}


@proves("topics-ncmd-topic", "message-flow-edge-node-ncmd-subscribe")
def commands_are_subscribed_with_qos_1_before_the_birth(session: Recorded) -> None:
    for connection in session.connections:
        name = COMMAND.encode()
        assert connection.subscription[3 : 5 + len(name)] == len(name).to_bytes(2) + name
        assert connection.subscription[5 + len(name)] & 3 == 1
        assert connection.kinds.index(SUBSCRIBE) < connection.kinds.index(PUBLISH)


@proves("principles-persistence-clean-session-50")
def no_session_is_kept(session: Recorded) -> None:
    """Of its properties, Receive Maximum and Maximum Packet Size: Session Expiry Interval is 0 without it."""
    for connection in session.connections:
        assert connection.flags & 2
        assert connection.properties == b"\x21\x00\x08\x27\x00\x00\x10\x00"


@proves(
    "message-flow-edge-node-birth-publish-connect",
    "message-flow-edge-node-birth-publish-will-message",
    "message-flow-edge-node-birth-publish-will-message-topic",
    "message-flow-edge-node-birth-publish-will-message-qos",
    "message-flow-edge-node-birth-publish-will-message-will-retained",
    "payloads-ndeath-will-message",
    "payloads-ndeath-will-message-qos",
    "payloads-ndeath-will-message-retain",
)
def the_will_is_the_death(session: Recorded) -> None:
    for connection in session.connections:
        assert connection.flags & 4
        assert (connection.will.topic, connection.will.qos, connection.will.retain) == (DEATH, 1, False)


@proves(
    "topics-ndeath-payload",
    "topics-ndeath-seq",
    "payloads-ndeath-seq",
    "payloads-ndeath-bdseq",
    "topics-nbirth-bdseq-included",
    "topics-nbirth-bdseq-matching",
    "payloads-nbirth-bdseq",
    "payloads-nbirth-bdseq-repeat",
    "message-flow-edge-node-birth-publish-will-message-payload",
    "message-flow-edge-node-birth-publish-nbirth-payload-bdSeq",
    "operational-behavior-data-commands-rebirth-action-3",
)
def births_and_deaths_of_a_connection_have_one_number(session: Recorded) -> None:
    for connection in session.connections:
        number = connection.will.number("bdSeq")
        for death in (connection.will, *connection.of(DEATH)):
            assert "seq" not in death.payload
            assert list(death.metrics()) == ["bdSeq"]
            assert death.metrics()["bdSeq"]["type"] == "Int64"
            assert death.number("bdSeq") == number
        for birth in connection.of(BIRTH):
            assert birth.metrics()["bdSeq"]["type"] == "Int64"
            assert birth.number("bdSeq") == number
    assert [len(connection.of(BIRTH)) for connection in session.connections] == [2, 1]


@proves("topics-nbirth-bdseq-increment", "message-flow-edge-node-birth-publish-will-message-payload-bdSeq")
def the_number_begins_at_zero_and_grows_with_each_connection(session: Recorded) -> None:
    assert [connection.will.number("bdSeq") for connection in session.connections] == [0, 1]


@proves(
    "principles-birth-certificates-order",
    "topics-nbirth-seq-num",
    "payloads-nbirth-seq",
    "payloads-ndata-order",
    "payloads-sequence-num-req-nbirth",
    "message-flow-edge-node-birth-publish-nbirth-payload-seq",
)
def a_birth_comes_first_and_begins_the_sequence(session: Recorded) -> None:
    for connection in session.connections:
        assert connection.sent[0].topic == BIRTH
    assert {birth.payload["seq"] for birth in session.births} == {0}


@proves(
    "topics-ndata-seq-num",
    "payloads-ndata-seq",
    "payloads-ndata-seq-inc",
    "payloads-sequence-num-always-included",
    "payloads-sequence-num-incrementing",
)
def each_message_has_the_next_number(session: Recorded) -> None:
    seen = set()
    for connection in session.connections:
        living = [message for message in connection.sent if message.topic != DEATH]
        for before, after in itertools.pairwise(living):
            expected = 0 if after.topic == BIRTH else (before.payload["seq"] + 1) % 256
            assert after.payload["seq"] == expected
            seen.add(expected)
    assert seen == set(range(256))


@proves(
    "topics-nbirth-mqtt",
    "topics-ndata-mqtt",
    "payloads-nbirth-qos",
    "payloads-nbirth-retain",
    "payloads-ndata-qos",
    "payloads-ndata-retain",
    "message-flow-edge-node-birth-publish-nbirth-qos",
    "message-flow-edge-node-birth-publish-nbirth-retained",
)
def births_and_data_are_sent_with_qos_0_and_not_retained(session: Recorded) -> None:
    assert {(message.qos, message.retain) for message in session.living} == {(0, False)}
    assert not any(message.retain for message in session.heard)


@proves(
    "topics-nbirth-timestamp",
    "topics-ndata-timestamp",
    "payloads-timestamp-in-UTC",
    "payloads-metric-timestamp-in-UTC",
    "payloads-name-birth-data-requirement",
    "payloads-nbirth-timestamp",
    "payloads-ndata-timestamp",
)
def messages_have_the_time_of_sending_and_metrics_that_of_capture(session: Recorded) -> None:
    for message in session.living:
        assert session.from_ms - 1 <= message.payload["timestamp"] <= session.to_ms + 1
        for metric in message.payload["metrics"]:
            assert session.from_ms - 1000 <= metric["timestamp"] <= message.payload["timestamp"]
    metrics = [message.metrics() for message in session.of(DATA)]
    times = [each["x_mm"]["timestamp"] for each in metrics if "x_mm" in each]
    assert times == sorted(times)


@proves("operational-behavior-data-publish-nbirth-order")
def metrics_come_in_the_order_of_their_times(session: Recorded) -> None:
    for message in session.living:
        times = [metric["timestamp"] for metric in message.payload["metrics"]]
        assert times == sorted(times)


@proves(
    "topics-nbirth-metric-reqs",
    "topics-nbirth-metrics",
    "operational-behavior-data-publish-nbirth",
    "payloads-name-requirement",
    "payloads-metric-datatype-value-type",
    "payloads-metric-datatype-value",
    "payloads-metric-datatype-req",
    "message-flow-edge-node-birth-publish-nbirth-payload",
)
def a_birth_has_every_metric_with_name_type_and_value(session: Recorded) -> None:
    born = [
        {metric["name"]: metric["type"] for metric in birth.payload["metrics"]} for birth in session.births
    ]
    assert born[0] == born[1] == born[2]
    assert set(born[0].values()) == TYPES
    for data in session.of(DATA):
        assert {metric["name"]: metric["type"] for metric in data.payload["metrics"]}.items() <= born[
            0
        ].items()
    assert session.births[0].number("Properties/serial") == "ALT-0007"


@proves("operational-behavior-data-publish-nbirth-values")
def what_is_not_known_has_no_value(session: Recorded) -> None:
    first, again, third = session.births
    for birth, quality in ((first, 0), (again, 0)):
        assert birth.number("x_mm") is None
        assert birth.metrics()["x_mm"]["properties"]["Quality"]["value"] == quality
        assert birth.number("valid") is False
    assert first.number("status") == "warming_up"
    assert again.number("status") == third.number("status") == "front_spot_missing"
    assert again.number("sequence") == MEASUREMENTS


@proves("case-sensitivity-metric-names")
def names_differ_by_more_than_their_case(session: Recorded) -> None:
    names = session.births[0].metrics()
    assert len({name.lower() for name in names}) == len(names) == len(session.births[0].payload["metrics"])


@proves(
    "topics-nbirth-rebirth-metric",
    "payloads-nbirth-rebirth-req",
    "operational-behavior-data-commands-rebirth-name",
    "operational-behavior-data-commands-rebirth-datatype",
    "operational-behavior-data-commands-rebirth-value",
)
def a_birth_offers_the_rebirth(session: Recorded) -> None:
    for birth in session.births:
        metric = birth.metrics()[REBIRTH]
        assert (metric["type"], metric["value"]) == ("Boolean", False)


@proves("operational-behavior-data-commands-rebirth-action-2")
def a_birth_follows_the_request(session: Recorded) -> None:
    """On the same connection. Data may lie between: the unit had sent it before the request reached it."""
    topics = [message.topic for message in session.heard]
    after = topics[topics.index(COMMAND) + 1 :]
    assert set(after[: after.index(BIRTH)]) <= {DATA}


@proves(
    "payloads-propertyset-keys-array-size",
    "payloads-propertyset-values-array-size",
    "payloads-metric-propertyvalue-type-type",
    "payloads-metric-propertyvalue-type-value",
    "payloads-metric-propertyvalue-type-req",
    "payloads-propertyset-quality-value-type",
    "payloads-propertyset-quality-value-value",
)
def properties_are_the_quality_and_the_unit(session: Recorded) -> None:
    for message in session.living:
        for metric in message.payload["metrics"]:
            quality = metric["properties"]["Quality"]
            assert quality["type"] == "Int32"
            assert quality["value"] in QUALITIES
            if metric["type"] == "Double" and message.topic == BIRTH:
                assert metric["properties"]["engUnit"]["type"] == "String"
    assert session.births[0].metrics()["yaw_deg"]["properties"]["engUnit"]["value"] == "°"


@proves(
    "topics-ndata-payload", "operational-behavior-data-publish-nbirth-change", "principles-rbe-recommended"
)
def data_comes_when_something_changes(session: Recorded) -> None:
    sequences = [data.number("sequence") for data in session.of(DATA) if "sequence" in data.metrics()]
    assert [sequences[0], *(after for before, after in itertools.pairwise(sequences) if after != before)] == [
        *range(MEASUREMENTS + 2)
    ]
    good = [data for data in session.of(DATA) if data.metrics().get("valid", {}).get("value")]
    assert {(data.number("x_mm"), data.number("sigma/x_mm")) for data in good} == {(10.012, 0.004)}


@proves(
    "operational-behavior-edge-node-intentional-disconnect-ndeath",
    "operational-behavior-edge-node-intentional-disconnect-packet",
    "payloads-ndeath-will-message-publisher",
    "payloads-ndeath-will-message-publisher-disconnect-mqtt50",
)
def a_unit_that_ends_says_so_and_leaves_the_will_in_force(session: Recorded) -> None:
    """It sends no DISCONNECT, so that no reason code can be wrong."""
    lost, ended = session.connections
    assert not lost.of(DEATH)
    assert [message.topic for message in ended.sent].index(DEATH) == len(ended.sent) - 1
    assert (ended.sent[-1].qos, ended.sent[-1].retain) == (1, False)
    assert DISCONNECT not in lost.kinds + ended.kinds
    assert [message.number("bdSeq") for message in session.heard if message.topic == DEATH][:2] == [0, 1]


@proves("operational-behavior-primary-application-state-with-multiple-servers-single-server")
def each_message_is_read_by_the_broker_before_the_next(session: Recorded) -> None:
    for connection in session.connections:
        sent = [kind for kind in connection.kinds if kind in (PUBLISH, PINGREQ)]
        assert not any(pair == (PUBLISH, PUBLISH) for pair in itertools.pairwise(sent[:-1]))


@pytest.mark.parametrize("identifier", CHECKS)
def test_the_session_fulfils(identifier: str, session: Recorded) -> None:
    """The requirement ``tck-id-`` and identifier."""
    CHECKS[identifier](session)
