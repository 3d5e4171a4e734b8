"""Pinned pixels of the crop design: what is printed must never change unnoticed, on any machine, in any process.

A value here changes only together with a dated line in docs/output_changes.md. The maps are made of integers, so a
region's hash changes only if the sampler does.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tilefab.sampling import CropMap, render, render_reduced

HERE = Path(__file__).parent

MAP_HASHES = {
    "inks": "3cb6c8c62bf2e4391a9b02d957816746a253e3c8c684b6fcbddfd5e6986eee23",
    "shifted": "815f5005704f527d912bdf979d7b855ff2ae640ab24735b521619e9236b369c1",
    "rationed": "2576776ce990365ce52291f67ddecf56c3d6824346a4ef483f096816f183203e",
}

REGIONS = {
    ("inks", (0, 0, 200, 300), 0): "15e937c9ff0f79db46f49acd0640511ca8c88a638ecc5a09a2e44d46aa9076d5",
    ("inks", (-1000, -777, 133, 222), 7): "c540745faa039f431ac06525380640ac63a7b3d0cc62d84026387f247c020973",
    ("shifted", (-60, -60, 250, 250), 1): "49fe77e3561b6afa2970cab53ede9cda38ee8ee0ba308db68c45008908dae8fa",
    (
        "shifted",
        (1099511627787, -1099511627789, 200, 200),
        9223372036854775807,
    ): "3c303df6d748e8f43a1fe21449efb30e78790e519fe1c3bec97f56fe6cf74a01",
    ("rationed", (-100, 50, 150, 200), 0): "5932510cbc4750a8ae5e3fce13b4cbfb397cc28bf5afe8387f42092d882db6a4",
    (
        "rationed",
        (-1152921504606846976, 1152921504606846776, 200, 200),
        3,
    ): "4931b33567bae2f01049f6ab2fed23b4d3c5644848c86633813ebda4e25b986e",
}

PREVIEWS = {
    ("inks", 2): "bbd84e685f1a4eb713fd273888ec3a395ea878770fa3052956786cb3dc2baaad",
    ("shifted", 4): "544edd0831144b5caa169fa647d8b72b2bb1508170d64afea3c666cc2899e008",
}


def sha256(picture: np.ndarray) -> str:  # type: ignore[type-arg]
    little = np.ascontiguousarray(picture, dtype=picture.dtype.newbyteorder("<"))
    return hashlib.sha256(little.tobytes()).hexdigest()


@pytest.mark.parametrize("name", MAP_HASHES)
def test_maps_are_pinned(crop_maps: dict[str, CropMap], name: str) -> None:
    assert crop_maps[name].hash == MAP_HASHES[name]


@pytest.mark.parametrize(("name", "region", "seed"), REGIONS)
def test_regions_are_pinned(
    crop_maps: dict[str, CropMap], name: str, region: tuple[int, int, int, int], seed: int
) -> None:
    assert sha256(render(crop_maps[name], *region, seed=seed)) == REGIONS[name, region, seed]


@pytest.mark.parametrize(("name", "level"), PREVIEWS)
def test_previews_are_pinned(crop_maps: dict[str, CropMap], name: str, level: int) -> None:
    assert sha256(render_reduced(crop_maps[name], -50, 60, 70, 80, level=level, seed=5)) == PREVIEWS[name, level]


SCRIPT = """
import hashlib, json, runpy, sys
from tilefab.sampling import render
stone = runpy.run_path(sys.argv[1])["make_stone"]
crop_map = runpy.run_path(sys.argv[2])["make_named_crop_map"](stone, "shifted")
picture = render(crop_map, -90, 1 << 33, 300, 280, seed=4, threads=2)
print(json.dumps([crop_map.hash, hashlib.sha256(picture.tobytes()).hexdigest()]))
"""


def test_another_process_makes_the_same(crop_maps: dict[str, CropMap]) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT, str(HERE.parents[1] / "conftest.py"), str(HERE / "conftest.py")],
        env={**os.environ, "PYTHONHASHSEED": "12345", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    picture = render(crop_maps["shifted"], -90, 1 << 33, 300, 280, seed=4, threads=1)
    assert json.loads(result.stdout) == [crop_maps["shifted"].hash, hashlib.sha256(picture.tobytes()).hexdigest()]
