"""The unit at Debian's mosquitto, read by mosquitto_sub: what arrives, what stays, what an outage does."""

import asyncio
import json
import os
import resource
import signal
import statistics
import subprocess
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from support.foreign import need_program
from support.mqtt import PublishingUnit, Valve, mosquitto, subscribed
from support.places import DOCS
from support.played_unit import PlayedUnit, playing
from support.ports import free_port

from altd.publish.mqtt import broker as connection
from altd.publish.mqtt import connecting, publisher
from altd.reasons import Reason
from altd.records import Fault
from altd.runtime import supervision
from altd.status.health import State
from altd.status.measurement_json import as_object
from benchmarks.process_memory import resident_mb
from tools.pages.example import MEASURED

OPEN = "allow_anonymous true"
RESTARTS = int(os.environ.get("ALTD_BENCH_RESTARTS", "12"))
WARM_UP = 5
"""Restarts after which nothing more is loaded."""


@pytest.fixture(autouse=True)
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    for place, name, value in (
        (connecting, "INTERVAL_S", 0.05),
        (connecting, "MAX_JITTER_S", 0.0),
        (supervision, "MIN_BACKOFF_S", 0.02),
        (supervision, "MAX_BACKOFF_S", 0.02),
    ):
        monkeypatch.setattr(place, name, value)


def checked(payload: str, name: str) -> dict[str, Any]:
    """A payload that its published schema takes, and whose CRC is right."""
    schema = json.loads((DOCS / "mqtt.schema.json").read_text())
    document: dict[str, Any] = json.loads(payload)
    jsonschema.validate(document, {"$ref": f"#/$defs/{name}", "$defs": schema["$defs"]})
    body, _, crc = payload.rpartition(', "crc32": "')
    assert f"{zlib.crc32(body.encode()):08X}" == crc.removesuffix('"}')
    return document


async def names_at_once(port: int) -> dict[str, str]:
    """The messages for a late subscriber that no unit sends to any more: topic and payload."""
    async with subscribed(port, "--retained-only", "-W", "1") as late:
        return {topic.rpartition("/")[2]: payload for topic, _, _, payload in await late.all()}


async def test_a_foreign_client_gets_what_the_schemas_say_and_a_late_one_no_number(tmp_path: Path) -> None:
    with mosquitto(tmp_path, OPEN) as (port, _):
        unit = PublishingUnit.made(port, every_measurement=True, topic="plant/line-4")
        async with subscribed(port, topic="plant/line-4/ALT-0007/#") as client, unit.running():
            birth = checked((await client.next("/birth"))[3], "Birth")
            assert (birth["serial"], birth["unit"]) == ("ALT-0007", "1E4B2D8E")
            assert (await client.next("/availability"))[3] == "online"
            unit.measure(7)
            expected = as_object(unit.board.read() or MEASURED)
            told = await client.next("/measurement")
            measured = checked(told[3], "Measurement")
            assert told[1:3] == (1, False)
            assert measured.items() >= expected.items()
            summary = checked((await client.next("/summary"))[3], "Summary")
            while summary["count"] == 0:
                summary = checked((await client.next("/summary"))[3], "Summary")
            assert summary["x_mm"].pop("sigma_now") > 0.004
            assert summary["x_mm"] == {"mean": 10.012, "min": 10.012, "max": 10.012, "sigma": 0.004}
            assert summary["message"] > measured["message"] > birth["message"]
            async with subscribed(port, topic="plant/#") as late:
                retained = [await late.next() for _ in range(4)]
            kept = {topic.rpartition("/")[2]: payload for topic, _, is_kept, payload in retained if is_kept}
            assert set(kept) == {"birth", "state", "availability"}
            assert checked(kept["state"], "State")["unit"] == birth["unit"]


async def test_a_unit_that_is_killed_is_offline_and_leaves_no_number(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    """The whole daemon; what it plays is said to be played."""
    with mosquitto(tmp_path, OPEN) as (port, _):
        more = f'[mqtt]\nhost = "localhost"\nport = {port}\nevery_measurement = true\n'
        async with subscribed(port) as client:
            with playing(played_unit, tmp_path, subprocess.DEVNULL, more=more):
                codes = set[str]()
                while "playback" not in codes:
                    state = checked((await client.next("/state"))[3], "State")
                    codes = {cause["code"] for cause in state["causes"]}
                assert state["signal"] != "good"
                measured = checked((await client.next("/measurement"))[3], "Measurement")
                while not measured["valid"]:
                    measured = checked((await client.next("/measurement"))[3], "Measurement")
                assert "playback" in measured["status"]
                assert "playback" in checked((await client.next("/summary"))[3], "Summary")["status"]
            while (await client.next("/availability"))[3] != "offline":
                pass
        kept = await names_at_once(port)
    assert set(kept) == {"birth", "state", "availability"}
    assert kept["availability"] == "offline"


async def test_online_does_not_outlive_a_unit_and_a_broker_that_die_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The broker forgets the will with the connection, and keeps what it has on its disk."""
    monkeypatch.setattr(publisher, "RETAINED_EXPIRY_S", 5)
    disk = ("persistence true", f"persistence_location {tmp_path}/")
    with mosquitto(tmp_path, OPEN, *disk) as (port, first):
        unit = PublishingUnit.made(port)
        async with subscribed(port) as client, unit.running():
            unit.measure(1)
            await client.next("/summary")
            first.send_signal(signal.SIGUSR1)  # write to disk
            for _ in range(20):  # a second
                await client.next("/summary")
            assert (tmp_path / "mosquitto.db").exists()
            first.kill()
            await unit.until(State.FAILED)
    deadline = asyncio.get_running_loop().time() + 20
    with mosquitto(tmp_path, OPEN, *disk, port=port):
        while "availability" in (kept := await names_at_once(port)):
            assert asyncio.get_running_loop().time() < deadline, kept
    assert set(kept) == {"birth"}


async def test_a_subscriber_that_was_away_gets_no_old_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a session that the broker keeps, it gets what was queued for it: nothing older than 2 s."""
    monkeypatch.setattr(publisher, "NUMBERS_EXPIRY_S", 1)
    kept = ("-c", "-i", "away", "-x", "600")
    with mosquitto(tmp_path, OPEN) as (port, _):
        unit = PublishingUnit.made(port, every_measurement=True)
        async with unit.running(), subscribed(port) as present:
            async with subscribed(port, *kept, topic="altd/+/measurement") as client:
                unit.measure(1)
                await client.next("/measurement")
            for sequence in range(2, 12):
                unit.measure(sequence)
                await present.next("/measurement")
            for _ in range(60):  # summaries: three seconds
                await present.next("/summary")
            unit.measure(12)
            async with subscribed(port, *kept, topic="altd/+/measurement") as client:
                back = [json.loads((await client.next("/measurement"))[3])]
                while back[-1]["sequence"] != 12:
                    back.append(json.loads((await client.next("/measurement"))[3]))
    assert [each["sequence"] for each in back if each["valid"]] == [12]


@pytest.mark.parametrize("settings", [{}, {"sparkplug": {"group": "plant-4"}}], ids=["JSON", "Sparkplug"])
async def test_a_broker_that_is_absent_comes_goes_and_is_restarted_again_and_again(
    tmp_path: Path, settings: dict[str, Any]
) -> None:
    """``ALTD_BENCH_RESTARTS=100 pytest -s`` restarts more often and prints figures."""
    port, sessions, messages, back_s = free_port(), set[str](), list[int](), list[float]()
    unit, hexadecimal = PublishingUnit.made(port, **settings), ("-F", "%t %q %r %x") if settings else ()
    async with unit.running():
        assert (await unit.until(State.FAILED)).startswith("Connection refused; next try in")
        for sequence in range(RESTARTS):
            with mosquitto(tmp_path, OPEN, port=port) as (_, process):
                began_s = time.monotonic()
                await unit.until(State.OK)
                back_s.append(time.monotonic() - began_s)
                async with subscribed(port, *hexadecimal, topic="#") as client:
                    unit.measure(sequence)
                    if settings:
                        await client.next("/NDATA/ALT-0007")
                    else:
                        assert (await client.next("/availability"))[3] == "online"
                        summary = checked((await client.next("/summary"))[3], "Summary")
                        sessions.add(summary["session"])
                        messages.append(summary["message"])
                if sequence % 2:
                    process.kill()
            await unit.until(State.FAILED)
            if sequence == WARM_UP:
                before_mb, before = resident_mb(), _left()
        assert _left() == before
    assert len(sessions) == (not settings)
    assert messages == sorted(messages)
    assert unit.component.counters["failures"] == RESTARTS + 1
    back = f"back after {statistics.median(back_s):.3f} s, at most {max(back_s):.3f} s"
    print(f"{RESTARTS} restarts, {back}; {before_mb:.1f} to {resident_mb():.1f} MB")


def _left() -> tuple[int, int]:
    """Descriptors and tasks."""
    return _files(os.getpid()), len(asyncio.all_tasks())


def _files(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[int]:
    """A broker that knows one user, who may write below altd alone."""
    program = need_program("mosquitto_passwd", "mosquitto")
    passwords, rights = tmp_path / "passwords", tmp_path / "rights"
    subprocess.run([program, "-b", "-c", passwords, "unit", "right"], check=True)
    rights.write_text("user unit\ntopic write altd/#\n")
    lines = ("allow_anonymous false", f"password_file {passwords}", f"acl_file {rights}")
    with mosquitto(tmp_path, *lines) as (port, _):
        yield port


async def test_a_wrong_password_and_a_forbidden_topic_are_said_in_a_sentence(
    guarded: int, tmp_path: Path
) -> None:
    login = tmp_path / "login"
    login.touch(0o600)
    login.write_text("unit\nwrong\n")
    unit = PublishingUnit.made(guarded, credentials=login)
    async with unit.running():
        await unit.until(State.FAILED, "the broker refuses the unit: Not authorized; see user name")
        login.write_text("unit\nright\n")
        await unit.until(State.OK)
    unit = PublishingUnit.made(guarded, credentials=login, topic="other")
    async with unit.running():
        await unit.until(State.FAILED, "the broker refuses a message: Not authorized")


@pytest.mark.parametrize(
    ("line", "state", "sentence"),
    [
        ("retain_available false", State.OK, "connected, without TLS; the broker keeps no retained messages"),
        ("max_qos 0", State.OK, "connected, without TLS; the broker supports only QoS 0"),
        ("max_packet_size 1000", State.DEGRADED, "the broker accepts only 1000 bytes in a message; not sent"),
    ],
)
async def test_a_broker_that_can_do_less_gets_no_more(
    tmp_path: Path, line: str, state: State, sentence: str
) -> None:
    with mosquitto(tmp_path, OPEN, line) as (port, _):
        unit = PublishingUnit.made(port)
        async with subscribed(port) as client, unit.running():
            unit.measure(1)
            await unit.until(state, sentence)
            for _ in range(20):
                checked((await client.next("/summary"))[3], "Summary")
            assert unit.component.counters.get("failures", 0) <= 1


async def test_a_broker_without_a_free_file_is_named_and_taken_once_it_has_one(tmp_path: Path) -> None:
    """As Mosquitto for about the 1,016th unit, if systemd allows it 1,024 files."""
    with mosquitto(tmp_path, OPEN) as (port, broker):
        limit, most = resource.prlimit(broker.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(broker.pid, resource.RLIMIT_NOFILE, (_files(broker.pid), most))
        unit = PublishingUnit.made(port)
        async with unit.running():
            said = await unit.until(State.FAILED, "the broker closed the connection before it answered")
            assert "how many connections and files it may have" in said
            resource.prlimit(broker.pid, resource.RLIMIT_NOFILE, (limit, most))
            await unit.until(State.OK)


async def test_two_units_with_one_serial_number_name_each_other(tmp_path: Path) -> None:
    """mosquitto 2.0.11 closes the connection without a reason."""
    with mosquitto(tmp_path, OPEN) as (port, _):
        one, other = PublishingUnit.made(port), PublishingUnit.made(port)
        async with one.running(), other.running():
            for unit in (one, other):
                await unit.until(State.FAILED, "another client uses this identifier")


def certified(folder: Path, name: str, *more: str, by: str = "") -> None:
    """A key, and a certificate that ``by`` signs; without it, one that signs itself."""
    line = [need_program("openssl"), "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    line += ["-noenc", "-days", "30", "-subj", f"/CN={name}", *more]
    line += ["-CA", f"{folder}/{by}.pem", "-CAkey", f"{folder}/{by}.key"] if by else []
    out = ["-keyout", f"{folder}/{name}.key", "-out", f"{folder}/{name}.pem"]
    subprocess.run([*line, *out], check=True, capture_output=True)
    (folder / f"{name}.key").chmod(0o640)


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("certificates")
    for name in ("plant", "stranger"):
        certified(folder, name)
    certified(folder, "broker", "-addext", "subjectAltName=DNS:localhost", by="plant")
    certified(folder, "unit", by="plant")
    return folder


@pytest.fixture
def tls(certificates: Path, tmp_path: Path) -> Iterator[int]:
    files = {"cafile": "plant.pem", "certfile": "broker.pem", "keyfile": "broker.key"}
    lines = [f"{key} {certificates / file}" for key, file in files.items()]
    with mosquitto(tmp_path, OPEN, *lines, "require_certificate true") as (port, _):
        yield port


# paho leaves the socket of a failed handshake to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
async def test_over_tls_the_broker_has_to_be_vouched_for_and_is_shown_the_units_certificate(
    tls: int, certificates: Path
) -> None:
    own = {"certificate": certificates / "unit.pem", "key": certificates / "unit.key"}
    plant, stranger = certificates / "plant.pem", certificates / "stranger.pem"
    for settings, sentence in (
        ({"ca": stranger, **own}, "the broker's certificate is refused: self-signed certificate in"),
        (
            {"ca": plant, **own, "host": "127.0.0.1"},
            "the broker's certificate is refused: IP address mismatch",
        ),
        ({"ca": plant}, "the broker closed the connection"),
        ({}, "the broker closed the connection"),
    ):
        unit = PublishingUnit.made(tls, **{"host": "localhost"} | settings)
        async with unit.running():
            await unit.until(State.FAILED, sentence)
    unit = PublishingUnit.made(tls, host="localhost", ca=plant, **own)
    files = ("--cafile", str(plant), "--cert", str(own["certificate"]), "--key", str(own["key"]))
    async with subscribed(tls, "-h", "localhost", *files) as client, unit.running():
        unit.measure(5)
        checked((await client.next("/summary"))[3], "Summary")
        assert await unit.until(State.OK) == "connected"


async def test_a_broker_that_stops_reading_costs_messages_and_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "ACK_TIMEOUT_S", 0.3)
    monkeypatch.setattr(connection, "GOODBYE_TIMEOUT_S", 0.05)
    with mosquitto(tmp_path, OPEN) as (port, _):
        async with Valve(port) as valve, subscribed(port) as client:
            unit = PublishingUnit.made(valve.port, every_measurement=True)
            async with unit.running():
                unit.measure(0)
                await client.next("/measurement")
                valve.open.clear()
                for sequence in range(1, 2001):
                    unit.measure(sequence)
                    if sequence % 100 == 0:
                        await asyncio.sleep(0)
                await unit.until(State.FAILED, "the broker has not acknowledged a message for 0.3 s")
                valve.open.set()
                await unit.until(State.OK)
                unit.measure(2001, status=(Fault(Reason.ROLL_MISSING),))
                told = json.loads((await client.next("/measurement"))[3])
                sequences = [told["sequence"]]
                while sequences[-1] != 2001:
                    sequences.append(json.loads((await client.next("/measurement"))[3])["sequence"])
    assert len(sequences) <= 24, "what waited was sent"
    assert unit.component.counters["measurements_skipped"] >= 1900
