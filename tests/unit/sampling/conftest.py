"""Small crop maps in integers only: the same bits on every machine, whatever builds larger ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tilefab.sampling import CropMap, SlabArea
from tilefab.sampling.crop_map import BARRED
from tilefab.types import Array

Stone = Callable[[int, int, int], NDArray[np.float32]]


def make_crop_map(stone: Stone, **options: Any) -> CropMap:
    """Crop map over made-up stone, all of whose tables come from integers.

    ``options`` replace the numbers below; those not named there replace fields of the map.
    """
    defaults: dict[str, Any] = {
        "rows": 96,
        "cols": 112,
        "stone_seed": 1,
        "pitch_px": 16,
        "overlap_px": 8,
        "guide_shift": 0,
        "seam_levels": 2,
        "crops": 40,
        # Places are multiples of this: where the pitch is one, crops continue each other.
        "step_px": 1,
        "candidates": 24,
        "sweeps": 2,
        "weighted": False,
        "barred": (),
        "rationed": 0,
        "dtype": np.uint8,
        "channels": 3,
    }
    values = {name: options.pop(name, value) for name, value in defaults.items()}
    lab = stone(values["rows"], values["cols"], values["stone_seed"])
    half = np.rint(2 * lab).astype(np.int64) + np.array([0, 128, 128])
    quantum = 1 << values["guide_shift"]
    padded = np.pad(half, [(0, -side % quantum) for side in half.shape[:2]] + [(0, 0)], mode="edge")
    rows, cols = padded.shape[0] // quantum, padded.shape[1] // quantum
    guide = padded.reshape(rows, quantum, cols, quantum, 3).sum(axis=(1, 3)) // quantum**2
    if values["weighted"]:
        # A patch that had better not be cut.
        weight = np.zeros((rows, cols, 1), dtype=np.int64)
        weight[rows // 4 : rows // 2, cols // 3 : cols // 2] = 200
        guide = np.concatenate([guide, weight], axis=2)
    n, pitch, overlap = values["crops"], values["pitch_px"], values["overlap_px"]
    place = np.arange(1, n + 1, dtype=np.int64)
    row, col = (
        (place * step % 65536) * ((side - pitch - overlap) // quantum + 1) // 65536 * quantum
        for step, side in ((49471, values["rows"]), (37345, values["cols"]))
    )
    row, col = (at // values["step_px"] * values["step_px"] for at in (row, col))
    barred = np.zeros(n, dtype=bool)
    barred[list(values["barred"])] = True
    ration = np.full(n, -1)
    ration[: values["rationed"]] = np.arange(values["rationed"]) % 5
    fields: dict[str, Any] = {
        "base": _base(half, values["dtype"], values["channels"]),
        "space": "made up",
        "channels": tuple("abcdefgh"[: values["channels"]]),
        "dpi": 100.0,
        "slabs": (SlabArea("slab 1", 0, 0, values["rows"], values["cols"]),),
        "provenance": {"made of": "integers"},
        "guide": guide.astype(np.uint8),
        "guide_shift": values["guide_shift"],
        "crop_row": row.astype(np.int32),
        "crop_col": col.astype(np.int32),
        "pitch_px": pitch,
        "overlap_px": overlap,
        "seam_levels": values["seam_levels"],
        "side_cost": _joining(half, row, col, pitch, overlap, axis=1),
        "below_cost": _joining(half, row, col, pitch, overlap, axis=0),
        "price": np.where(barred, BARRED, place * 7919 % 301).astype(np.int32),
        "ration": ration.astype(np.int8),
        "candidates": min(values["candidates"], n),
        "sweeps": values["sweeps"],
    }
    return CropMap(**{**fields, **options})


def _base(half: NDArray[np.int64], dtype: type, channels: int) -> Array:
    """Channels that differ, over the whole range of 8 or 16 bits."""
    most = 255 if np.dtype(dtype) == np.uint8 else 65521
    mixed = [(half[..., k % 3] * (k + 3) + half[..., (k + 1) % 3] * (1 + 37 * k)) % most for k in range(channels)]
    return np.ascontiguousarray(np.stack(mixed, axis=2).astype(dtype))


def _joining(
    half: NDArray[np.int64], row: NDArray[np.int64], col: NDArray[np.int64], pitch: int, overlap: int, axis: int
) -> NDArray[np.uint16]:
    """Mean difference between the overlaps of every two crops, scaled to a median near 2000."""
    side = pitch + overlap
    crops = np.array([half[r : r + side, c : c + side] for r, c in zip(row, col, strict=True)])
    ends, begins = np.take(crops, range(pitch, side), axis + 1), np.take(crops, range(overlap), axis + 1)
    total = np.array([np.abs(end - begins).sum(axis=(1, 2, 3)) for end in ends])
    middle = max(int(np.sort(total, axis=None)[total.size // 2]), 1)
    return np.minimum(total * 2000 // middle, 30000).astype(np.uint16)


CROP_MAPS: dict[str, dict[str, Any]] = {
    # Four inks; every choice tries part of the dictionary, and the many crops that continue its neighbours'.
    "inks": {"channels": 4, "step_px": 8},
    # A guide at half size with weights, odd sizes, 16 bits, two slabs side by side, every crop tried.
    "shifted": {
        "rows": 131,
        "cols": 203,
        "stone_seed": 2,
        "pitch_px": 32,
        "overlap_px": 16,
        "guide_shift": 1,
        "seam_levels": 2,
        "weighted": True,
        "crops": 30,
        "candidates": 30,
        "sweeps": 1,
        "dtype": np.uint16,
        "slabs": (SlabArea("left", 0, 0, 131, 100), SlabArea("right", 0, 103, 131, 100)),
    },
    # Overlaps as wide as cells, crops that take turns, crops never shown, choices gone over once only.
    "rationed": {
        "rows": 120,
        "cols": 90,
        "stone_seed": 3,
        "pitch_px": 24,
        "overlap_px": 24,
        "seam_levels": 1,
        "crops": 50,
        "candidates": 20,
        "sweeps": 0,
        "barred": (20, 21, 33, 49),
        "rationed": 12,
        "dtype": np.float32,
        "channels": 1,
    },
}


def make_named_crop_map(stone: Stone, name: str) -> CropMap:
    """One of three small maps: ``inks``, ``shifted`` or ``rationed``."""
    return make_crop_map(stone, **CROP_MAPS[name])


@pytest.fixture(scope="session")
def crop_map_of(stone: Stone) -> Callable[..., CropMap]:
    return lambda **options: make_crop_map(stone, **options)


@pytest.fixture(scope="session")
def crop_maps(stone: Stone) -> dict[str, CropMap]:
    return {name: make_named_crop_map(stone, name) for name in CROP_MAPS}


@pytest.fixture(params=list(CROP_MAPS))
def crop_map(request: pytest.FixtureRequest, crop_maps: dict[str, CropMap]) -> CropMap:
    return crop_maps[request.param]
