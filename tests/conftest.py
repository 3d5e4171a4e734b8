"""Shared by all tests: made-up stone in integers, and small texture maps built from it once a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from tilefab.sampling import Patches, TileMap, TileOptions, build_tile_map
from tilefab.sampling.texture_map import SlabArea
from tilefab.synthesis import METHODS, SynthesisRequest
from tilefab.types import Array, Mask, SizePx

# A kernel's first call compiles it: no test may be judged by the time it takes. And a run repeats the last one.
settings.register_profile("tilefab", deadline=None, derandomize=True)
settings.load_profile("tilefab")


@dataclass(frozen=True)
class Built:
    """A texture map with all that it was built from."""

    map: TileMap
    lab: NDArray[np.float32]
    valid: Mask
    source: NDArray[np.int32]
    options: TileOptions
    stored: Array

    def build_again(self, **changes: object) -> TileMap:
        """Build the map anew; ``changes`` are arguments of `TileOptions`."""
        options = TileOptions(**{**self.options.__dict__, **changes})
        return build_tile_map(
            self.lab,
            self.valid,
            self.source,
            options,
            stored=self.stored,
            space=self.map.space,
            channels=self.map.channels,
            dpi=self.map.dpi,
            slabs=self.map.slabs,
            provenance=self.map.provenance,
        )


def _noise(rows: int, cols: int, seed: int) -> NDArray[np.int64]:
    """16-bit white noise, (rows, cols), by integer hashing."""
    low = np.uint64(0xFFFFFFFF)
    row, col = np.arange(rows, dtype=np.uint64)[:, None], np.arange(cols, dtype=np.uint64)[None, :]
    x = (row * np.uint64(0x9E3779B1) + col * np.uint64(0x85EBCA77) + np.uint64(seed * 0xC2B2AE3D)) & low
    for multiplier, shift in ((0x7FEB352D, 15), (0x846CA68B, 16)):
        x ^= x >> np.uint64(16)
        x = (x * np.uint64(multiplier)) & low
        x ^= x >> np.uint64(shift)
    return (x >> np.uint64(16)).astype(np.int64)


def _blurred(values: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    side = 2 * reach + 1
    padded = np.pad(values, reach, mode="wrap")
    total = np.zeros((padded.shape[0] + 1, padded.shape[1] + 1), dtype=np.int64)
    total[1:, 1:] = padded.cumsum(axis=0).cumsum(axis=1)
    return (total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]) // side**2


def make_stone(rows: int, cols: int, seed: int) -> NDArray[np.float32]:
    """Made-up stone in CIELAB, (rows, cols, 3): whole half units, so the same bits everywhere."""
    channels = []
    for k, (middle, span, reach) in enumerate(((60, 30, 2), (2, 6, 4), (8, 10, 3))):
        values = _blurred(_blurred(_noise(rows, cols, 3 * seed + k), reach), reach)
        low, high = int(values.min()), int(values.max())
        channels.append(2 * middle - span + (values - low) * (2 * span) // max(high - low, 1))
    return (np.stack(channels, axis=2) / 2).astype(np.float32)


def make_index_base(rows: int, cols: int) -> NDArray[np.int32]:
    """Base whose pixels are their own flat index: what is rendered from it tells where each pixel came from."""
    return np.arange(rows * cols, dtype=np.int32).reshape(rows, cols, 1)


def _holes(rows: int, cols: int) -> Mask:
    """Valid mask with a round hole, a lost corner and scattered bad pixels."""
    row, col = np.arange(rows)[:, None], np.arange(cols)[None, :]
    valid = (row - rows // 3) ** 2 + (col - cols // 4) ** 2 > (min(rows, cols) // 9) ** 2
    valid &= row + col > 12
    valid[rows - 5, cols - 9] = valid[2, cols - 2] = False
    return valid


def make_built(name: str) -> Built:
    """One of three small maps, built from nothing but integers: ``inks``, ``masked`` or ``job``."""
    if name == "inks":  # four inks, no mask, tile smaller than the exemplar
        lab, valid, size = make_stone(96, 112, 1), np.ones((96, 112), dtype=bool), SizePx(64, 80)
        half = np.rint(2 * lab).astype(np.int64)
        stored = np.stack([half[..., 0], 100 + half[..., 1], 90 + half[..., 2], half.sum(axis=2) % 251], axis=2)
        stored, space, channels = stored.astype(np.uint8), "ink8", ("C", "B", "Y", "K")
        options = TileOptions(patches=60, active_per_cell=12.0, seed=5, threads=1)
    elif name == "masked":  # 16 bits, a mask, odd and prime sizes
        lab, valid, size = make_stone(131, 103, 2), _holes(131, 103), SizePx(53, 61)
        stored, space, channels = np.rint(200 * lab + 9000).astype(np.uint16), "lab16", ("L", "a", "b")
        options = TileOptions(patches=40, active_per_cell=9.5, seed=2**63 - 1, threads=1)
    else:  # as many active patches as a job has
        lab, valid, size = make_stone(150, 140, 3), np.ones((150, 140), dtype=bool), SizePx(96, 90)
        stored, space, channels = lab.copy(), "lab", ("L", "a", "b")
        options = TileOptions(patches=150, active_per_cell=40.0, seed=0, threads=1)
    quilt = METHODS["quilting"](SynthesisRequest(lab, valid, size, options.seed))
    texture_map = build_tile_map(
        lab,
        valid,
        quilt.source,
        options,
        stored=stored,
        space=space,
        channels=channels,
        dpi=100.0,
        slabs=(SlabArea("slab 1", 0, 0, lab.shape[0], lab.shape[1]),),
        provenance={"made of": name},
    )
    return Built(texture_map, lab, valid, quilt.source, options, stored)


def make_hand_map(**changes: object) -> TileMap:
    """Smallest map with everything in it: a 4 x 6 tile over a 5 x 7 base, two patches of A and one of B.

    ``changes`` replace fields of the map or of its patches.
    """
    patches: dict[str, object] = {
        "count_a": 2,
        "cell_row": np.array([1, -1, 0], dtype=np.int32),
        "cell_col": np.array([1, 2, 2], dtype=np.int32),
        "base_row": np.array([0, 2, 3], dtype=np.int32),
        "base_col": np.array([4, 0, 5], dtype=np.int32),
        "rows": np.array([2, 3, 1], dtype=np.int32),
        "cols": np.array([3, 2, 2], dtype=np.int32),
        "run_offset": np.array([0, 3, 6, 7], dtype=np.int64),
        "runs": np.array([[0, 0, 1], [0, 2, 1], [1, 0, 3], [0, 0, 2], [1, 0, 2], [2, 1, 1], [0, 0, 2]], dtype=np.int32),
        "overlaps": np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=bool),
        "worst_delta_e": np.array([1.5, 2.0, 0.5], dtype=np.float32),
        "mean_delta_e": np.array([1.0, 1.25, 0.25], dtype=np.float32),
    }
    patches.update({name: changes.pop(name) for name in list(changes) if name in patches})
    fields: dict[str, object] = {
        "base": np.arange(70, dtype=np.uint8).reshape(5, 7, 2),
        "tile_source": np.arange(24, dtype=np.int32).reshape(4, 6)[::-1] + 3,
        "patches": Patches(**patches),  # type: ignore[arg-type]
        "activation_threshold": 1 << 31,
        "space": "ink8",
        "channels": ("C", "K"),
        "dpi": 400.0,
        "slabs": (SlabArea("a", 0, 0, 5, 7),),
        "provenance": {"scan": "a.tif"},
    }
    return TileMap(**{**fields, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def stone() -> Callable[[int, int, int], NDArray[np.float32]]:
    return make_stone


@pytest.fixture(scope="session")
def index_base() -> Callable[[int, int], NDArray[np.int32]]:
    return make_index_base


@pytest.fixture(scope="session")
def hand_map() -> Callable[..., TileMap]:
    return make_hand_map


@pytest.fixture(scope="session")
def maps() -> dict[str, Built]:
    return {name: make_built(name) for name in ("inks", "masked", "job")}


@pytest.fixture(params=["inks", "masked", "job"])
def built(request: pytest.FixtureRequest, maps: dict[str, Built]) -> Built:
    return maps[request.param]
