"""Commands, settings and files of docs/security.md: a unit, its clients and a broker with one authority."""

import contextlib
import json
import re
import shutil
import socket
import ssl
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from support.cli import altd_here
from support.documented import commands_of
from support.foreign import need_program
from support.mqtt import mosquitto
from support.places import DOCS
from support.played_unit import PlayedUnit
from support.ports import free_port
from support.unit_toml import write_config

from altd.credentials.certificates import role_of

PAGE = "security.md"
SERIAL = "TEST-1"
READ_NEXT_ZERO = struct.pack(">BHH", 4, 502, 1)


def blocks(kind: str) -> list[str]:
    """The fenced blocks of the page of a kind."""
    parts = (DOCS / PAGE).read_text().split("```")[1::2]
    return [part.partition("\n")[2] for part in parts if part.partition("\n")[0] == kind]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the certificates; the unit and the broker are this computer."""
    folder = tmp_path_factory.mktemp("authority")
    need_program("openssl")
    for line in commands_of(PAGE, "Make certificates"):
        here = re.sub(r"192\.0\.2\.\d", "127.0.0.1", line).replace("ALT-0007", SERIAL)
        done = subprocess.run(["bash", "-c", here], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert done.stdout.count(": OK") == 4
    return folder


def context(folder: Path, name: str | None) -> ssl.SSLContext:
    trusted = ssl.create_default_context(cafile=folder / "ca.pem")
    if name is not None:
        trusted.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
    return trusted


def asked(port: int, tls: ssl.SSLContext, request: bytes) -> bytes:
    """The answer of Modbus TCP, from the function code on."""
    with (
        socket.create_connection(("127.0.0.1", port), 10) as link,
        tls.wrap_socket(link, server_hostname="127.0.0.1") as secured,
    ):
        secured.sendall(struct.pack(">HHHB", 1, 0, len(request) + 1, 1) + request)
        return secured.recv(64)[7:]


def test_only_the_controller_has_a_role(made: Path) -> None:
    roles = {}
    for name in ("unit", "controller", "broker", "plant"):
        der = ssl.PEM_cert_to_DER_cert((made / f"{name}.pem").read_text())
        roles[name] = role_of(der)
    assert roles == {"unit": None, "controller": "operator", "broker": None, "plant": None}
    assert all((made / f"{name}.key").stat().st_mode & 0o077 == 0 for name in ("ca", *roles))


def test_a_unit_its_clients_and_a_broker_speak_tls_alone(
    made: Path, played_unit: PlayedUnit, tmp_path: Path
) -> None:
    for name in ("ca.pem", "unit.pem", "unit.key"):
        shutil.copy(made / name, tmp_path)
    token = altd_here("token", tmp_path / "credentials", "press_7").out.strip()
    http, modbus, opcua = free_port(), free_port(), free_port()
    files, access = blocks("")
    shutil.copytree(made, tmp_path / "broker")
    (tmp_path / "broker" / "acl").write_text(access)
    lines = files.replace("/etc/mosquitto/altd", str(tmp_path / "broker")).splitlines()[1:]
    with mosquitto(tmp_path, *lines) as (broker, _):
        (settings,) = blocks("toml")
        own = settings.replace('"broker.plant.example"', f'"127.0.0.1"\nport = {broker}')
        for table, port in (("http", http), ("modbus_tcp", modbus), ("opcua", opcua)):
            own = own.replace(f"[{table}]", f'[{table}]\nhost = "127.0.0.1"\nport = {port}')
        config = write_config(tmp_path / "altd.toml", played_unit.calibration, played_unit.beams, own)
        command = [sys.executable, "-m", "altd.cli", "run", "--rehearsal", "--config", str(config)]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            check_broker(made, broker)
            check_http(made, http, token)
            check_modbus(made, modbus)
        finally:
            process.terminate()
            process.wait(30)
    assert process.returncode == 0


def check_broker(made: Path, port: int) -> None:
    """The plant reads; a client with the unit's certificate writes the unit's topics, and no other."""

    def client(program: str, name: str | None, *more: str) -> subprocess.CompletedProcess[str]:
        mine = [] if name is None else ["--cert", made / f"{name}.pem", "--key", made / f"{name}.key"]
        line = [need_program(program, "mosquitto-clients"), "-h", "127.0.0.1", "-p", str(port), "-V", "5"]
        line += ["--cafile", made / "ca.pem", *mine, *more]
        return subprocess.run(line, capture_output=True, text=True, timeout=90, check=False)

    read = client("mosquitto_sub", "plant", "-C", "1", "-W", "60", "-t", "altd/+/summary", "-F", "%t %p")
    topic, _, payload = read.stdout.partition(" ")
    assert topic == f"altd/{SERIAL}/summary", read
    assert "x_mm" in json.loads(payload)
    for name, topic, is_taken in (
        ("unit", f"altd/{SERIAL}/try", True),
        ("unit", "altd/OTHER/summary", False),
        ("plant", f"altd/{SERIAL}/try", False),
        (None, f"altd/{SERIAL}/try", False),
    ):
        sent = client("mosquitto_pub", name, "-q", "1", "-t", topic, "-m", "1")
        assert (sent.returncode == 0 and not sent.stderr) is is_taken, sent


def check_http(made: Path, port: int, token: str) -> None:
    url, trusted = f"https://127.0.0.1:{port}/api", context(made, None)
    deadline_s, states = time.monotonic() + 60, {"": "starting"}
    while set(states.values()) != {"ok"}:
        assert time.monotonic() < deadline_s, states
        with urllib.request.urlopen(f"{url}/status", timeout=10, context=trusted) as answer:
            components = json.load(answer)["components"]
        faces = ("opcua", "mqtt", "http", "modbus_tcp")
        states = {name: of["state"] for name, of in components.items() if name.startswith(faces)}
        time.sleep(0.1)
    assert len(states) == 4
    with pytest.raises(urllib.error.URLError, match="CERTIFICATE_VERIFY_FAILED"):
        urllib.request.urlopen(f"{url}/status", timeout=10, context=ssl.create_default_context())
    file = urllib.request.Request(f"{url}/v1/calibration/file")
    with pytest.raises(urllib.error.HTTPError, match="401") as refused:
        urllib.request.urlopen(file, timeout=10, context=trusted)
    refused.value.close()
    file.add_header("Authorization", f"Bearer {token}")
    with urllib.request.urlopen(file, timeout=10, context=trusted) as answer:
        assert answer.status == 200


def check_modbus(made: Path, port: int) -> None:
    next_zero = asked(port, context(made, "plant"), READ_NEXT_ZERO)[2:]
    set_zero = struct.pack(">BH", 6, 1001) + next_zero
    assert asked(port, context(made, "plant"), set_zero) == bytes([0x86, 1]), "it has no role"
    assert asked(port, context(made, "controller"), set_zero) == set_zero
    with contextlib.suppress(OSError):  # refused in the handshake or, with TLS 1.3, at the first byte
        assert asked(port, context(made, None), READ_NEXT_ZERO) == b"", "it has no certificate"
