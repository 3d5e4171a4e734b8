"""The texture-map file: nothing lost, and no damage unseen."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tilefab.errors import OutputError, TextureMapError
from tilefab.io.texture_map_file import MAGIC, load_texture_map, save_texture_map
from tilefab.sampling import FORMAT_VERSION, CropMap, Patches, TextureMap, TileMap, render
from tilefab.sampling.texture_map import SlabArea

PREFIX = struct.Struct("<12sIQ")


def small_map(dtype: str = "u1", patches: int = 3) -> TileMap:
    """A map of 13 x 11 pixels; with ``patches`` patches of two runs each."""
    random = np.random.default_rng(4)
    zeros = np.zeros(patches, dtype=np.int32)
    runs = np.tile(np.array([[0, 0, 3], [1, 1, 2]], dtype=np.int32), (patches, 1))
    table = Patches(
        count_a=(patches + 1) // 2,
        cell_row=zeros - 1,
        cell_col=zeros + 2,
        base_row=np.arange(patches, dtype=np.int32),
        base_col=zeros + 1,
        rows=zeros + 2,
        cols=zeros + 3,
        run_offset=np.arange(patches + 1, dtype=np.int64) * 2,
        runs=runs.reshape(-1, 3),
        overlaps=np.eye(patches, dtype=bool),
        worst_delta_e=random.random(patches, dtype=np.float32),
        mean_delta_e=random.random(patches, dtype=np.float32),
    )
    return TileMap(
        base=(random.random((13, 11, 3)) * 250).astype(dtype),
        tile_source=random.integers(0, 143, (7, 5)).astype(np.int32),
        patches=table,
        activation_threshold=1 << 30,
        space="lab16",
        channels=("L*", "a*", "b*"),
        dpi=72.5,
        slabs=(SlabArea("Steinplatte №1.tif", 0, 0, 13, 11),),
        provenance={"method": "quilting", "warnings": '["ünïcödé"]'},
    )


def small_crop_map(dtype: str = "u1", crops: int = 4) -> CropMap:
    """A map of 13 x 11 pixels, of crops of 6 x 6 pixels of which two, perhaps, take turns."""
    random = np.random.default_rng(5)
    return CropMap(
        base=(random.random((13, 11, 3)) * 250).astype(dtype),
        space="lab16",
        channels=("L*", "a*", "b*"),
        dpi=72.5,
        slabs=(SlabArea("Steinplatte №1.tif", 0, 0, 13, 11),),
        provenance={"design": "crops", "warnings": '["ünïcödé"]'},
        guide=random.integers(0, 256, (7, 6, 4)).astype(np.uint8),
        guide_shift=1,
        crop_row=(np.arange(crops, dtype=np.int32) * 2) % 6,
        crop_col=(np.arange(crops, dtype=np.int32) * 2) % 4,
        pitch_px=4,
        overlap_px=4,
        seam_levels=0,
        side_cost=random.integers(0, 5000, (crops, crops)).astype(np.uint16),
        below_cost=random.integers(0, 5000, (crops, crops)).astype(np.uint16),
        price=random.integers(-900, 900, crops).astype(np.int32),
        ration=(np.arange(crops) % 3 - 1).astype(np.int8),
        candidates=crops,
        sweeps=1,
    )


@pytest.fixture(scope="module", params=[small_map, small_crop_map], ids=["tile", "crops"])
def saved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes, TextureMap]:
    path = tmp_path_factory.mktemp("map") / "a.tfmap"
    texture = request.param()
    save_texture_map(path, texture)
    return path, path.read_bytes(), texture


def assert_same(loaded: TextureMap, texture: TextureMap) -> None:
    assert loaded.hash == texture.hash
    for name, array in texture.arrays().items():
        assert loaded.arrays()[name].dtype == array.dtype, name
        np.testing.assert_array_equal(loaded.arrays()[name], array, err_msg=name)
    for name in ("design", "space", "channels", "dpi", "slabs", "provenance"):
        assert getattr(loaded, name) == getattr(texture, name), name
    assert type(loaded) is type(texture)
    assert loaded.parameters() == texture.parameters()


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
@pytest.mark.parametrize(
    ("make", "size"), [(small_map, 0), (small_map, 1), (small_map, 3), (small_crop_map, 1), (small_crop_map, 7)]
)
def test_nothing_is_lost(tmp_path: Path, dtype: str, make: Callable[[str, int], TextureMap], size: int) -> None:
    texture = make(dtype, size)
    save_texture_map(tmp_path / "a.tfmap", texture)
    loaded = load_texture_map(tmp_path / "a.tfmap")
    assert_same(loaded, texture)
    there = render(loaded, -20, 7, 40, 33, seed=9, threads=1)
    np.testing.assert_array_equal(there, render(texture, -20, 7, 40, 33, seed=9, threads=1))


def test_built_maps_come_back(tmp_path: Path, maps: dict[str, object]) -> None:
    for name, built in maps.items():
        texture: TileMap = built.map  # type: ignore[attr-defined]
        save_texture_map(str(tmp_path / f"{name}.tfmap"), texture)
        assert_same(load_texture_map(str(tmp_path / f"{name}.tfmap")), texture)


def test_the_file_is_the_same_each_time(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    save_texture_map(tmp_path / "b.tfmap", load_texture_map(saved[0]))
    assert (tmp_path / "b.tfmap").read_bytes() == saved[1]


def test_big_endian_and_strided_arrays_are_stored_as_they_mean(tmp_path: Path) -> None:
    texture = small_map("u2")
    other = texture.with_base(texture.base.astype(">u2"), texture.space, texture.channels)
    save_texture_map(tmp_path / "a.tfmap", other)
    loaded = load_texture_map(tmp_path / "a.tfmap")
    assert loaded.hash == texture.hash
    np.testing.assert_array_equal(loaded.base, texture.base)


def test_arrays_are_mapped_read_only_and_aligned(saved: tuple[Path, bytes, TextureMap]) -> None:
    loaded = load_texture_map(saved[0])
    _, _, length = PREFIX.unpack(saved[1][: PREFIX.size])
    start = PREFIX.size + length
    assert start % 64 == 0
    table = json.loads(saved[1][PREFIX.size : start])["arrays"]
    assert [entry["name"] for entry in table] == list(loaded.arrays())
    for entry in table:
        array = loaded.arrays()[entry["name"]]
        assert entry["offset"] % 64 == 0
        assert array.ctypes.data % 64 == 0
        assert not array.flags.writeable
        assert not array.flags.owndata
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        begin = start + entry["offset"]
        assert saved[1][begin : begin + array.nbytes] == array.tobytes()


def refusal(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(TextureMapError) as caught:
        load_texture_map(path)
    assert caught.value.exit_code == 7
    assert caught.value.path == str(path)
    assert caught.value.message.startswith(f"{path}: ")
    return caught.value.message


def test_every_flipped_bit_is_found(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    whole = saved[1]
    _, _, length = PREFIX.unpack(whole[: PREFIX.size])
    # All of prefix and header with one bit each, then every byte of the arrays and the gaps between them.
    for place in range(len(whole)):
        bits = range(8) if place < PREFIX.size else (place % 8,)
        for bit in bits:
            damaged = bytearray(whole)
            damaged[place] ^= 1 << bit
            message = refusal(tmp_path / "a.tfmap", bytes(damaged))
            if place >= PREFIX.size:
                assert "damaged" in message or "truncated" in message, (place, length, message)


def test_every_truncation_is_found(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    whole = saved[1]
    for size in range(0, len(whole), 7):
        message = refusal(tmp_path / "a.tfmap", whole[:size])
        expected = "not a texture map" if size < PREFIX.size else "truncated"
        assert expected in message, size
    assert "truncated" in refusal(tmp_path / "a.tfmap", whole[:-1])
    assert "longer" in refusal(tmp_path / "a.tfmap", whole + b"\0")


def with_header(whole: bytes, change: Callable[[dict[str, object]], object]) -> bytes:
    _, version, length = PREFIX.unpack(whole[: PREFIX.size])
    header = json.loads(whole[PREFIX.size : PREFIX.size + length])
    changed = change(header)
    text = json.dumps(header if changed is None else changed).encode()
    text += b" " * (-(PREFIX.size + len(text)) % 64)
    return PREFIX.pack(MAGIC, version, len(text)) + text + whole[PREFIX.size + length :]


def test_the_change_of_a_header_is_itself_harmless(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    (tmp_path / "a.tfmap").write_bytes(with_header(saved[1], lambda _: None))
    assert load_texture_map(tmp_path / "a.tfmap").hash == saved[2].hash


def _set_entry(name: str, value: object) -> Callable[[dict[str, object]], object]:
    def change(header: dict[str, object]) -> None:
        header["arrays"][0][name] = value  # type: ignore[index]

    return change


@pytest.mark.parametrize(
    "change",
    [
        lambda h: h.update(hash="0" * 64),
        lambda h: h.update(hash=None),
        lambda h: h.update(space="lab8"),
        lambda h: h.update(dpi=72.6),
        lambda h: h.update(dpi=float("nan")),
        lambda h: h.update(channels=["L*", "a*"]),
        lambda h: h.update(design="wang"),
        lambda h: h.update(design=["tile"]),
        lambda h: h.pop("design"),
        lambda h: h.update(design={"tile": "crops", "crops": "tile"}[h["design"]]),
        lambda h: h.update(parameters=[]),
        lambda h: h.pop("parameters"),
        lambda h: h["parameters"].update(dict.fromkeys(h["parameters"], -1)),
        lambda h: h["parameters"].update(dict.fromkeys(h["parameters"], 1 << 40)),
        lambda h: h["parameters"].update(dict.fromkeys(h["parameters"], float("inf"))),
        lambda h: h["parameters"].popitem(),
        lambda h: h.update(slabs=[[]]),
        lambda h: h.update(slabs=[["a", 0, 0, 13, 11, 12]]),
        lambda h: h.update(provenance=[]),
        lambda h: h["provenance"].update(method="chaos"),
        lambda h: h.pop("arrays"),
        lambda h: h["arrays"].pop(),
        lambda h: h["arrays"].append({"name": "patch_more", "dtype": "|u1", "shape": [0], "offset": 0}),
        lambda h: h["arrays"].reverse(),
        lambda _: [],
        lambda _: 7,
        lambda _: "text",
        _set_entry("dtype", "|O"),
        _set_entry("dtype", "<u2"),
        _set_entry("offset", -64),
        _set_entry("offset", 1 << 60),
        _set_entry("offset", "64"),
        _set_entry("shape", [-13, 11, 3]),
        _set_entry("shape", [13, 11]),
        _set_entry("shape", [13, 11, 3, 1]),
        _set_entry("shape", [1 << 62, 1 << 62, 3]),
        _set_entry("shape", ["13", 11, 3]),
        _set_entry("shape", 3),
    ],
)
def test_a_header_that_contradicts_its_contents_is_found(
    tmp_path: Path, saved: tuple[Path, bytes, TextureMap], change: Callable[[dict[str, object]], object]
) -> None:
    refusal(tmp_path / "a.tfmap", with_header(saved[1], change))


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
def test_any_damage_is_found(tmp_path: Path, saved: tuple[Path, bytes, TextureMap], data: st.DataObject) -> None:
    whole = saved[1]
    start = data.draw(st.integers(0, len(whole)))
    length = data.draw(st.integers(0, 40))
    damaged = whole[:start] + data.draw(st.binary(max_size=40)) + whole[start + length :]
    if damaged != whole:
        refusal(tmp_path / "a.tfmap", damaged)


def test_other_versions_say_so(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    whole = saved[1]
    later = whole[:12] + struct.pack("<I", FORMAT_VERSION + 1) + whole[16:]
    message = refusal(tmp_path / "a.tfmap", later)
    assert f"a later version of tilefab (format {FORMAT_VERSION + 1}; this one reads {FORMAT_VERSION})" in message
    assert "an earlier version" in refusal(tmp_path / "a.tfmap", whole[:12] + struct.pack("<I", 0) + whole[16:])


def test_what_is_no_map_is_refused(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    assert "not a texture map" in refusal(tmp_path / "a.tfmap", b"")
    assert "not a texture map" in refusal(tmp_path / "a.tfmap", b"tilefab maps" + saved[1][12:])
    with pytest.raises(TextureMapError, match="there is no such file"):
        load_texture_map(tmp_path / "absent.tfmap")
    with pytest.raises(TextureMapError, match="can't be read"):
        load_texture_map(tmp_path)


def test_a_map_that_can_t_be_written_leaves_nothing(tmp_path: Path, saved: tuple[Path, bytes, TextureMap]) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError):
        save_texture_map(tmp_path / "file" / "a.tfmap", saved[2])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
