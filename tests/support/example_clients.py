"""The clients of ``examples/``: their checks on a clock that the test drives, and the programs."""

import contextlib
import importlib.util
import json
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from support.foreign import need, need_program
from support.places import EXAMPLES
from support.structured_text import Library

Verdict = tuple[str, tuple[float, ...] | None]
"""The fault, or ``good``; and x, y in mm, yaw, pitch in degrees, or None while they must not be used."""
Polls = Sequence[tuple[float, bytes | None]]
"""When an answer came, in ms of the reader's clock, and its 160 bytes; None: no answer."""
ACKNOWLEDGE = b"acknowledge"
"""In place of an answer: the operator acknowledges."""
Judge = Callable[[Polls, str, float, bool], list[Verdict]]
"""The verdict after each poll; its arguments: polls, serial number, limit in ms, whether one rehearses."""

PYTHON = EXAMPLES / "python" / "read_modbus.py"
C = EXAMPLES / "c" / "read_modbus.c"
STRUCTURED_TEXT = EXAMPLES / "structured_text" / "altd_target.st"
NODE_RED = EXAMPLES / "node_red" / "flow.json"

FAULTS = (
    *("good", "no answer", "corrupt", "foreign", "restarted", "not newer", "late", "stopped", "not live"),
    *("not valid: ", "silent"),
)
"""By their number in Structured Text; its reason follows ``not valid``."""
_LINE = re.compile(r"(?:x (\S+) mm, y (\S+) mm, yaw (\S+) deg, pitch (\S+) deg|no value) \((.*)\)\n")
_C_MAIN = r"""
#define main example
#include "%s"
#undef main
int main(int count, char **given)
{
    struct target t = {.limit_ms = atof(given[2]), .rehearsal = count > 3};
    for (const char *c = given[1]; *c; c++) t.unit = crc32(t.unit, (uint8_t)*c);
    double now_ms;
    for (int length, acknowledged = 0; scanf("%%lf %%d", &now_ms, &length) == 2; acknowledged = length < 0) {
        uint16_t r[80];
        if (length < 0) continue;
        for (int i = 0; i < length; i++) scanf("%%4hx", r + i);
        printf("%%s", update(&t, length ? r : NULL, now_ms, acknowledged));
        for (int i = 0; i < 4 && t.usable; i++) printf(";%%f", t.values[i]);
        printf("\n");
    }
}
"""
_NODE_MAIN = """
const fs = require("fs"), [flow, serial, limit, rehearsal] = process.argv.slice(1), kept = {};
const values = { SERIAL: serial, LIMIT_MS: limit, REHEARSAL: rehearsal === "true" };
const node = JSON.parse(fs.readFileSync(flow)).find((node) => node.type === "function");
let now;
const given = {
    context: { get: (key) => kept[key], set: (key, value) => { kept[key] = value; } },
    env: { get: (key) => values[key] },
    [node.libs[0].var]: { performance: { now: () => now } },
};
const run = (code, msg) => new Function("msg", ...Object.keys(given), code)(msg, ...Object.values(given));
run(node.initialize);
for (const poll of JSON.parse(fs.readFileSync(0))) {
    now = poll.now;
    const told = JSON.stringify(run(node.func, poll.msg).payload);
    if (poll.msg.topic !== "acknowledge") console.log(told);
}
"""


def _words(block: bytes) -> list[int]:
    return list(struct.unpack(f">{len(block) // 2}H", block))


def by_python(polls: Polls, serial: str, limit_ms: float, rehearsal: bool) -> list[Verdict]:
    spec = importlib.util.spec_from_file_location("read_modbus", PYTHON)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    target = module.Target(zlib.crc32(serial.encode()), limit_ms, rehearsal)
    verdicts: list[Verdict] = []
    acknowledged = False
    for now_ms, block in polls:
        if block != ACKNOWLEDGE:
            verdicts.append((target.update(_words(block or b""), now_ms, acknowledged), target.values))
        acknowledged = block == ACKNOWLEDGE
    return verdicts


def compiled(source: Path | str, folder: Path) -> Path:
    """The C example, or C around it, without a warning."""
    compiler = need_program("cc", "gcc")
    header = Path("/usr/include/modbus/modbus.h")
    need(header.exists(), "libmodbus is not installed (Debian package libmodbus-dev)")
    if isinstance(source, str):
        (folder / "around.c").write_text(source)
        source = folder / "around.c"
    flags = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
    program = folder / source.stem
    command = [compiler, *flags, str(source), "-lmodbus", "-o", str(program)]
    built = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert built.returncode == 0, built.stderr
    return program


def by_c(folder: Path, polls: Polls, serial: str, limit_ms: float, rehearsal: bool) -> list[Verdict]:
    program = compiled(_C_MAIN % C, folder)
    fed = "".join(
        f"{now_ms} -1\n"
        if block == ACKNOWLEDGE
        else f"{now_ms} {len(block or b'') // 2} {' '.join(f'{word:04x}' for word in _words(block or b''))}\n"
        for now_ms, block in polls
    )
    command = [str(program), serial, str(limit_ms), *["--rehearsal"] * rehearsal]
    told = subprocess.run(command, input=fed, capture_output=True, text=True, check=True, timeout=60).stdout
    verdicts: list[Verdict] = []
    for line in told.splitlines():
        fault, *values = line.split(";")
        verdicts.append((fault, tuple(map(float, values)) or None))
    return verdicts


def by_structured_text(polls: Polls, serial: str, limit_ms: float, rehearsal: bool) -> list[Verdict]:
    block = Library(STRUCTURED_TEXT.read_text()).new("ALTD_TARGET")
    block.v |= {"unit": zlib.crc32(serial.encode()), "limit_ms": float(limit_ms), "rehearsal": rehearsal}
    verdicts: list[Verdict] = []
    for now_ms, answer in polls:
        is_pressed = answer == ACKNOWLEDGE
        given = {"r": _words(answer)} if answer and not is_pressed else {}
        now = {"now_ms": round(now_ms) % 2**32, "acknowledge": is_pressed}
        block(**given, answered=bool(given), failed=answer is None, **now)
        if is_pressed:
            continue
        told = block.v
        fault = FAULTS[told["fault"]] + told["reason"]
        values = tuple(told[name] for name in ("x", "y", "yaw", "pitch"))
        assert told["usable"] or values == (1e30,) * 4
        verdicts.append((fault, values if told["usable"] else None))
    return verdicts


def by_node_red(polls: Polls, serial: str, limit_ms: float, rehearsal: bool) -> list[Verdict]:
    messages = [{"now": now_ms, "msg": _message(answer)} for now_ms, answer in polls]
    command = [need_program("node", "nodejs"), "-e", _NODE_MAIN, str(NODE_RED), serial, str(limit_ms)]
    done = subprocess.run(
        [*command, json.dumps(rehearsal)],
        input=json.dumps(messages),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    verdicts: list[Verdict] = []
    for told in map(json.loads, done.stdout.splitlines()):
        values = tuple(told[name] for name in ("x", "y", "yaw", "pitch") if name in told)
        assert told["usable"] == (len(values) == 4)
        verdicts.append((told["fault"], values or None))
    return verdicts


def _message(answer: bytes | None) -> dict[str, object]:
    if answer == ACKNOWLEDGE:
        return {"topic": "acknowledge", "payload": 0}
    return {"error": {"message": "Timed out"}} if answer is None else {"payload": _words(answer)}


@contextlib.contextmanager
def running(command: Sequence[object]) -> Iterator[tuple[subprocess.Popen[str], Iterator[Verdict]]]:
    """A client as a process, and its verdicts, line for line."""
    process = subprocess.Popen(
        [str(word) for word in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    try:
        yield process, map(_verdict, iter(process.stdout.readline, ""))
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _verdict(line: str) -> Verdict:
    found = _LINE.fullmatch(line)
    assert found is not None, line
    *values, fault = found.groups()
    return fault, None if values[0] is None else tuple(map(float, values))


def command(language: str, folder: Path) -> list[object]:
    """The words that start an example, up to its arguments."""
    return [sys.executable, PYTHON] if language == "python" else [compiled(C, folder)]
