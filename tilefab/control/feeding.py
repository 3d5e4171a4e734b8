"""How many tiles the loader should still feed: no more than there are faces for, and no fewer.

The conveyor counts tiles fed and tiles seen at the eye. Their difference is what lies between, but for tiles that were
taken off or fell off there: they stay in it. So what hasn't come after a stretch of belt that is longer than any such
way is taken not to come any more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

_WORD = 1 << 32


@dataclass(frozen=True)
class Feeding:
    """What is known of tiles between loader and eye.

    Attributes
    ----------
    plc_boot
        Boot of the conveyor's controller that the counts belong to.
    gone
        Tiles that were fed and won't be seen, modulo 2**32.
    tiles_fed, tile_seq
        Counts as they were last.
    position_counts
        Position of the belt when they changed last.
    coming
        Tiles on their way to the eye.
    overdue
        Whether nothing came although the belt went all the way.
    """

    plc_boot: int = 0
    gone: int = 0
    tiles_fed: int = 0
    tile_seq: int = 0
    position_counts: int = 0
    coming: int = 0
    overdue: bool = False


def watch_feed(
    before: Feeding, *, plc_boot: int, tiles_fed: int, tile_seq: int, position_counts: int, way_counts: int
) -> Feeding:
    """Go on by one look at the conveyor.

    Parameters
    ----------
    before
        As it was; a new `Feeding` in the beginning.
    plc_boot, tiles_fed, tile_seq, position_counts
        As the conveyor tells.
    way_counts
        A stretch of belt longer than the way from loader to eye.

    >>> now = watch_feed(Feeding(), plc_boot=1, tiles_fed=9, tile_seq=4, position_counts=0, way_counts=100)
    >>> now.coming
    5
    >>> now = watch_feed(now, plc_boot=1, tiles_fed=9, tile_seq=4, position_counts=101, way_counts=100)
    >>> now.coming, now.overdue
    (0, True)
    """
    if before.plc_boot != plc_boot:
        before = Feeding(plc_boot, 0, tiles_fed, tile_seq, position_counts)
    seen = before.tile_seq != tile_seq
    coming = _signed(tiles_fed - tile_seq - before.gone)
    if coming < 0:
        # Somebody put tiles on the belt by hand.
        before, coming = replace(before, gone=(tiles_fed - tile_seq) % _WORD), 0
    if seen:
        return Feeding(plc_boot, before.gone, tiles_fed, tile_seq, position_counts, coming)
    overdue = (position_counts - before.position_counts) % _WORD > way_counts
    if overdue and coming:
        return Feeding(plc_boot, (tiles_fed - tile_seq) % _WORD, tiles_fed, tile_seq, position_counts, 0, overdue=True)
    return replace(before, tiles_fed=tiles_fed, coming=coming, overdue=overdue)


def _signed(count: int) -> int:
    return (count + _WORD // 2) % _WORD - _WORD // 2
