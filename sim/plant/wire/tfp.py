"""The printer's control protocol "TFP 1": COBS frames with a session, a sequence number and a CRC-32."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from zlib import crc32

from sim.plant.config import PrinterConfig
from sim.plant.physics.faces import Order
from sim.plant.physics.head import Head

_HEAD = struct.Struct("<IHB")
_ARM = struct.Struct("<QQIQIIIBB")
_VERSION = 1
_REPLY, _ERROR = 0x80, 0xFF
_MOST_BODY = 250
_MOST_DETECTIONS, _MOST_OUTCOMES = 8, 6

HELLO, STATUS, DETECTIONS, ARM, DISARM, OUTCOMES, HOLD, CLEAR = range(1, 9)
_LENGTHS = {HELLO: 1, STATUS: 0, DETECTIONS: 4, ARM: _ARM.size, DISARM: 8, OUTCOMES: 8, HOLD: 0, CLEAR: 2}
_UNKNOWN_TYPE, _BAD_LENGTH, _STALE_SESSION, _NOT_READY = 1, 2, 3, 4


def cobs(data: bytes) -> bytes:
    """Write bytes so that none of them is 0."""
    out = bytearray()
    for part in data.split(b"\0"):
        rest = part
        while len(rest) >= 254:
            out += b"\xff" + rest[:254]
            rest = rest[254:]
        out += bytes([len(rest) + 1]) + rest
    return bytes(out)


def from_cobs(data: bytes) -> bytes | None:
    """Undo `cobs`; None if that is not what these bytes are."""
    out = bytearray()
    at = 0
    while at < len(data):
        step = data[at]
        if step == 0 or at + step > len(data):
            return None
        out += data[at + 1 : at + step]
        at += step
        if step < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def frame(session: int, seq: int, kind: int, payload: bytes) -> bytes:
    """A whole frame, its closing 0 included."""
    body = _HEAD.pack(session, seq, kind) + payload
    return cobs(body + crc32(body).to_bytes(4, "little")) + b"\0"


@dataclass(frozen=True)
class Message:
    """A frame's contents."""

    session: int
    seq: int
    kind: int
    payload: bytes


def parse(data: bytes) -> Message | None:
    """Contents of the bytes between two zeros; None if they are no frame."""
    body = from_cobs(data)
    if body is None or not _HEAD.size + 4 <= len(body) <= _MOST_BODY:
        return None
    if crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        return None
    session, seq, kind = _HEAD.unpack_from(body)
    return Message(session, seq, kind, body[_HEAD.size : -4])


class Controller:
    """Answers requests for the print head; the last one asked again gets the same answer without being done again.

    Parameters
    ----------
    head
        The print head.
    config
        What it tells of itself.
    eye_to_head_counts
        Encoder counts from the eye to the head.
    counts_per_mm
        Of the encoder.
    """

    def __init__(self, head: Head, config: PrinterConfig, eye_to_head_counts: int, counts_per_mm: float) -> None:
        self._head = head
        self._config = config
        self._eye_to_head_counts = eye_to_head_counts
        self._counts_per_mm = counts_per_mm
        self._last: tuple[tuple[int, int, int], bytes] | None = None

    def reset(self) -> None:
        """The controller has booted."""
        self._last = None

    def answer(self, message: Message) -> bytes:
        """Carry out a request and give the frame of the answer."""
        if message.session < self._head.memory.session:
            return frame(message.session, message.seq, _ERROR, bytes([_STALE_SESSION]))
        key = (message.session, message.seq, message.kind)
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        kind, payload = self._done(message)
        self._last = (key, frame(message.session, message.seq, kind, payload))
        return self._last[1]

    def _done(self, message: Message) -> tuple[int, bytes]:
        def error(code: int) -> tuple[int, bytes]:
            return _ERROR, bytes([code])

        head, kind, payload = self._head, message.kind, message.payload
        if kind not in _LENGTHS:
            return error(_UNKNOWN_TYPE)
        if len(payload) != _LENGTHS[kind]:
            return error(_BAD_LENGTH)
        if kind != HELLO and message.session != head.session:
            return error(_NOT_READY)
        return kind | _REPLY, self._payload(message)

    def _payload(self, message: Message) -> bytes:
        head, payload = self._head, message.payload
        match message.kind:
            case 1:
                if payload[0] == _VERSION:
                    head.hello(message.session)
                return self._identity()
            case 2:
                head.alive()
                return self._status()
            case 3:
                seen = head.seen(int.from_bytes(payload, "little"))[:_MOST_DETECTIONS]
                return bytes([len(seen)]) + b"".join(
                    struct.pack("<IQI", entry.detect_seq, entry.encoder, entry.length_counts) for entry in seen
                )
            case 4:
                answer = head.arm(Order(*_ARM.unpack(payload)))
                return struct.pack("<BQ", answer, head.memory.last_accepted)
            case 5:
                return bytes([head.disarm(int.from_bytes(payload, "little"))])
            case 6:
                return self._outcomes(int.from_bytes(payload, "little"))
            case 7:
                head.hold()
                return b"\0"
            case _:
                return bytes([head.clear(int.from_bytes(payload, "little"))])

    def _identity(self) -> bytes:
        config = self._config
        return struct.pack(
            "<BIBBIIIBI",
            _VERSION,
            self._head.boot_id,
            config.inks,
            config.bits,
            round(self._counts_per_mm * 1000),
            self._eye_to_head_counts,
            self._head.min_lead_counts,
            config.queue_len,
            config.buffer_bytes,
        )

    def _status(self) -> bytes:
        head = self._head
        clear = not (head.held or head.e_stop or head.ink_out or head.nozzle_out or head.deadman or head.underrun)
        bits = (
            clear,
            head.held,
            head.e_stop,
            head.ink_out,
            head.nozzle_out,
            head.deadman,
            head.printing,
            head.underrun,
        )
        inks = [*(round(permille) for permille in head.ink), *(0 for _ in range(8 - len(head.ink)))]
        return struct.pack(
            "<IHQIQQBI8HH",
            head.boot_id,
            sum(bit << at for at, bit in enumerate(bits)),
            head.encoder,
            head.detect_seq,
            head.memory.last_accepted,
            head.memory.last_outcome,
            head.queued,
            head.credit,
            *inks,
            head.fault_counter,
        )

    def _outcomes(self, from_arm: int) -> bytes:
        arms = self._head.outcomes(from_arm)[:_MOST_OUTCOMES]
        return bytes([len(arms)]) + b"".join(
            struct.pack(
                "<QQIBIII",
                armed.order.arm_id,
                armed.order.face,
                armed.order.detect_seq,
                armed.state,
                armed.rows_printed,
                armed.rows_received,
                armed.crc32,
            )
            for armed in arms
        )
