"""Files that might be ``altd.toml``."""

import math
import tomllib
from typing import Any

from fuzz.folder import folder, one_line
from fuzz.spoil import SCRAPS, spoilt_bytes, spoilt_document
from hypothesis import strategies as st
from support.places import ROOT

from altd.config import load_config
from altd.errors import BadInputError

NAME = "config"

SHIPPED = (ROOT / "config" / "live.toml").read_bytes()
FULL = b"""
unit = {serial = "A-1", calibration = "cal.json"}
cameras.front = {driver = "v4l2", device = "/dev/video0", controls = {gamma = 3}, exposure.control = "fixed"}
cameras.rear = {driver = "aravis", device = "4711", trigger = "line", features = {Gamma = 1.5, A = true}}
targets = [{name = "front", z_mm = 0.0, camera = "front"}, {name = "rear", z_mm = 280.0, camera = "rear"}]
measuring = {window = 4, pair_by = "time", max_skew_ms = 3.0, stale_after_s = 0.5}
installation = {reference_plane_mm = 100.0, sign_x = -1, offset_yaw_deg = 0.25}
modbus_tcp = {host = "127.0.0.1", port = 502}
http = {port = 8080}
serial = [{device = "/dev/tty0", speaks = "telegram", rs485 = {}}, {device = "/dev/tty1", speaks = "console"}]
lamps = {driver = "gpiod", chip = "a", lines = ["1", "2"]}
indicators = {driver = "gpiod", chip = "b", ok = "1"}
stage = {driver = "grbl", device = "/dev/ttyUSB0", offset_x_mm = 12.5}
scan = {columns = 6, pitch_mm = 25.0}
"""
SCRAPS_OF_TOML = (
    *SCRAPS,
    *(
        b"a." * 2000 + b"a = 1\n",
        b"[" + b"a." * 500 + b"a]\n",
        b"x = " + b"[" * 5000,
        b"x = 0x" + b"f" * 5000,
    ),
    *(b"x = " + b"{a=" * 3000, b"#" + b"." * 3000 + b"\n", b'x = "\\u0000"\n', b'"""', b"[[serial]]\n"),
)


def _toml(value: Any) -> str:
    """A value as TOML writes it; what TOML has not, None or a lone surrogate, as text that is nearly it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "nan" if math.isnan(value) else repr(value)
    if isinstance(value, int):
        return str(value) if abs(value) < 10**4000 else hex(value)
    if isinstance(value, str):
        letters = (c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
        return '"' + "".join(letters) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(key)} = {_toml(below)}" for key, below in value.items()) + "}"
    return "none"


def _file(document: dict[str, Any]) -> bytes:
    return "\n".join(f"{_toml(key)} = {_toml(value)}" for key, value in document.items()).encode()


EXAMPLES = st.one_of(
    spoilt_document(st.just(tomllib.loads(FULL.decode()))).map(_file),
    spoilt_bytes(st.sampled_from((FULL, SHIPPED)), SCRAPS_OF_TOML),
)


def check(example: bytes) -> None:
    """Good or refused; what is good has finite numbers only."""
    path = folder(NAME) / "altd.toml"
    path.write_bytes(example)
    try:
        config = load_config(path)
    except BadInputError as error:
        one_line(error)
        return
    nodes: list[Any] = [config.model_dump()]
    while nodes:
        node = nodes.pop()
        assert not isinstance(node, float) or math.isfinite(node)
        assert "\0" not in str(node) or isinstance(node, dict | list | tuple)
        if isinstance(node, dict):
            nodes += node.values()
        elif isinstance(node, list | tuple):
            nodes += node
