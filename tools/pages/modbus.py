"""``docs/modbus.md``, written from the tables: ``python -m tools.pages.modbus > docs/modbus.md``."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterable

from altd.config import ModbusRtuPortSettings, ModbusTcpSettings
from altd.publish.modbus import checked_block
from altd.publish.modbus.places import FIRST_REQUEST_S, KEPT_SHARE, MAX_KEPT_OF_ONE_ADDRESS, QUIET_S
from altd.publish.modbus.registers import (
    FLOAT_BLOCK,
    FLOATS,
    HEADER,
    PER_UNIT,
    SCALED,
    SCALED_BLOCK,
    SIZE,
    TEST_BLOCK,
    TESTS,
    Register,
    Type,
    image,
)
from altd.publish.modbus.responder import (
    CALIBRATION_CHECKSUM,
    CALIBRATION_DATE,
    SELF_CHECK_ADDRESS,
    SELF_CHECK_NOW,
    SERIAL,
    ZERO_ADDRESS,
)
from altd.publish.modbus.rtu import BITS_PER_CHARACTER, silence_s
from altd.publish.modbus.serial_functions import RUNNING, SERVER_ID
from altd.publish.modbus.tcp import MAX_CLIENTS
from altd.publish.modbus.unit_blocks import CONDITION, RELATIVE, UNIT
from altd.publish.modbus.values import (
    DISCRETE_INPUTS,
    REASON_CODES,
    STATUS_BITS,
    VALID,
    WITHOUT_BIT,
    Snapshot,
    StatusBit,
)
from altd.reasons import Reason, Signal
from altd.status.health import FIGURE_AGE_S
from altd.tcp_port import CONNECTIONS, HANDSHAKE_TIMEOUT_S, MAX_HANDSHAKES
from tools.pages.example import MEASURED

EXAMPLE = Snapshot(
    MEASURED,
    age_s=0.52,
    published=141,
)
"""The measurement that the page shows."""

COUNTED = (
    (11, "whole frames on the line, of any unit"),
    (12, "pieces that were no whole frame"),
    (13, "requests to this unit that it answered with an exception"),
    (14, "requests to this unit"),
    (15, "answers for which the line had no room"),
)


def _span(first: int, size: int) -> str:
    return f"{first} to {first + size - 1}"


BLOCKS = (
    (_span(0, SIZE), "[the measurement](#read-a-measurement)", "with each poll"),
    (
        _span(checked_block.FIRST, checked_block.SIZE),
        "[the checked block](proof.md): the measurement with all that proves it",
        "with each poll, instead",
    ),
    (_span(UNIT.first, UNIT.size), "[which unit this is](#the-unit)", "when the controller connects"),
    (_span(CONDITION.first, CONDITION.size), "[its condition](#the-condition)", "every few seconds"),
    (
        _span(RELATIVE.first, RELATIVE.size),
        "[values relative to a zero](#relative-values)",
        "if a zero is used",
    ),
)

COMMANDS = (
    (
        SELF_CHECK_ADDRESS,
        "`allow_self_check`",
        SELF_CHECK_NOW,
        "a self-check (`selfcheck.md`) within ten seconds; five seconds or more between two",
    ),
    (
        ZERO_ADDRESS,
        "`allow_zero`",
        "`next_zero` (address 502)",
        "the newest measurement becomes [the zero](#relative-values)",
    ),
)

(STATE,) = (row for row in checked_block.ROWS if row.name == "state")
"""The register of the unit's signal."""


def page() -> str:
    """The page as Markdown."""
    tcp, rtu = ModbusTcpSettings(), ModbusRtuPortSettings.model_fields
    baud, parity, stop_bits = (rtu[key].default for key in ("baud", "parity", "stop_bits"))
    float_end = FLOATS + 2 * len(FLOAT_BLOCK)
    read_floats = f"-1 -0 -B -t 3:float -r {FLOATS} -c {len(FLOAT_BLOCK)}"
    words = image(EXAMPLE)
    kept = round(MAX_CLIENTS * KEPT_SHARE)
    return f"""\
# Modbus: what the controller reads

Generated from the register table: `python -m tools.pages.modbus > docs/modbus.md`.

## Connect

| | Modbus TCP | Modbus RTU (RS232, RS485) |
| --- | --- | --- |
| in `altd.toml` | `[modbus_tcp]` | `[[serial]]` with `speaks = "modbus_rtu"` |
| line | port {tcp.port_or_default} | {baud} baud, 8 data bits, parity {parity}, {stop_bits} stop bit |
| with [TLS](#tls) | port 802 | |
| unit id | {tcp.unit_id}; 0 and 255 answer too | {rtu["unit_id"].default} |
| other unit ids | exception 11 | silence, the bus may be shared |
| clients | {MAX_CLIENTS}; one more closes another, see below | one request, one answer |

Port, baud rate, parity, stop bits and unit id are those of a fresh `altd.toml`; it says what your unit has.

When all {MAX_CLIENTS} connections are taken, a new one closes another:

- {kept} places belong to the clients that have asked for longest. They keep their connection, whatever other
  addresses open and ask, as long as they ask at least once in {QUIET_S:g} s. An address counts with all its
  connections, of which {MAX_KEPT_OF_ONE_ADDRESS} are kept. It keeps its time when it reconnects, until the
  daemon restarts. An address of IPv6 counts with its whole network of 64 bits.
- The other {MAX_CLIENTS - kept} places go to new connections in turn. A connection without a request for
  {QUIET_S:g} s, or for its first {FIRST_REQUEST_S:g} s, goes first, then one of the address that has most,
  then the oldest.

A controller that is new, or new since a restart of the daemon, can lose its connection again and again while
others that have asked for longer fill the {kept} places and more connect all the time. The unit cannot tell a
controller from such a host behind the same address (NAT). Reserve the places of your controllers:

    [modbus_tcp]
    reserved = ["192.168.1.10"]

Reserved addresses always get a connection, and no other address closes it. The other clients share what is
left in the same way. If reserved addresses fill all {MAX_CLIENTS} places, other connections are refused, and
one more of their own closes another.

Everything is read only, except for the [commands](#commands), which are off by default. Function 4 (input
registers) and function 3 (holding registers) read the same registers. Function 2 reads [discrete
inputs](#discrete-inputs-function-2). Function 43/14 reads the
[identification](#identification-function-4314). The commissioning of a controller, from the first connection
to the first drive: [integrate a controller](integrate.md).

{_table(("registers", "hold", "read them"), BLOCKS)}

A request stays within one row of this table. `altd registers --format json|csv|st` prints all of it for
programs; `st` is a list of constants in Structured Text.

Addresses on this page count from 0, as on the wire. Where a tool counts from 1, add 1: address {FLOATS} is
3{FLOATS + 1:04} as an input register and 4{FLOATS + 1:04} as a holding register.

A controller that must know whether what it reads is whole, new and from this unit reads the checked block,
{checked_block.SIZE} registers from address {checked_block.FIRST}: [proof](proof.md).

## Types

{_types()}

## First test: byte order

Big-endian throughout, ABCD: the high byte of a register first, the high word of a 32-bit value first. These
registers never change. Read them first, and swap bytes or words in the controller until they are right.

A controller that cannot swap is served in its own order: `word_order = "CDAB"`, `"BADC"` or `"DCBA"` in
`[modbus_tcp]` or in the port's table. It changes every 32-bit value, these two among them; 16-bit values and
text stay as they are. The CRC of the checked block is over the bytes as they are sent.

{register_table(TEST_BLOCK)}

    $ mbpoll -1 -0 -B -t 3:float -r {TESTS} -c 1 -p {tcp.port_or_default} -a {tcp.unit_id} ADDRESS
    [{TESTS}]: 	123.456

## Read a measurement

**One request, one measurement.** All registers of an answer come from the same measurement. Read what belongs
together in one request: {SIZE} registers from address 0 are everything, the first {float_end} are header and
floating point. Two requests fit together only if `sequence` is the same in both.

- Use a number only if bit 0 of `status` is 1 and `age` is below your limit. A value is the mean of the last
  `window` frames of `[measuring]`, 20 by default: one second at 20 frames/s. Its middle is then about half a
  second old: an age of 500 to 600 ms is normal, and 1000 ms a good limit. Wait 50 ms for an answer of Modbus
  TCP.
- When `heartbeat` does not change for a second, or no answer comes, the unit has stopped: use no number.
- In the tunnel, refuse a measurement with bit 12 or 13: it does not come from this unit's cameras.
- A new measurement comes with every exposure, 20 a second. To poll faster than that gains nothing.

[Client examples](clients.md) are complete programs in Python, C, Structured Text and Node-RED that do so.

On a serial line a request and its answer take, with {BITS_PER_CHARACTER} bits a character (8N1 has 10, and
is 9 % faster),

{_durations((SIZE, checked_block.SIZE, float_end, FLOATS))}

## Header, addresses 0 to {FLOATS - 1}

{register_table(HEADER)}

## Values, from address {FLOATS} as f32, from address {SCALED} as s32

Each value is there twice: as floating point (f32, IEEE 754 single precision) in the unit, and as an integer
(s32, two's complement) in 1/{PER_UNIT} of the unit. A standard deviation is 1 sigma. Signs and zero: [the
next section](#signs-zero-and-reference-plane).

{_values()}

## Signs, zero and reference plane

`x`, `y`, `yaw` and `pitch` describe the beam as seen from the unit, or the machine against the beam where
`[installation]` sets the signs so. [Integrate a controller](integrate.md#signs-zero-and-reference-plane)
defines signs, zero and reference plane, and has a check for the commissioning.

## Unknown values

A value that is not known is never 0 and never an old one. With bit 0 at 0 none of the values is
known but `roll`, which an inclinometer measures by itself, whether or not the beam is seen. A number too
large for its type is held at the type's end, so `age` stops at 65534.
Addresses without a name read 0.

## Bits of `status`

{_table(("bit", "name", "set when"), ((row.bit, row.name, _set_when(row)) for row in STATUS_BITS))}

Bits {_listed(_of_valid())} may be set beside bit {VALID}, as warnings: a controller that refuses a
measurement for bit {_listed(_of_both())} refuses some that are valid.

The warnings {_codes(WITHOUT_BIT)} have no bit. `state` at address {STATE.address} of the checked block
shows them: {Signal.CHECK_FUNCTION.number} at once for a rehearsal, {Signal.MAINTENANCE_REQUIRED.number} after
ten seconds for the inclinometer, unless something worse is shown. `/api/status`, the telegram and the console
name them. Where roll is missing, `roll` and `sigma_roll` are *not known*.

Bits 12 and 13 are set beside bit {VALID} only while the daemon rehearses (`altd run --rehearsal`). Without
that argument a measurement from played or simulated frames is invalid, with reason code
{Reason.NOT_LIVE.modbus_code}.

## Reason codes

`reason_front` and `reason_rear` say why there is no point on that target, `reason_unit` what is wrong with
the whole unit; 0 is none. Codes may be added later.

{_table(("code", "reason", "meaning"), ((row.modbus_code, f"`{row}`", row.brief) for row in REASON_CODES))}

## Example

    $ mbpoll {read_floats} -p {tcp.port_or_default} -a {tcp.unit_id} ADDRESS
{_indented(mbpoll_lines())}

The same over a serial line:

    $ mbpoll -m rtu -b {baud} -P {parity} {read_floats} -a {tcp.unit_id} /dev/ttyUSB0

By hand: at address {FLOATS}, `x` is {_hex(words[FLOATS : FLOATS + 2])}, the float 10.012;
at address {SCALED} it is {_hex(words[SCALED : SCALED + 2])}, the integer 100120, and
100120/{PER_UNIT} mm = 10.012 mm.
`roll` is `nan`: this unit has no inclinometer.

## The unit

{register_table(UNIT.rows)}

## The condition

{register_table(CONDITION.rows)}

What was not observed for {FIGURE_AGE_S:g} s is *not known*. The shares of time are counted again every ten
seconds.

## Discrete inputs, function 2

{_inputs()}

Exactly one of 1 to 4 is set unless the state is good.

## Identification, function 43/14

Objects as a stream (read codes 1 to 3; an unknown object starts again at object 0) or one by one (code 4; an
unknown one is exception 2):

| object | holds |
| --- | --- |
| 0, 1, 2, 4 | vendor, product code, version, product name |
| 0x{SERIAL:02X} | the unit's serial number |
| 0x{CALIBRATION_DATE:02X} | date of the calibration, `2026-11-02` |
| 0x{CALIBRATION_CHECKSUM:02X} | checksum of the calibration file |

## Diagnostics on a serial line, functions 8 and 17

The specification has them for serial lines alone; over TCP they are exception 1. Function 8 has the
sub-functions 0 (the request comes back), 10 (counters to zero) and

{_table(("sub-function", "counts"), COUNTED)}

Function 17 gives 0x{SERVER_ID:02X}, 0x{RUNNING:02X} (running), and as text product, version and serial
number.

## Commands

Function 6 (write single register) gives a command. Each has a setting of its own in `[modbus_tcp]` or in the
port's table, off by default.

{_table(("address", "setting", "value", "effect"), COMMANDS)}

The response repeats the request. Exception 2: no command that is allowed has this address. Exception 3:
another value. Exception 4: the unit cannot check itself, or the measurement is not valid now. A refused
command changes nothing. With no command allowed every write is exception 1. Without TLS any client that
reaches the port can give the commands that are allowed; with TLS it needs a [role](#tls). Broadcasts on a
serial line (unit id 0) are ignored.

No command acknowledges anything. What a controller missed while it was away shows in numbers that never go
back: `session` (a restart), `published` (measurements), `zeros` (zeros that any controller set). Each
controller compares them with those that it saw last, so that none clears what another has not yet seen.

## Relative values

{register_table(RELATIVE.rows)}

**The absolute values at all other addresses never change with the zero.** The relative values are the current
measurement less the one that was the newest when the zero was set. Without a zero, or while the measurement
is invalid, they are *not known*. Never pass them on as absolute values.

1. While the machine does not move, read the {RELATIVE.size} registers from address {RELATIVE.first} in one
   request. Bit 0 of `status` must be 1.
2. Write `next_zero` to address {ZERO_ADDRESS}. The unit takes the newest measurement at the moment of the
   write, and only if it is valid, live and fresh. `altd run --rehearsal` takes one that is not live, too.
3. Read again. `zeros` is one greater, and `zero_sequence` names the last exposure of the zero. Remember
   `session` and `zeros`: use the relative values only while both stay the same.

`next_zero` changes with each zero and begins at a number drawn by chance, so a write that is late, repeated
or recorded sets nothing: exception 3. If no response comes, read again instead of repeating the write.

- **The unit has one zero**, for all controllers and wires: a serial line has no connections, and many clients
  open one for each request. If a second controller sets the zero, the first one sees `zeros` change.
- **A restart deletes the zero.** The relative values are then *not known*, and `session` is another one.
- **sigma** combines the standard deviations of both measurements as if they were independent. Both contain
  the errors of the same calibration, which cancel for small movements: the true one is then smaller. It holds
  for a beam at rest; `sigma_now` of the [checked block](proof.md) says how far the beam may have moved since.
- This block has no CRC. A controller that needs the proof of the checked block subtracts values of that
  block.

## TLS

Modbus/TCP Security (specification v36): TLS 1.2 or 1.3 on port 802, and each side shows a certificate.

    [modbus_tcp]
    certificate = "/etc/altd/unit.pem"
    key = "/etc/altd/unit.key"
    client_ca = "/etc/altd/plant-ca.pem"
    allow_zero = true
    roles = ["operator"]

The unit then serves no plain Modbus TCP. Every client with a certificate of `client_ca` may read. Commands
need a role of `roles` in the client's certificate, in the extension 1.3.6.1.4.1.50316.802.1 as a UTF8String;
for any other client a write is exception 1. For a trial, make a certificate authority and a client's
certificate:

    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc -days 365 -subj /CN=plant-ca \\
        -keyout plant-ca.key -out plant-ca.pem -addext keyUsage=critical,keyCertSign,cRLSign
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc -days 365 -subj /CN=controller \\
        -CA plant-ca.pem -CAkey plant-ca.key -keyout controller.key -out controller.pem \\
        -addext basicConstraints=critical,CA:false -addext "1.3.6.1.4.1.50316.802.1=ASN1:UTF8String:operator"

The unit's own certificate is made like the second one, with `-addext subjectAltName=IP:192.0.2.7` (the unit's
address) instead of the role. Clients in Python 3.13 and later refuse an authority without `keyUsage`.

- The unit checks the chain to `client_ca`, the dates and, where the certificate names one, its purpose (TLS
  clients). The unit's own clock must be right: a unit that starts in 1970 refuses every client.
- It reads no revocation lists. To exclude a client, replace `client_ca`. Connections that are open stay open
  until they end.
- Renewed files count from the next handshake on, without a restart. Files that do not fit are reported in the
  interface's state, and the old ones stay in use.
- {MAX_HANDSHAKES} handshakes run at a time, {HANDSHAKE_TIMEOUT_S:g} s each. One more closes another by the
  rules for [connections](#connect). An address that is not reserved may begin {CONNECTIONS.burst} at once and
  {CONNECTIONS.per_s:g} a second. A connection takes one of the {MAX_CLIENTS} places only after its handshake.
- A connection that does not speak TLS is closed.

## Exceptions

| code | when |
| --- | --- |
| 1 illegal function | a write that this client may not make, or a function that is not on this page |
| 2 illegal data address | a read that leaves its table, or an input that is not there |
| 3 illegal data value | no register, more than 125, a malformed request, or a command's wrong value |
| 4 server device failure | a [command](#commands) that is not possible now, or a defect (see the log) |
| 11 gateway target device failed to respond | Modbus TCP: the unit id is another one |
"""


def mbpoll_lines() -> list[str]:
    """What mbpoll prints of the example's floating point values."""
    words = image(EXAMPLE)
    return [f"[{row.address}]: \t{_float32(words[row.address : row.address + 2]):g}" for row in FLOAT_BLOCK]


def _set_when(row: StatusBit) -> str:
    if not row.warnings or len(row.warnings) == len(row.reasons):
        return row.meaning
    return f"{row.meaning}; with bit {VALID} at 1 a warning: {_codes(row.warnings)}"


def _of_valid() -> list[StatusBit]:
    """The bits that a valid measurement may have."""
    return [row for row in STATUS_BITS if row.warnings]


def _of_both() -> list[StatusBit]:
    """Those of them that an invalid one may have for a reason that is no warning."""
    return [row for row in _of_valid() if len(row.warnings) < len(row.reasons)]


def _listed(rows: Iterable[StatusBit]) -> str:
    *first, last = [str(row.bit) for row in rows]
    return f"{', '.join(first)} and {last}" if first else last


def _codes(reasons: Iterable[Reason]) -> str:
    return ", ".join(f"`{reason}`" for reason in reasons)


def _float32(words: list[int]) -> float:
    value: float = struct.unpack(">f", struct.pack(">HH", *words))[0]
    return value


def _durations(lengths: Iterable[int]) -> str:
    """How long a read of so many registers takes: 8 bytes there, 5 + 2n back, a silence after each."""

    def ms(registers: int, baud: int) -> int:
        return round(1000 * ((13 + 2 * registers) * BITS_PER_CHARACTER / baud + 2 * silence_s(baud)))

    bauds = (9600, 19200, 57600, 115200)
    return _table(
        ("registers", *(f"{baud} baud" for baud in bauds)),
        ((length, *(f"{ms(length, baud)} ms" for baud in bauds)) for length in lengths),
    )


def register_table(rows: Iterable[Register]) -> str:
    """A row a register."""
    return _table(
        ("address", "name", "type", "unit", "meaning"),
        ((row.address, f"`{row.name}`", row.type, row.unit, row.meaning) for row in rows),
    )


def _values() -> str:
    return _table(
        ("f32 at", "s32 at", "name", "unit", "meaning"),
        (
            (row.address, scaled.address, f"`{row.name}`", row.unit, row.meaning)
            for row, scaled in zip(FLOAT_BLOCK, SCALED_BLOCK, strict=True)
        ),
    )


def _types() -> str:
    ascii_text = "ASCII, two characters a register, the first in the high byte; zeros follow"
    holds = {
        Type.U16: "unsigned integer",
        Type.U32: "unsigned integer",
        Type.S32: "signed integer, two's complement",
        Type.F32: "IEEE 754 single precision",
        Type.TEXT16: f"16 characters: {ascii_text}",
        Type.TEXT32: f"32 characters: {ascii_text}",
    }
    unknown = {kind: "no characters" if kind.is_text else _hex(kind.unknown) for kind in Type}
    rows = ((kind, kind.words, holds[kind], unknown[kind]) for kind in Type)
    return _table(("type", "registers", "holds", "not known"), rows)


def _inputs() -> str:
    rows = ((place, f"`{row.name}`", row.meaning) for place, row in enumerate(DISCRETE_INPUTS))
    return _table(("address", "name", "1 when"), rows)


def _hex(words: Iterable[int]) -> str:
    return " ".join(f"0x{word:04X}" for word in words)


def _indented(lines: Iterable[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    titles = list(head)
    lines = [titles, ["---"] * len(titles), *([str(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    sys.stdout.write(page())
