"""Tables of profiles, read and held against Little CMS, nodes and formulas."""

from pathlib import Path
from typing import Literal

import imagecodecs
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.icc_samples import (
    curv,
    fixed,
    lut_a_b,
    lut_mft,
    make_profile,
    multilinear,
    para,
    small_link,
    small_profile,
)
from tilefab.colour.spaces import WHITE_XYZ_D50, lab_from_xyz
from tilefab.colour.stages import Curves, Grid
from tilefab.errors import ProfileError
from tilefab.io.icc import IccProfile, parse_icc_profile, read_icc_profile
from tilefab.io.icc_tables import device_to_pcs, link_table, pcs_to_device, read_table

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.icc"
LAB2, LAB4, XYZ = (imagecodecs.cms_profile(name) for name in ("lab2", "lab4", "xyz"))
NUMBERS = {"perceptual": 0, "relative": 1, "saturation": 2}
DRAW = np.random.default_rng(5)
SOME_LAB = DRAW.uniform([0, -60, -60], [100, 60, 60], (400, 3))
SOME_DEVICE = DRAW.random((400, 4))
THREE = np.array([0, 65535])
EYE = np.eye(3)


def little_cms(
    values: NDArray[np.float64], profiles: tuple[bytes, bytes], spaces: tuple[str, str], intent: int
) -> NDArray[np.float64]:
    """Floating point through Little CMS, which counts CMYK in percent."""
    scale = 100.0 if spaces[0] in ("cmyk", "cmy") else 1.0
    data = np.ascontiguousarray(values[np.newaxis] * scale, dtype=np.float32)
    if spaces[0] == "gray":
        data = data[..., 0]
    out = imagecodecs.cms_transform(
        data, *profiles, colorspace=spaces[0], outcolorspace=spaces[1], outdtype="f4", intent=intent
    )
    out = np.asarray(out, dtype=np.float64)[0] / (100.0 if spaces[1] in ("cmyk", "cmy") else 1.0)
    return out.reshape(len(values), -1)


def parsed(data: bytes) -> IccProfile:
    return parse_icc_profile(data, "some.icc")


@pytest.mark.parametrize(
    ("data", "intents"),
    [
        (SHIPPED.read_bytes(), ("perceptual", "relative", "saturation")),
        (small_profile(4, 2), ("perceptual", "relative", "saturation")),
        (small_profile(4, 4), ("relative",)),  # in the others Little CMS adapts blacks of version 4 unasked
    ],
    ids=["shipped", "version 2", "version 4"],
)
def test_press_tables_are_those_of_little_cms(data: bytes, intents: tuple[Literal["relative"], ...]) -> None:
    """It interpolates along every axis from Lab; from four inks in a way of its own, which is the same at nodes."""
    profile = parsed(data)
    lab = LAB2 if profile.version[0] == "2" else LAB4
    for intent in intents:
        theirs = little_cms(SOME_LAB, (lab, data), ("lab", "cmyk"), NUMBERS[intent])
        np.testing.assert_allclose(multilinear(pcs_to_device(profile, intent), SOME_LAB), theirs, atol=5e-4)
    forward = device_to_pcs(profile, "relative")
    curve = forward.stages[0]
    assert isinstance(curve, Curves)
    (grid,) = [stage for stage in forward.stages if isinstance(stage, Grid)]
    count = grid.values.shape[0]
    which = DRAW.integers(0, count, (400, 4))
    nodes = np.stack(
        [
            np.interp(which[:, ink] / (count - 1), c, np.linspace(0.0, 1.0, len(c)))
            for ink, c in enumerate(curve.curves)
        ],
        axis=1,
    )
    np.testing.assert_allclose(forward(nodes), little_cms(nodes, (data, lab), ("cmyk", "lab"), 1), atol=0.03)


def test_four_inks_between_nodes_are_close_to_little_cms() -> None:
    data = SHIPPED.read_bytes()
    ours = device_to_pcs(parsed(data), "relative")(SOME_DEVICE)
    distance = np.abs(ours - little_cms(SOME_DEVICE, (data, LAB2), ("cmyk", "lab"), 1))
    assert distance.mean() < 0.03
    assert distance.max() < 0.3


@pytest.mark.parametrize("version", [2, 4])
def test_three_inks_are_interpolated_as_by_little_cms(version: Literal[2, 4]) -> None:
    data = small_profile(3, version, ink_names=("Cyan", "Magenta", "Yellow"))
    lab = LAB2 if version == 2 else LAB4
    inks = SOME_DEVICE[:, :3]
    theirs = little_cms(inks, (data, lab), ("cmy", "lab"), 1)
    np.testing.assert_allclose(device_to_pcs(parsed(data), "relative")(inks), theirs, atol=0.02)


@pytest.mark.parametrize("version", [2, 4])
@pytest.mark.parametrize(("inputs", "outputs", "source"), [(3, 4, "rgb"), (3, 8, "ink"), (4, 6, "ink"), (6, 4, "ink")])
def test_links_are_those_of_iccdev(
    version: Literal[2, 4], inputs: int, outputs: int, source: Literal["ink", "rgb"], tmp_path: Path
) -> None:
    iccdev = pytest.importorskip("iccdev")
    data = small_link(inputs, outputs, version, source)
    path = tmp_path / "some.icc"
    path.write_bytes(data)
    module = iccdev.IccCmm()
    module.attach(str(path), intent=iccdev.Intent.Perceptual, interp=iccdev.Interpolation.Linear)
    module.begin()
    values = DRAW.random((100, inputs))
    theirs = np.array([module.apply([float(v) for v in value]) for value in values])
    np.testing.assert_allclose(multilinear(link_table(parsed(data)), values), theirs, atol=1e-4)


RGB_WHITE = {"whitepoint": (0.3127, 0.329, 1.0), "primaries": (0.64, 0.33, 1, 0.3, 0.6, 1, 0.15, 0.06, 1), "gamma": 1.8}


@pytest.mark.parametrize(
    "data",
    [imagecodecs.cms_profile("srgb"), imagecodecs.cms_profile("adobergb"), imagecodecs.cms_profile("rgb", **RGB_WHITE)],
    ids=["srgb", "adobergb", "gamma"],
)
def test_displays_are_those_of_little_cms(data: bytes) -> None:
    profile = parsed(data)
    rgb = SOME_DEVICE[:, :3]
    forward, backward = device_to_pcs(profile, "perceptual"), pcs_to_device(profile, "relative")
    assert (forward.source, forward.target, backward.target) == ("rgb", "xyz", "rgb")
    xyz = forward(rgb)
    np.testing.assert_allclose(xyz, little_cms(rgb, (data, XYZ), ("rgb", "xyz"), 1), atol=1e-6)
    np.testing.assert_allclose(backward(xyz), rgb, atol=2e-3)  # near black a pure power rises too fast for 16 bits
    np.testing.assert_allclose(backward(xyz)[rgb.min(axis=1) > 0.02], rgb[rgb.min(axis=1) > 0.02], atol=2e-5)


def test_gray_scans() -> None:
    data = imagecodecs.cms_profile("gray", whitepoint=(0.3457, 0.3585, 1.0), gamma=2.2)
    gray = SOME_DEVICE[:, :1]
    forward = device_to_pcs(parsed(data), "relative")
    assert (forward.source, forward.target) == ("gray", "xyz")
    np.testing.assert_allclose(forward(gray), little_cms(gray, (data, XYZ), ("gray", "xyz"), 1), atol=1e-6)
    np.testing.assert_allclose(pcs_to_device(parsed(data), "relative")(forward(gray)), gray, atol=1e-3)
    in_lab = parsed(make_profile("scnr", "GRAY", "Lab ", [("kTRC", curv(0, 65535))]))
    np.testing.assert_allclose(device_to_pcs(in_lab, "relative")(np.array([0.25])), [25.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(pcs_to_device(in_lab, "relative")(np.array([25.0, 9.0, 9.0])), [0.25], atol=1e-4)


def test_gray_presses_count_ink_whatever_their_file_says() -> None:
    """Images say 1 for white, tilefab's own profiles 0: the colours of the file decide."""
    ramp = np.array([[0, 128 * 256, 128 * 256], [65280, 128 * 256, 128 * 256]])
    back = np.tile(np.array([0, 65535]).reshape(2, 1, 1, 1), (1, 2, 2, 1))
    light = [
        ("A2B0", lut_mft("mft2", THREE[np.newaxis], ramp, np.tile(THREE, (3, 1)), EYE)),
        ("B2A0", lut_mft("mft2", np.tile(THREE, (3, 1)), back, THREE[np.newaxis], EYE)),
    ]
    dark = [
        ("A2B0", lut_mft("mft2", THREE[np.newaxis], ramp[::-1], np.tile(THREE, (3, 1)), EYE)),
        ("B2A0", lut_mft("mft2", np.tile(THREE, (3, 1)), back[::-1], THREE[np.newaxis], EYE)),
    ]
    curve = [("kTRC", curv(0, 65535))]
    for tags in (light, dark, curve):
        profile = parsed(make_profile("prtr", "GRAY", "Lab ", tags))
        forward, backward = device_to_pcs(profile, "relative"), pcs_to_device(profile, "relative")
        assert (forward.source, backward.target) == ("ink", "ink")
        np.testing.assert_allclose(forward(np.array([[0.0], [1.0]]))[:, 0], [100.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(backward(np.array([[25.0, 0.0, 0.0]])), [[0.75]], atol=5e-3)


def test_8_bit_tables() -> None:
    """lut8Type has a Lab encoding of its own: 255 is L* 100, and a* and b* are 128 less than the byte."""
    grid = DRAW.integers(0, 256, (3, 3, 3, 3))
    straight = np.tile(np.arange(256), (3, 1))
    curved = np.tile(np.round(255 * (np.arange(256) / 255) ** 2).astype(int), (3, 1))
    element = lut_mft("mft1", curved, grid, straight, EYE)
    data = make_profile("mntr", "RGB ", "Lab ", [("A2B0", element)])
    table = device_to_pcs(parsed(data), "relative")
    np.testing.assert_allclose(table(np.zeros(3)), grid[0, 0, 0] * (100 / 255, 1, 1) - (0, 128, 128), atol=1e-9)
    rgb = SOME_DEVICE[:, :3]
    np.testing.assert_allclose(table(rgb), little_cms(rgb, (data, LAB2), ("rgb", "lab"), 1), atol=0.02)


def test_the_matrix_of_old_tables_is_for_xyz_alone() -> None:
    matrix = np.array([[0.9, 0.1, 0.0], [0.2, 0.7, 0.1], [0.0, 0.1, 0.8]])
    grid = DRAW.integers(0, 65536, (4, 4, 4, 3))
    curves = np.tile(np.array([0, 20000, 65535]), (3, 1))
    element = lut_mft("mft2", curves, grid, np.tile(THREE, (3, 1)), matrix)
    data = make_profile("mntr", "RGB ", "XYZ ", [("A2B0", element), ("B2A0", element)])
    xyz = SOME_DEVICE[:, :3] * (0.9, 1.0, 0.8)
    theirs = little_cms(xyz, (XYZ, data), ("xyz", "rgb"), 1)
    np.testing.assert_allclose(pcs_to_device(parsed(data), "relative")(xyz), theirs, atol=1e-4)
    assert (
        len(pcs_to_device(parsed(data), "relative").stages) == len(device_to_pcs(parsed(data), "relative").stages) + 1
    )
    plain = lut_mft("mft2", curves, grid, np.tile(THREE, (3, 1)), EYE)
    without = device_to_pcs(parsed(make_profile("mntr", "RGB ", "XYZ ", [("A2B0", plain)])), "relative")
    np.testing.assert_array_equal(device_to_pcs(parsed(data), "relative")(xyz), without(xyz))


FORMS = [
    curv(),
    curv(0, 9000, 30000, 65535),
    curv(0x0180),
    para(0, 1.7),
    para(1, 2.0, 1.1, -0.1),
    para(2, 2.0, 0.9, -0.1, 0.05),
    para(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045),
    para(4, 2.4, 0.9, 0.05, 0.5, 0.1, 0.02, 0.01),
]


@pytest.mark.parametrize("pcs", ["XYZ ", "Lab "])
@pytest.mark.parametrize("width", [1, 2])
def test_tables_of_version_4_with_every_part(pcs: str, width: int) -> None:
    grid = DRAW.integers(0, 256**width, (2, 3, 4, 3))
    mixed = fixed(0.6, 0.1, 0.1, 0.2, 0.5, 0.1, 0.0, 0.1, 0.6, 0.05, 0.1, 0.02)
    parts = {"grid": grid, "width": width, "matrix": mixed}
    for first, second, third in ((0, 1, 2), (3, 4, 5), (6, 7, 1)):
        near, middle, far = FORMS[first] * 3, FORMS[second] * 3, FORMS[third] * 3
        a2b = lut_a_b("mAB", channels=(3, 3), b=near, m=middle, a=far, **parts)
        b2a = lut_a_b("mBA", channels=(3, 3), b=near, m=middle, a=far, **parts)
        data = make_profile("mntr", "RGB ", pcs, [("A2B0", a2b), ("B2A0", b2a)], version=4)
        profile = parsed(data)
        rgb = SOME_DEVICE[:, :3]
        other, name = (XYZ, "xyz") if pcs == "XYZ " else (LAB4, "lab")
        theirs = little_cms(rgb, (data, other), ("rgb", name), 1)
        np.testing.assert_allclose(
            device_to_pcs(profile, "relative")(rgb), theirs, atol=2e-2 if name == "lab" else 2e-4
        )
        colours = SOME_LAB if name == "lab" else rgb
        theirs = little_cms(colours, (other, data), (name, "rgb"), 1)
        table = pcs_to_device(profile, "relative")
        ours = multilinear(table, colours) if name == "lab" else table(colours)
        np.testing.assert_allclose(ours, theirs, atol=2e-4)


def test_tables_without_a_grid() -> None:
    """B alone, and M, matrix, B: what displays of version 4 have."""
    matrix = fixed(0.4, 0.3, 0.1, 0.2, 0.7, 0.1, 0.0, 0.1, 0.7, 0.0, 0.0, 0.0)
    element = lut_a_b("mAB", channels=(3, 3), b=curv() * 3, m=para(0, 2.2) * 3, matrix=matrix)
    data = make_profile("mntr", "RGB ", "XYZ ", [("A2B0", element)], version=4)
    rgb = SOME_DEVICE[:, :3]
    ours = device_to_pcs(parsed(data), "relative")(rgb)
    np.testing.assert_allclose(ours, little_cms(rgb, (data, XYZ), ("rgb", "xyz"), 1), atol=1e-4)
    alone = lut_a_b("mBA", channels=(3, 3), b=curv() * 3)
    table = pcs_to_device(parsed(make_profile("spac", "Lab ", "Lab ", [("B2A0", alone)], version=4)), "relative")
    np.testing.assert_allclose(table(SOME_LAB), SOME_LAB, atol=1e-9)


def test_old_tables_in_new_profiles_keep_the_old_encoding() -> None:
    grid = np.tile(np.array([65280, 32768, 32768]), (2, 2, 2, 1))
    element = lut_mft("mft2", np.tile(THREE, (3, 1)), grid, np.tile(THREE, (3, 1)), EYE)
    data = make_profile("mntr", "RGB ", "Lab ", [("A2B0", element)], version=4)
    table = read_table(parsed(data), "A2B0")
    np.testing.assert_allclose(table(np.zeros(3)), [100.0, 0.0, 0.0], atol=1e-9)


def test_fifteen_channels() -> None:
    grid = DRAW.integers(0, 65536, (2,) * 15 + (3,))
    element = lut_a_b("mAB", channels=(15, 3), b=curv() * 3, grid=grid, a=curv() * 15)
    table = device_to_pcs(parsed(make_profile("prtr", "FCLR", "Lab ", [("A2B0", element)], version=4)), "relative")
    wanted = grid[(1,) * 15] / (655.35, 257.0, 257.0) - (0.0, 128.0, 128.0)
    np.testing.assert_allclose(table(np.ones(15)), wanted, atol=1e-6)


def test_the_right_table_is_picked() -> None:
    def flat(lightness: int) -> bytes:
        grid = np.tile(np.array([lightness * 652, 32768, 32768]), (2, 2, 2, 1))
        return lut_mft("mft2", np.tile(THREE, (3, 1)), grid, np.tile(THREE, (3, 1)), EYE)

    tags = [("A2B0", flat(10)), ("A2B1", flat(20)), ("A2B2", flat(30))]
    primaries = [(tag, b"XYZ \0\0\0\0" + fixed(*xyz)) for tag, xyz in zip(("rXYZ", "gXYZ", "bXYZ"), EYE, strict=True)]
    curves = [(tag, curv()) for tag in ("rTRC", "gTRC", "bTRC")]

    def lightness(kept: list[tuple[str, bytes]], intent: Literal["perceptual", "relative", "saturation"]) -> int:
        table = device_to_pcs(parsed(make_profile("mntr", "RGB ", "Lab ", kept)), intent)
        return round(float(table(np.zeros(3))[0]))

    assert [lightness(tags, intent) for intent in ("perceptual", "relative", "saturation", "absolute")] == [
        10,
        20,
        30,
        20,
    ]
    assert [lightness(tags[:1], intent) for intent in ("perceptual", "relative", "saturation")] == [10, 10, 10]
    display = parsed(make_profile("mntr", "RGB ", "XYZ ", primaries + curves))
    np.testing.assert_allclose(device_to_pcs(display, "relative")(np.array([0.2, 0.4, 0.6])), [0.2, 0.4, 0.6])
    with pytest.raises(ValueError, match="intent 'nice'"):
        device_to_pcs(display, "nice")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="tag 'desc'"):
        read_table(display, "desc")
    with pytest.raises(ProfileError, match="no table A2B1"):
        read_table(display, "A2B1")


def test_white_and_colours_of_the_shipped_press() -> None:
    table = device_to_pcs(read_icc_profile(SHIPPED), "relative")
    np.testing.assert_allclose(table(np.zeros(4)), [100.0, 0.0, 0.0], atol=0.01)
    srgb = device_to_pcs(parsed(imagecodecs.cms_profile("srgb")), "relative")
    np.testing.assert_allclose(lab_from_xyz(srgb(np.ones(3))), [100.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(srgb(np.ones(3)), WHITE_XYZ_D50, atol=1e-3)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (LAB4, "abstract profile, which belongs to no single device"),
        (small_link(4, 4, 2), "device link, which belongs to no single device"),
        (make_profile("nmcl", "CMYK", "Lab ", []), "named colour profile"),
        (make_profile("prtr", "CMYK", "Lab ", []), "no table A2B0, nor what could stand for it"),
        (make_profile("mntr", "RGB ", "XYZ ", [("rTRC", curv())]), "no table A2B0"),
        (make_profile("scnr", "HSV ", "XYZ ", [("A2B0", lut_a_b("mAB", channels=(3, 3), b=curv() * 3))]), "'HSV'"),
    ],
)
def test_profiles_without_a_conversion(data: bytes, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        device_to_pcs(parsed(data), "relative")


def test_a_profile_is_no_link() -> None:
    with pytest.raises(ProfileError, match="no device link"):
        link_table(parsed(small_profile(4, 2)))


GOOD_GRID = np.zeros((2, 2, 2, 2, 3), dtype=int)


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (curv(0, 1) * 4, "type 'curv' is no table"),
        (b"mft2" + bytes(12), "its head would end"),
        (lut_mft("mft2", np.zeros((4, 2), int), GOOD_GRID, np.zeros((3, 2), int), EYE)[:-1], "its table would end"),
        (lut_mft("mft2", np.zeros((4, 1), int), GOOD_GRID, np.zeros((3, 2), int), EYE), "curves of 1 entries"),
        (lut_mft("mft2", np.zeros((3, 2), int), GOOD_GRID, np.zeros((3, 2), int), EYE), "3 to 3 channels, not 4 to 3"),
        (b"mft2" + bytes(4) + b"\x04\x03\x01" + bytes(100), "a grid with 1 nodes|curves of 0 entries"),
        (b"mft1" + bytes(4) + b"\x04\x03\xff" + bytes(100), "a grid of 1.27e\\+10 values"),
        (b"mft1" + bytes(4) + b"\x04\x03\x10" + bytes(100), "its table would end"),
        (lut_a_b("mAB", channels=(4, 3)), "no grid from 4 to 3"),
        (lut_a_b("mAB", channels=(4, 3), b=curv() * 3, grid=GOOD_GRID, a=curv() * 4)[:-8], "a curve would end"),
        (lut_a_b("mAB", channels=(4, 3), b=curv() * 3, grid=GOOD_GRID, width=3 - 2)[:-60], "its grid would end"),
        (lut_a_b("mAB", channels=(4, 3), b=curv() * 3, grid=GOOD_GRID[:1]), "a grid with 1 nodes"),
        (lut_a_b("mAB", channels=(4, 3), b=para(0, -1.0) * 3, grid=GOOD_GRID), "formula has no value"),
        (lut_a_b("mAB", channels=(4, 3), b=para(0, 1.0).replace(b"para", b"pair") * 3, grid=GOOD_GRID), "unknown type"),
        (
            lut_a_b("mAB", channels=(4, 3), b=b"para" + bytes(4) + b"\0\x05" + bytes(40), grid=GOOD_GRID),
            "unknown formula",
        ),
        (lut_a_b("mAB", channels=(4, 3), b=b"curv" + bytes(4) + b"\xff" * 8, grid=GOOD_GRID), "4294967295 entries"),
    ],
)
def test_damaged_tables(element: bytes, message: str) -> None:
    profile = parsed(make_profile("prtr", "CMYK", "Lab ", [("A2B0", element)]))
    with pytest.raises(ProfileError, match=message) as caught:
        read_table(profile, "A2B0")
    assert caught.value.message.startswith("some.icc: tag 'A2B0' is damaged")


def test_damaged_displays() -> None:
    primaries = [(tag, b"XYZ \0\0\0\0" + fixed(0.3, 0.3, 0.3)) for tag in ("rXYZ", "gXYZ", "bXYZ")]
    curves = [(tag, curv()) for tag in ("rTRC", "gTRC", "bTRC")]
    flat = parsed(make_profile("mntr", "RGB ", "XYZ ", primaries + curves))
    with pytest.raises(ProfileError, match="can't be turned round"):
        pcs_to_device(flat, "relative")
    with pytest.raises(ProfileError, match="a matrix to 'Lab'"):
        device_to_pcs(parsed(make_profile("mntr", "RGB ", "Lab ", primaries + curves)), "relative")
    gray = parsed(make_profile("mntr", "GRAY", "XYZ ", [("kTRC", curv(9, 9))]))
    with pytest.raises(ProfileError, match="flat"):
        pcs_to_device(gray, "relative")
    eight = lut_mft("mft1", np.zeros((3, 256), int), np.zeros((2, 2, 2, 3), int), np.zeros((3, 256), int), EYE)
    with pytest.raises(ProfileError, match="XYZ in 8 bits"):
        read_table(parsed(make_profile("mntr", "RGB ", "XYZ ", [("A2B0", eight)])), "A2B0")


def test_curves_turned_round_follow_flat_stretches() -> None:
    """A tone curve that is 0 up to a third: just above 0 its inverse starts at a third."""
    data = make_profile("mntr", "GRAY", "XYZ ", [("kTRC", curv(0, 0, 32768, 65535))])
    table = pcs_to_device(parsed(data), "relative")
    at = np.array([0.001, 0.25, 0.5, 0.75, 1.0])
    wanted = np.interp(at, [0.0, 32768 / 65535, 1.0], [1 / 3, 2 / 3, 1.0])
    np.testing.assert_allclose(table(np.outer(at, WHITE_XYZ_D50))[:, 0], wanted, atol=1e-4)
    falling = make_profile("mntr", "GRAY", "XYZ ", [("kTRC", curv(65535, 32768, 0))])
    got = pcs_to_device(parsed(falling), "relative")(np.outer(at, WHITE_XYZ_D50))[:, 0]
    np.testing.assert_allclose(got, 1.0 - at, atol=1e-4)
