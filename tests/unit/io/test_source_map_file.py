"""Maps of places survive a file, and a damaged one is never taken for good."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tilefab.errors import OutputError, TextureMapError
from tilefab.io.source_map_file import SourceMap, load_source_map, save_source_map
from tilefab.types import SizePx


def some_map() -> SourceMap:
    source = np.random.default_rng(1).integers(0, 40 * 50, size=(30, 20)).astype(np.int32)
    return SourceMap(source, SizePx(40, 50), "quilting", 2**63 - 1, toroidal=True, complete=False, notes=("ünusual",))


def test_a_map_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "a.npz"
    save_source_map(path, some_map())
    back = load_source_map(path)
    assert_array_equal(back.source, some_map().source)
    assert back.source.dtype == np.int32
    assert (back.exemplar, back.method, back.seed) == (SizePx(40, 50), "quilting", 2**63 - 1)
    assert (back.toroidal, back.complete, back.notes) == (True, False, ("ünusual",))
    # Plain NumPy reads it, and the same map is the same bytes.
    with np.load(path, allow_pickle=False) as plain:
        assert_array_equal(plain["source"], some_map().source)
        assert json.loads(plain["facts"].tobytes())["exemplar"] == [40, 50]
    save_source_map(tmp_path / "b.npz", some_map())
    assert (tmp_path / "b.npz").read_bytes() == path.read_bytes()


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"end its name in \.npz"):
        save_source_map(tmp_path / "a.png", some_map())
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_map_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with pytest.raises(TextureMapError, match="no such file"):
        load_source_map(path)
    with pytest.raises(TextureMapError, match="can't be read"):
        load_source_map(tmp_path)
    for content in (b"", b"rubbish", b"PK\x03\x04 rubbish"):
        path.write_bytes(content)
        with pytest.raises(TextureMapError, match="no map of places"):
            load_source_map(path)
    np.savez(path, other=np.zeros(3))
    with pytest.raises(TextureMapError, match="no map of places"):
        load_source_map(path)


def test_no_map_is_advised_to_be_loaded_unsafely(tmp_path: Path) -> None:
    (tmp_path / "picture.npz").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(40))
    np.save(tmp_path / "array.npy", np.zeros(3))
    for name in ("picture.npz", "array.npy"):
        with pytest.raises(TextureMapError, match=r"\(it is no NumPy archive\)"):
            load_source_map(tmp_path / name)


def test_no_flipped_byte_goes_unnoticed(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    save_source_map(path, some_map())
    whole = path.read_bytes()
    for at in range(0, len(whole), 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x41]) + whole[at + 1 :])
        try:
            back = load_source_map(path)
        except TextureMapError:
            continue
        # Some bytes of an archive mean nothing (dates, its own bookkeeping).
        assert_array_equal(back.source, some_map().source)
    path.write_bytes(whole[:-40])
    with pytest.raises(TextureMapError):
        load_source_map(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"version": 2}, "later version"),
        ({"kind": "something else"}, "something else"),
        ({"exemplar": [40, 49]}, "outside its exemplar"),
        ({"exemplar": [40]}, "no map of places"),
        ({"sha256": "0" * 64}, "checksum"),
        ({"seed": None}, "no map of places"),
    ],
)
def test_wrong_facts_are_refused(tmp_path: Path, change: dict[str, Any], match: str) -> None:
    path, places = tmp_path / "a.npz", some_map()
    places = replace(places, source=places.source.copy())
    places.source[0, 0] = 1999
    save_source_map(path, places)
    with np.load(path) as file:
        source, facts = file["source"], json.loads(file["facts"].tobytes())
    np.savez(path, source=source, facts=np.frombuffer(json.dumps({**facts, **change}).encode(), dtype=np.uint8))
    with pytest.raises(TextureMapError, match=match):
        load_source_map(path)
