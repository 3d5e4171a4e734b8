"""Pinned pixels: what is printed must never change unnoticed, between versions, machines or processes.

A value here changes only together with a dated line in docs/output_changes.md. Where it changes tells what did: the
region of the hand-made map only if the sampler did, a map's hash if quilting, candidates or the hash itself did.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tilefab.sampling import TileMap, render

CONFTEST = Path(__file__).parents[2] / "conftest.py"

MAP_HASHES = {
    "inks": "96118781ffb04e164fafa556c69035ce285e9161655eafd0be81910374224508",
    "masked": "95208fbe96d68e2606b2177097b343356eb93b00806f6bb13a4bbb0fe0fc51fe",
    "job": "b719b0d02e72d9e42560088f1b8524717f0bee0129aa094a574d39b21e65ea7d",
}

REGIONS = {
    ("inks", (0, 0, 200, 300), 0): "70cdcffa332ed1957be13a2bab75fe08daec324d0b98cbfa6ebcaa4d5af51378",
    ("inks", (-1000, -777, 333, 222), 7): "9eed6891a3d59eafdd4f5668cc0c1425431dfdab08b909a3351111c3e00a05a6",
    ("masked", (-60, -60, 250, 250), 1): "923d3673a23f58dff8e19352bebee7d69f6281b0f5b2a77bd5024c29b20a60fb",
    (
        "masked",
        (1099511627787, -1099511627789, 200, 200),
        9223372036854775807,
    ): "22a6ba87ba86432e144d7d2080d3ac0323d52ef896359079ee0dd665cb3fa9a1",
    ("job", (-100, 50, 300, 400), 0): "f24ad19d6e34a45e5f0d7c280765313656a64e9d2d5a3668eb98123457b6b0b9",
    (
        "job",
        (-1152921504606846976, 1152921504606846676, 300, 300),
        3,
    ): "ea4265497c927ebb6c68fd7fc0b2189df440a975707b535c6e8555c2c30b0715",
}


def region_hash(texture_map: TileMap, row: int, col: int, rows: int, cols: int, seed: int) -> str:
    picture = render(texture_map, row, col, rows, cols, seed=seed)
    little = np.ascontiguousarray(picture, dtype=picture.dtype.newbyteorder("<"))
    return hashlib.sha256(little.tobytes()).hexdigest()


@pytest.mark.parametrize("name", MAP_HASHES)
def test_maps_are_pinned(maps: dict[str, Any], name: str) -> None:
    assert maps[name].map.hash == MAP_HASHES[name]


@pytest.mark.parametrize(("name", "region", "seed"), REGIONS)
def test_regions_are_pinned(maps: dict[str, Any], name: str, region: tuple[int, int, int, int], seed: int) -> None:
    assert region_hash(maps[name].map, *region, seed) == REGIONS[name, region, seed]


def test_the_hand_made_map_is_pinned(hand_map: Callable[..., TileMap]) -> None:
    assert region_hash(hand_map(), -100, 2**40, 200, 150, 9) == (
        "b250d46fb29f7f52af445c786416f6a7d9c93930113c1168b67b08e8ac8924fd"
    )


SCRIPT = """
import hashlib, json, runpy, sys
from tilefab.sampling import render
built = runpy.run_path(sys.argv[1])["make_built"]("inks")
again = built.build_again(threads=2)
picture = render(again, -90, 1 << 33, 300, 280, seed=4, threads=2)
print(json.dumps([built.map.hash, again.hash, hashlib.sha256(picture.tobytes()).hexdigest()]))
"""


def test_another_process_makes_the_same(maps: dict[str, Any]) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT, str(CONFTEST)],
        env={**os.environ, "PYTHONHASHSEED": "12345", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    texture_map = maps["inks"].map
    picture = render(texture_map, -90, 1 << 33, 300, 280, seed=4, threads=1)
    assert json.loads(result.stdout) == [
        texture_map.hash,
        texture_map.hash,
        hashlib.sha256(picture.tobytes()).hexdigest(),
    ]
