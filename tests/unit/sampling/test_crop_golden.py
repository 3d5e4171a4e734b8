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
    ("inks", (0, 0, 200, 300), 0): "8a5799921964847d28068683f7da517bc234b4fb17f027782d51d11c67279aec",
    ("inks", (-1000, -777, 133, 222), 7): "74c0fedb5ba90885c55565cde5fa3387e612f117de84fd27ef64f221eec0c443",
    ("shifted", (-60, -60, 250, 250), 1): "4bff54a7adb6ff82c60386c87d8775313934cfcd1e801b15c51b596a312b4a7e",
    (
        "shifted",
        (1099511627787, -1099511627789, 200, 200),
        9223372036854775807,
    ): "0fa91210c769aac9e716b0d0ea6a4339c91d4366524b1bdd227d5f892e708fdf",
    ("rationed", (-100, 50, 150, 200), 0): "b3745e973a7e82e5d8492bce447a7308ea6c24760bff746dcee20107aa4dfbef",
    (
        "rationed",
        (-1152921504606846976, 1152921504606846776, 200, 200),
        3,
    ): "8b8183e3fc5a61b0a2b09f386b1a4783947872e4251f9987ba70d4da2111d407",
}

PREVIEWS = {
    ("inks", 2): "06963d84672811282865ec421ff8b2a7be3d23b4f4b051636c0883a92391e023",
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
