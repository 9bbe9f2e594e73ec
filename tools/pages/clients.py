"""``docs/clients.md`` from the programs in ``examples/``: ``python -m tools.pages.clients``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True)
class Example:
    """A program, what it needs, and how it is started."""

    title: str
    path: str
    language: str
    text: str

    @property
    def code(self) -> str:
        """The program; of a flow of Node-RED the code of its function node."""
        text = (EXAMPLES / self.path).read_text(encoding="utf-8")
        if self.path.endswith(".json"):
            text = next(node["func"] for node in json.loads(text) if node["type"] == "function")
        return text


MODBUS = (
    Example(
        "Python",
        "python/read_modbus.py",
        "python",
        """\
The library is pymodbus; the tests use version 3.16.

    $ pip install pymodbus
    $ python3 read_modbus.py ADDRESS PORT SERIAL 1000
    x 10.0120 mm, y 4.9870 mm, yaw 1.1459 deg, pitch -1.7184 deg (good)

`ADDRESS` is the unit's IP address, `SERIAL` its serial number, 1000 the limit in ms. A line comes with each
request. `--rehearsal` at the end accepts values that are not live, the signal SIGUSR1 acknowledges.""",
    ),
    Example(
        "C",
        "c/read_modbus.c",
        "c",
        """\
C99 with libmodbus 3.1 (Debian package `libmodbus-dev`). Arguments and output are
those of the Python program.

    $ cc -std=c99 read_modbus.c -lmodbus -o read_modbus
    $ ./read_modbus ADDRESS PORT SERIAL 1000""",
    ),
    Example(
        "IEC 61131-3 Structured Text",
        "structured_text/altd_target.st",
        "",
        """\
`ALTD_TARGET` takes the registers that the PLC's Modbus master reads, and works without a bit cast: the
standard has none. `now_ms` is the PLC's millisecond counter, such as `TIME_TO_UDINT(TIME())` in CODESYS.
Call the block in every cycle: without an answer it only watches the time. Set `answered` in the cycle in
which the master has an answer, `failed` in that in which it reports an error or a time-out. A master
without such flags: leave `answered` TRUE; the fault between two answers is then *not newer*, so show the
operator `drive` and not the fault. `limit_ms` is 750.0 for a limit of 1000 ms: the rest is for the poll
interval, the cycle and the master's time-out. `acknowledge` belongs on a button; only its rising edge
counts.

The program `GUIDANCE` shows a call. Its `unit` is 0, so every answer is *foreign* (`fault` is 3). Put in the
number of your unit: `python3 -c "import zlib; print(hex(zlib.crc32(b'SERIAL')))"`.

The compiler [matiec](https://github.com/beremiz/matiec) makes C99 of the file. `POUS.h` then has the
structure `GUIDANCE`, and `POUS.c` the functions that begin it and run one cycle:

    TIME __CURRENT_TIME;
    GUIDANCE g;
    GUIDANCE_init__(&g, 0);                            /* once */
    g.REGISTERS.value.table[0] = ...;                  /* each cycle: 80 registers, */
    g.DONE.value = ..., g.ERROR.value = ...;           /* the master's flags, */
    g.PLC_MS.value = ..., g.BUTTON.value = ...;        /* the clock, the acknowledgement */
    GUIDANCE_body__(&g);
    if (g.DRIVE.value) steer(g.X_MM.value, g.Y_MM.value, g.YAW_DEG.value, g.PITCH_DEG.value);

    $ git clone https://github.com/beremiz/matiec
    $ (cd matiec && autoreconf -i && ./configure && make)
    $ mkdir plc && matiec/iec2c -I matiec/lib -T plc altd_target.st
    $ cc -std=c99 -w -I matiec/lib/C -I plc -include POUS.h -c plc/POUS.c -o plc/POUS.o

It needs autoconf, automake, bison, flex and a C++ compiler. No registry has a package of it, so the tests run
the file with an interpreter of their own, which checks the types.""",
    ),
    Example(
        "Node-RED",
        "node_red/flow.json",
        "js",
        """\
Import [flow.json](../examples/node_red/flow.json). It needs the node `node-red-contrib-modbus` and was run
with Node-RED 4.1 and version 5.23 of that node. Set the address, the port, the serial number, the limit and
`REHEARSAL` as environment variables of the flow; without a serial number every answer is *foreign*.
`LIMIT_MS` is 750 for a limit of 1000 ms: the rest is for the time-out and the poll interval of the Modbus
nodes. `msg.payload` then has `usable`, `x`, `y`, `yaw`, `pitch` and `fault`; while `usable` is false
there are no numbers. The flow's `acknowledge a restart or silence` acknowledges.

The function node:""",
    ),
)

MQTT = Example(
    "Python, MQTT",
    "python/read_mqtt.py",
    "python",
    """\
The library is paho-mqtt 2. The unit needs `every_measurement = true` in `[mqtt]` ([MQTT](mqtt.md)). Arguments
and output are those of the program for Modbus; `BROKER` is the name or address of the broker.

    $ pip install paho-mqtt
    $ python3 read_mqtt.py BROKER PORT SERIAL 1000

It follows the same rules, with these differences:

- The unit sends by itself. *no answer* means that no message has come since the line before.
- *retained*: the broker had the message in its memory. The unit retains no numbers.
- *offline*: the unit has ended, or the broker has lost it. The values are dropped at once.
- *silent*: no message came for longer than the limit. Like *restarted* it lasts until a person
  acknowledges by `kill -USR1 PID`.
- *late*: a broker that delivers every message late shows only by the time of day, so the program also
  compares the unit's UTC with its own. Both computers need NTP.
- *not live* includes a rehearsal.

A broker delays and stores messages, and can fail: do not steer by MQTT.""",
)


def page() -> str:
    """The page for a programmer of a controller."""
    parts = "\n".join(_section(example) for example in (*MODBUS, MQTT))
    return f"""# Client examples

<!-- Generated by `python -m tools.pages.clients`; do not edit. -->

Complete programs that read x, y, yaw and pitch and decide whether the values may be used. Each is one file of
less than 80 lines. The tests run each of them against the daemon and against answers that are late, repeated,
torn, forged or from another unit; all must give the same verdicts.

| language | file | needs |
|---|---|---|
| Python | [read_modbus.py](../examples/python/read_modbus.py) | pymodbus |
| C99 | [read_modbus.c](../examples/c/read_modbus.c) | libmodbus |
| Structured Text | [altd_target.st](../examples/structured_text/altd_target.st) | a Modbus master |
| Node-RED | [flow.json](../examples/node_red/flow.json) | node-red-contrib-modbus |

For MQTT: [read_mqtt.py](../examples/python/read_mqtt.py), [below](#python-mqtt).
For the serial telegram: [read_telegram.c](../examples/c/read_telegram.c) and a program in Python, see
[telegram](telegram.md#latency-and-time-outs).

## Rules

All four follow the [rules](integrate.md#rules), the [limits](integrate.md#limits) and the
[resumption](integrate.md#resumption) of *Integrate a controller*, and report the faults by the names that are
given there, *not valid* with the first [reason](reasons.md). For Modbus this means:

- They read the checked block, 80 registers from address 200, in one request. After a time-out of a twentieth
  of the limit they close the connection.
- 32-bit values have the high word first, as a fresh `altd.toml` sends them. In another word order the first
  answer is *corrupt*.
- The limit of the rules is 750 ms: values are accepted, and stay in use, up to that age, so that with the
  time to the next result no value in use is older than 1000 ms. The programs in Python and C get the 1000
  ms as an argument and compute the 750 ms, in the other two 750 ms are set.
- The argument `--rehearsal`, or the input `rehearsal`, turns rule 8 (*not live*) off.
- The signal SIGUSR1 (`kill -USR1 PID`), or the input `acknowledge`, acknowledges a unit that was *restarted*
  or *silent*. It counts for the next answer alone, if that passes rules 1 to 5.

The examples do not check `sigma_now` ([uncertainty](integrate.md#uncertainty)).
A serial line or a gateway needs a longer time-out: at 9600 baud an answer takes 0.2 s ([Modbus](modbus.md)).

## Behaviour

| event | result |
|---|---|
| The unit or the cable fails, the daemon ends | *no answer*; values are dropped at the limit |
| The unit answers again after the limit | *silent*; no values until a person acknowledges |
| The daemon starts again | *restarted*; no values until a person acknowledges |
| The beam is blocked | *not valid: front_spot_missing*, for example; dropped at once |
| A camera fails | *not valid: front_camera_silent*; dropped at once |
| A technician plays a recording | *not live*; dropped at once |
| The daemon answers but measures nothing | *late* or *stopped*; no values |
| Another unit has the address, or no unit number is set | *foreign*; dropped at the limit |
| A gateway repeats an old answer | *not newer*; dropped at the limit |
| The first answer after a start | accepted by its own age ([delays](proof.md#delays-that-can-be-found)) |

{parts}"""


def _section(example: Example) -> str:
    return f"""\
## {example.title}

{example.text}

```{example.language}
{example.code}```
"""


if __name__ == "__main__":
    sys.stdout.write(page())
