"""The wires as tables, made from the code: ``python -m tilefab.devices.reference > docs/line_protocols.md``."""

from __future__ import annotations

import sys
from enum import IntEnum

from tilefab.devices import printer_messages as messages
from tilefab.devices.gauge import MOST_LINE
from tilefab.devices.layouts import Layout, Message
from tilefab.devices.maps import KILN_MAP, PLC_MAP
from tilefab.devices.printer_messages import ArmStatus, ClearStatus, DisarmStatus, OutcomeState, StripCode
from tilefab.devices.registers import Kind, Register, RegisterMap

_INTRODUCTION = """# Protocols of the line

What goes over the wires between the daemon and the devices, byte by byte. This page is made from the tables that the
code itself works with (`devices.maps`, `devices.printer_messages`) by `make docs`.

How the host behaves on all of them: one request is under way at a time; each has a deadline of 0.2 s; nothing is sent
twice but a printer request, which the printer knows as a duplicate; every answer must show which request it answers,
and what doesn't fit is not used at all. After a wrong answer a TCP connection is dropped and made anew.

| endpoint in a line file | what it is |
| --- | --- |
| `modbus-tcp://HOST:PORT?unit=N` | Modbus TCP |
| `modbus-rtu:///PATH?baud=N&unit=N` | Modbus RTU, 8 data bits, even parity, 1 stop bit |
| `serial:///PATH?baud=N` | a serial line, 8 data bits, no parity, 1 stop bit |
| `tcp://HOST:PORT` | a TCP port |

`unit` is 1 and `baud` is 19200 if not given. `&fc23=no` behind a Modbus endpoint is for a
controller without function 23.
"""

_MODBUS = """## Modbus

Holding registers, high byte first. A poll is one request of function 23: it writes `seq`, then reads the whole window.
The answer's `seq` must be the one just written; the host gives each number out once in 65535 polls, 0 never. With
`fc23=no` a poll is function 6 to `seq`, then function 3 over the window. Unit, function, byte count, address and count
of an answer must fit, over TCP its transaction number too. Registers that aren't listed read 0 and can't be written.

A `scan_counter` that stands still for more than 0.3 s means that the controller's program has stopped: its values are
not used. Neither are they if the word order isn't as listed.

A command is written with function 16 (one register: function 6); the run of registers that holds `cmd_seq` is written
last. Then the host polls until the block reads back as written and `cmd_ack` is the new `cmd_seq`, for 0.2 s at most.

On RTU, after an answer that didn't come or didn't fit, nothing is sent until the line has been silent for the time of
the longest answer and 3.5 characters more. Noise around an answer is skipped.

Exceptions: 2 for a register that is read-only, 3 for a value outside its limits.
"""

_PRINTER = f"""## Printer: control (TFP 1)

Over a serial line. The host asks, the printer replies; it sends nothing by itself. Numbers are little-endian.

A frame on the wire is COBS(body) and a zero byte. COBS: the body is cut at its zero bytes, and each piece is led by its
length + 1. A frame whose code or sum is wrong, or that is empty, is dropped without a word. Body:

| byte | field | type | meaning |
| --- | --- | --- | --- |
| 0 | session | u32 | of the host; rises from one start of the daemon to the next |
| 4 | seq | u16 | of the request; its reply has the same |
| 6 | type | u8 | of the message; a reply's is the request's + 0x{messages.REPLY_BIT:02X} |
| 7 | payload | | see below; the whole body has at most 250 bytes |
| at its end | crc32 | u32 | CRC-32 (as of zlib) of everything before |

The printer remembers the highest session. Requests of a lower one change nothing and get an error reply, whose type is
0x{messages.ERROR_TYPE:02X}. A request with the session, seq and type of the last one is answered with the same reply
again, and not acted on twice: so the host may send a request once more, led by a zero byte, when half its deadline has
passed.
"""

_DATA = """## Printer: data

Over TCP, numbers little-endian. The host connects and introduces itself; the printer answers with a status message, or
closes the connection if it knows a newer session. Then the host sends strips, and the printer a status message after
each and whenever its credit changes. The host never has more than `credit` bytes under way.
"""

_STRIP_NOTE = """Behind a strip's head follow its bytes: rows x columns x channels x bits / 8, row by row, the channels
of a dot side by side, high byte last. The host may also send a strip of no rows at row 4294967295, to be told
`next_row`: it isn't taken, as no strip can begin there.
"""

_GAUGE = f"""## Gauge

Over a serial line, lines of ASCII that end with a line feed, at most {MOST_LINE} characters.

| direction | line | meaning |
| --- | --- | --- |
| to the gauge | `?SEQ M` | measure; SEQ is 1 to 65535 |
| reply | `!SEQ N L A B TILES*CRC` | N readings since the start, L\\* a\\* b\\*, tiles that left the kiln |
| reply | `!SEQ E CODE*CRC` | it can't measure |

CRC is the CRC-32 (as of zlib) of the text between `!` and `*`, as 8 hexadecimal digits. Lines with another SEQ or a
wrong sum are dropped.
"""

_KINDS = {Kind.U16: "u16", Kind.U32: "u32", Kind.U64: "u64", Kind.F32: "float"}


def reference() -> str:
    """All protocols, as Markdown."""
    parts = [_INTRODUCTION, _MODBUS, _map(PLC_MAP), _map(KILN_MAP), _PRINTER]
    parts += [_message(message) for message in messages.MESSAGES]
    parts += [
        f"### 0x{messages.ERROR_TYPE:02X} error reply\n",
        _layout(messages.ERROR),
        _codes("ARM: status", ArmStatus),
    ]
    parts += [_codes("DISARM: status", DisarmStatus), _codes("OUTCOMES: state", OutcomeState)]
    parts += [_codes("CLEAR: status", ClearStatus), _DATA]
    for name, magic, layout in (
        ("introduction", messages.DATA_HELLO_MAGIC, messages.DATA_HELLO),
        ("strip", messages.STRIP_MAGIC, messages.STRIP),
        ("status message of the printer", messages.STAT_MAGIC, messages.STAT),
    ):
        parts += [f"### {name[0].upper()}{name[1:]}\n\n`{magic.decode()}`, then:\n", _layout(layout, len(magic))]
    parts.append(_STRIP_NOTE)
    parts += [_codes("Status message: code", StripCode), _GAUGE]
    return "\n".join(parts)


def _table(heads: str, rows: list[str]) -> str:
    columns = heads.count("|") + 1
    return "\n".join([f"| {heads} |", "| " + " | ".join(["---"] * columns) + " |", *rows]) + "\n"


def _map(registers: RegisterMap) -> str:
    rows = [
        f"| {_place(one)} | `{one.name}` | {_KINDS[one.kind]}{f' x {one.count}' if one.count > 1 else ''} | "
        f"{_unit(one)} | {'read, write' if one.writable else 'read'} | {_limits(one)} | {_meaning(one)} |"
        for one in registers.registers
    ]
    head = (
        f"### {registers.device[0].upper()}{registers.device[1:]}: unit {registers.unit}, registers 0 to "
        f"{registers.window - 1}\n\nThe {registers.word_order} word of longer values comes first.\n\n"
    )
    return head + _table("register | name | type | unit | access | may be written | meaning", rows)


def _place(register: Register) -> str:
    last = register.address + register.words - 1
    return str(register.address) if last == register.address else f"{register.address} to {last}"


def _unit(register: Register) -> str:
    return f"1/{register.per_unit} {register.unit}" if register.per_unit > 1 else register.unit


def _limits(register: Register) -> str:
    if not register.writable:
        return ""
    return "all" if register.high is None else f"{register.low:g} to {register.high:g}"


def _meaning(register: Register) -> str:
    parts = [register.meaning]
    if register.bits:
        parts.append("bits: " + ", ".join(f"{bit} {name}" for bit, name in enumerate(register.bits)))
    if register.constant is not None:
        constant = register.constant
        parts.append(f"always {constant:#010x}" if register.kind is Kind.U32 else f"always {constant}")
    return "; ".join(parts)


def _message(message: Message) -> str:
    parts = [f"### 0x{message.code:02X} {message.name}\n\n{message.meaning}\n"]
    for title, layout in (("Request", message.request), ("Reply", message.reply)):
        parts.append(f"{title}:\n\n{_layout(layout)}" if layout.fields else f"{title}: no payload.\n")
    if message.items is not None:
        parts.append(f"Then `count` entries, each:\n\n{_layout(message.items)}")
    return "\n".join(parts)


def _layout(layout: Layout, start: int = 0) -> str:
    rows = []
    for field in layout.fields:
        kind = field.kind + (f" x {field.count}" if field.count > 1 else "")
        rows.append(f"| {start} | `{field.name}` | {kind} | {field.meaning} |")
        start += field.size
    return _table("byte | field | type | meaning", rows)


def _codes(title: str, kind: type[IntEnum]) -> str:
    rows = [
        f"| {code.value} | {code.name.lower().replace('_', ' ')} | {meaning} |"
        for code, meaning in zip(kind, messages.MEANINGS[kind], strict=True)
    ]
    return f"### {title}\n\n" + _table("code | name | meaning", rows)


if __name__ == "__main__":
    sys.stdout.write(reference())
