"""Windows of Modbus holding registers: what the controllers show in words, and what the host may write.

Words are big-endian, and of a 32- or 64-bit value the high word comes first. The last two registers may hold a checksum
of all before them: Modbus TCP has none of its own.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from zlib import crc32

from sim.plant.config import ZONES
from sim.plant.physics.conveyor import Command, Conveyor
from sim.plant.physics.kiln import Kiln, KilnCommand

_PROBE = 0x01020304
_KILN_PROBE = 1234.5


class RefusedError(Exception):
    """A request that the device answers with a Modbus exception.

    Parameters
    ----------
    code
        1 illegal function, 2 illegal address, 3 illegal value, 11 no such unit behind this gateway.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


@dataclass(frozen=True)
class Writable:
    """A value that the host may write: where, of how many words, and its limits."""

    address: int
    words: int = 1
    least: float = 0
    most: float = float("inf")
    real: bool = False

    def value(self, words: Sequence[int]) -> float:
        """Its value in a whole window of words."""
        data = struct.pack(f">{self.words}H", *words[self.address : self.address + self.words])
        return float(struct.unpack(">f", data)[0]) if self.real else int.from_bytes(data, "big")


class Window:
    """A window of registers from 0 on, with its faults: frozen, or with the words of wide values swapped.

    Parameters
    ----------
    size
        Number of registers.
    writable
        What may be written; everything else is read-only.
    wide
        Addresses of 32-bit values, whose words a wrong word order swaps.
    check_words
        Whether the last two registers hold the CRC-32 (as of zlib; 0xFFFFFFFF in place of 0) of all registers before
        them, high byte first. It is made anew for every answer, so a host can check an answer with the whole window in
        it; of any other it shows what the rest was at that moment.
    """

    unit = 1

    def __init__(self, size: int, writable: Sequence[Writable], wide: Sequence[int], *, check_words: bool) -> None:
        self.size = size
        self._check_words = check_words
        self._writable = writable
        self._wide = wide
        self._words = [0] * size
        self._may_write = {w.address + offset for w in writable for offset in range(w.words)}
        self._frozen: list[int] | None = None
        self.word_order_wrong = False

    def freeze(self, frozen: bool) -> None:
        """Show from now on what was to be seen now, apart from what the host writes; or the truth again."""
        self._frozen = None
        if frozen:
            self._show()
            self._frozen = [*self._words]

    def reset(self) -> None:
        """Everything that was written is forgotten."""
        self._words = [0] * self.size
        self._frozen = None

    def read(self, address: int, count: int) -> list[int]:
        """Read registers.

        Raises
        ------
        RefusedError
            If there are none at these addresses, or too many are wanted.
        """
        if not 1 <= count <= 125:
            raise RefusedError(3)
        if address + count > self.size:
            raise RefusedError(2)
        if self._frozen is None:
            self._show()
            words = [*self._words]
        else:
            words = [self._words[at] if at in self._may_write else self._frozen[at] for at in range(self.size)]
        if self.word_order_wrong:
            for at in self._wide:
                words[at], words[at + 1] = words[at + 1], words[at]
        if self._check_words:
            # Of the words as they go out, in any order: the sum says that they arrived, not that they are right.
            check = crc32(struct.pack(f">{self.size - 2}H", *words[:-2])) or 0xFFFFFFFF
            words[-2:] = check >> 16, check & 0xFFFF
        return words[address : address + count]

    def write(self, address: int, values: Sequence[int]) -> None:
        """Write registers, all or none.

        Raises
        ------
        RefusedError
            If one of them is read-only or a value lies outside its limits.
        """
        if not 1 <= len(values) <= 123:
            raise RefusedError(3)
        touched = range(address, address + len(values))
        if not all(at in self._may_write for at in touched):
            raise RefusedError(2)
        words = [*self._words]
        words[address : address + len(values)] = values
        for entry in self._writable:
            if any(at in touched for at in range(entry.address, entry.address + entry.words)) and not (
                entry.least <= entry.value(words) <= entry.most
            ):
                raise RefusedError(3)
        self._words = words
        self._written(touched)

    def _put(self, address: int, value: int, words: int = 1) -> None:
        for offset in range(words):
            self._words[address + offset] = value >> 16 * (words - 1 - offset) & 0xFFFF

    def _put_real(self, address: int, value: float) -> None:
        self._put(address, int.from_bytes(struct.pack(">f", value), "big"), 2)

    def _number(self, address: int, words: int = 1) -> int:
        return int(Writable(address, words).value(self._words))

    def _real(self, address: int) -> float:
        return Writable(address, 2, real=True).value(self._words)

    def _show(self) -> None:
        raise NotImplementedError

    def _written(self, touched: range) -> None:
        raise NotImplementedError


class PlcWindow(Window):
    """Registers 0 to 63 of the conveyor's controller."""

    unit = 1

    def __init__(self, conveyor: Conveyor, *, check_words: bool = True) -> None:
        super().__init__(
            64,
            (
                *(Writable(0), Writable(32), Writable(33, most=3), Writable(34, most=30000)),
                *(Writable(35, least=500, most=30000), Writable(36, least=600, most=40000)),
                *(Writable(37, 2), Writable(39, 2), Writable(41)),
            ),
            wide=(3, 7, 9, 11, 13, 15, 17, 21),
            check_words=check_words,
        )
        self._conveyor = conveyor
        self._seq = 0

    def reset(self) -> None:
        """Everything that was written is forgotten."""
        super().reset()
        self._seq = 0

    def _show(self) -> None:
        view = self._conveyor.view()
        flags = view.belt_running | int(view.trouble) | view.feed_enabled << 5 | view.ready << 6 | view.kiln_full << 8
        self._put(1, view.scan_counter)
        self._put(2, view.boot_id)
        self._put(3, _PROBE, 2)
        self._put(5, flags)
        self._put(6, round(view.belt_speed_mm_s * 10))
        self._put(7, view.position, 2)
        self._put(9, view.tile_seq, 2)
        self._put(11, view.tile_position, 2)
        self._put(13, view.decided_seq, 2)
        self._put(15, view.passed_bits, 4)
        self._put(19, view.cmd_ack)
        self._put(20, view.fault_counter)
        self._put(21, view.tiles_fed, 2)

    def _written(self, touched: range) -> None:
        if 0 in touched and self._words[0] != self._seq:
            self._seq = self._words[0]
            self._conveyor.alive()
        if 32 in touched:
            self._conveyor.command(
                Command(
                    cmd_seq=self._words[32],
                    run_belt=bool(self._words[33] & 1),
                    feed=bool(self._words[33] & 2),
                    speed_mm_s=self._words[34] / 10,
                    tile_length_mm=self._words[35] / 10,
                    tile_pitch_mm=self._words[36] / 10,
                    release_base=self._number(37, 2),
                    release_bits=self._number(39, 2),
                    ack_fault=self._words[41],
                )
            )


class KilnWindow(Window):
    """Registers 0 to 79 of the kiln's controller."""

    unit = 2

    def __init__(self, kiln: Kiln, *, check_words: bool = True) -> None:
        super().__init__(
            80,
            (
                *(Writable(0), Writable(32)),
                *(Writable(34 + 2 * zone, 2, 20, 1250, real=True) for zone in range(ZONES)),
                *(Writable(50, 2, 0.1 - 1e-6, 15, real=True), Writable(52, least=350, most=750)),
            ),
            wide=(3, *(10 + 2 * zone for zone in range(ZONES)), *(34 + 2 * zone for zone in range(ZONES)), 50),
            check_words=check_words,
        )
        self._kiln = kiln
        self.reset()

    def reset(self) -> None:
        """What was written is forgotten; the controller's remembered set-points are shown again."""
        super().reset()
        for zone, state in enumerate(self._kiln.zones):
            self._put_real(34 + 2 * zone, state.set_point)
        self._put_real(50, self._kiln.ramp_degc_min)
        self._put(52, round(self._kiln.cycle_minutes * 10))

    def _show(self) -> None:
        view = self._kiln.view()
        self._put(1, view.scan_counter)
        self._put(2, view.boot_id)
        self._put_real(3, _KILN_PROBE)
        self._put(
            5,
            view.heating | view.burner_fault << 1 | view.over_temp << 2 | view.at_set_point << 3 | view.blocked << 4,
        )
        self._put(6, min(view.tiles_inside, 0xFFFF))
        self._put(7, round(view.cycle_minutes * 10))
        self._put(8, ZONES)
        for zone, degc in enumerate(view.temperatures_degc):
            self._put_real(10 + 2 * zone, degc)
        self._put(26, view.cmd_ack)

    def _written(self, touched: range) -> None:
        if 32 in touched:
            self._kiln.command(
                KilnCommand(
                    cmd_seq=self._words[32],
                    set_points_degc=tuple(self._real(34 + 2 * zone) for zone in range(ZONES)),
                    ramp_degc_min=self._real(50),
                    cycle_minutes=self._words[52] / 10,
                )
            )
