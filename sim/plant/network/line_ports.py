"""The serial lines of the printer's controller and of the gauge: frames that end with one byte."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sim.plant.network.faults import Link, answer_through
from sim.plant.network.serial_port import SerialPort
from sim.plant.network.service import Service
from sim.plant.wire import gauge_lines, tfp
from sim.plant.wire.forge import Form

_MOST_BYTES = 1024


class LinePort:
    """A serial line on which every message ends with the same byte.

    Parameters
    ----------
    path, baud
        The line; 8 bits, no parity, one stop bit.
    end
        The byte that ends a message.
    form
        Form of the messages.
    on_message
        Called with each message, without its end, and the line.
    """

    def __init__(
        self, path: Path, baud: int, end: bytes, form: Form, on_message: Callable[[bytes, Link], None]
    ) -> None:
        self._end = end
        self._form: Form = form
        self._on_message = on_message
        self._buffer = b""
        self.port = SerialPort(path, baud, 10, self._received)
        self._new_link()

    def _new_link(self) -> None:
        self._link = Link(self.port.send, self.hang_up, self.port.later, self._form, revive=self.reset)

    def reset(self) -> None:
        """Forget everything that is on its way."""
        self._buffer = b""
        self.port.reset()
        self._new_link()

    def hang_up(self) -> None:
        """Break the line, and offer a new one."""
        self._link.deaf = True
        self._buffer = b""
        self.port.hang_up()
        self._new_link()

    def _received(self, data: bytes) -> None:
        *messages, rest = (self._buffer + data).split(self._end)
        self._buffer = rest[-_MOST_BYTES:]
        for message in messages:
            if message and not self._link.deaf:
                self._on_message(message, self._link)

    def close(self) -> None:
        """Close the line."""
        self._link.deaf = True
        self.port.close()


def printer_port(service: Service, path: Path, baud: int) -> LinePort:
    """Open the printer's control line."""

    def received(data: bytes, link: Link) -> None:
        message = tfp.parse(data)
        if message is None:
            return

        def act() -> bytes | None:
            with service.now():
                return service.printer.answer(message) if service.up("printer") else None

        answer_through(service.strike(("printer", "printer_control"), message.kind), link, act)

    return LinePort(path, baud, b"\0", "tfp", received)


def gauge_port(service: Service, path: Path, baud: int) -> LinePort:
    """Open the gauge's line."""

    def received(line: bytes, link: Link) -> None:
        def act() -> bytes | None:
            with service.now() as plant:
                return gauge_lines.answer(plant.gauge, line) if service.up("gauge") else None

        answer_through(service.strike(("gauge",), 0), link, act)

    return LinePort(path, baud, b"\n", "ascii", received)
