"""Fingerprints tell faces apart, are found by counting bits, and come back from a store as they went."""

from __future__ import annotations

import numpy as np
import pytest

from tests.imagined_stone import ImaginedStone
from tilefab.inspection.fingerprint import (
    CODE_CELLS,
    FINGERPRINT_VERSION,
    FingerprintIndex,
    code_bits,
    fingerprints,
    packed,
)
from tilefab.inspection.fingerprint_kernels import count_differing
from tilefab.inspection.views import Cells, cells_of_view
from tilefab.types import SizeMm, SizePx

SIZE = SizeMm(150.0, 150.0)
STONE = ImaginedStone(SIZE)


def test_kernel_counts_bits() -> None:
    generator = np.random.default_rng(1)
    codes, wanted, masks = (
        generator.integers(0, 1 << 64, (count, 3), dtype=np.uint64, endpoint=False) for count in (50, 4, 4)
    )
    out = np.empty((4, 50), np.int32)
    count_differing(codes, wanted, masks, out)
    for turn in range(4):
        for face in range(50):
            bits = [int(a ^ b) & int(m) for a, b, m in zip(codes[face], wanted[turn], masks[turn], strict=True)]
            assert out[turn, face] == sum(value.bit_count() for value in bits)


def test_packed_bits_are_in_order() -> None:
    bits = np.zeros((2, 5, 30), dtype=np.bool_)
    bits[0, 0, 0] = bits[0, 2, 5] = True  # cell 65: the second bit of the second word
    words = packed(bits)
    assert words.shape == (2, 3)
    assert words[0].tolist() == [1, 2, 0]
    assert words[1].tolist() == [0, 0, 0]


@pytest.mark.parametrize("size", [SIZE, SizeMm(600.0, 300.0), SizeMm(200.0, 1200.0)])
def test_faces_differ_and_are_found(size: SizeMm) -> None:
    small = SizeMm(size.width / 4.0, size.height / 4.0)
    stone = ImaginedStone(small, grain_mm=2.0)
    index = fingerprints(stone, range(10, 40), size)
    assert index.faces.tolist() == list(range(10, 40))
    assert index.grid.rows * index.grid.cols <= CODE_CELLS
    bits, known = code_bits(cells_of_view(stone(17, 64), index.grid))
    counts = index.differing(bits[np.newaxis], known[np.newaxis])[0]
    assert counts[7] <= 0.02 * known.sum()
    others = np.delete(counts, 7)
    assert others.min() > 0.25 * known.sum()


def test_unknown_cells_are_left_out() -> None:
    index = fingerprints(STONE, range(5), SIZE)
    cells = cells_of_view(STONE(3, 64), index.grid)
    seen = cells.seen.copy()
    seen[:, 16:] = False
    bits, known = code_bits(Cells(cells.lightness, seen))
    assert not known[:, 16:].any()
    assert 0.6 < known[:, :16].mean() < 0.8
    nothing = np.zeros((1, index.grid.rows, index.grid.cols), dtype=np.bool_)
    assert (index.differing(bits[np.newaxis], nothing) == 0).all()
    assert not code_bits(Cells(cells.lightness, np.zeros_like(seen)))[1].any()


def test_store_narrow_and_join() -> None:
    index = fingerprints(STONE, [4, 9, 2], SIZE)
    again = FingerprintIndex.from_arrays(index.arrays())
    assert again.grid == index.grid
    np.testing.assert_array_equal(again.codes, index.codes)
    part = index.narrowed([2, 4, 77])
    assert part.faces.tolist() == [4, 2]
    np.testing.assert_array_equal(part.codes, index.codes[[0, 2]])
    joined = part.joined(index.narrowed([9]))
    assert joined.faces.tolist() == [4, 2, 9]
    assert len(index.narrowed([])) == 0


def test_what_does_not_fit_is_refused() -> None:
    index = fingerprints(STONE, [1], SIZE)
    arrays = index.arrays()
    with pytest.raises(ValueError, match="without codes"):
        FingerprintIndex.from_arrays({"about": arrays["about"], "faces": arrays["faces"]})
    old = arrays | {"about": np.array([FINGERPRINT_VERSION + 1, 32, 32])}
    with pytest.raises(ValueError, match="version"):
        FingerprintIndex.from_arrays(old)
    with pytest.raises(ValueError, match="must be"):
        FingerprintIndex(index.faces, index.codes[:, :3], index.grid)
    with pytest.raises(ValueError, match="can't join"):
        index.joined(FingerprintIndex(index.faces, index.codes, SizePx(16, 64)))
