"""Charts on tiles: everything has its place, within limits, apart, and is drawn there."""

from __future__ import annotations

import numpy as np
import pytest

from tilefab.chart import ChartLayout, design_chart, lay_out_chart, render_tile
from tilefab.chart.layout import mark_recipe
from tilefab.types import SizeMm


def make(patches: int = 400, inks: int = 4, **options: object) -> ChartLayout:
    design = design_chart(
        inks, patches, total_limit_percent=min(280.0, 100.0 * inks), black_channel=3 if inks > 3 else None, seed=2
    )
    settings = {"tile_mm": SizeMm(150.0, 120.0), "dpi": 120.0, "patch_mm": 6.0, "seed": 3, **options}
    return lay_out_chart(design, **settings)


def test_every_patch_has_a_place_of_its_own_on_tiles_about_equally_full() -> None:
    layout = make()
    assert layout.tiles == 2
    assert len(np.unique(layout.places, axis=0)) == 400
    cells = {tuple(cell) for cell in layout.cells().tolist()}
    assert {tuple(place) for place in layout.places[:, 1:].tolist()} <= cells
    on_tiles = [len(layout.on_tile(tile)) for tile in range(layout.tiles)]
    assert max(on_tiles) - min(on_tiles) <= 1


def test_it_is_shuffled_and_repeatable() -> None:
    layout, again, other = make(), make(), make(seed=4)
    np.testing.assert_array_equal(layout.places, again.places)
    assert (layout.places != other.places).any()
    # Neighbours in the grid are not neighbours in the list.
    first = layout.on_tile(0)
    order = first[np.lexsort((layout.places[first, 2], layout.places[first, 1]))]
    assert np.abs(np.diff(order)).mean() > 60


def test_repeats_are_on_different_tiles_and_whites_on_all() -> None:
    layout = make()
    _, group, counts = np.unique(layout.ink_counts, axis=0, return_inverse=True, return_counts=True)
    for number in np.flatnonzero(counts > 1):
        tiles = layout.places[np.flatnonzero(group.reshape(-1) == number), 0]
        assert np.ptp(np.bincount(tiles, minlength=2)) <= 1


def test_repeats_on_one_tile_lie_apart() -> None:
    layout = make(100, tile_mm=SizeMm(150.0, 150.0))
    assert layout.tiles == 1
    _, group, counts = np.unique(layout.ink_counts, axis=0, return_inverse=True, return_counts=True)
    for number in np.flatnonzero(counts > 1):
        places = layout.places[np.flatnonzero(group.reshape(-1) == number), 1:]
        apart = np.linalg.norm(places[:, np.newaxis] - places[np.newaxis], axis=2)
        assert apart[~np.eye(len(apart), dtype=bool)].min() >= 3.0


@pytest.mark.parametrize("labels", [True, False])
def test_a_tile_is_drawn_where_the_layout_says(labels: bool) -> None:
    layout = make(labels=labels)
    image = render_tile(layout, 1)
    assert image.shape == (567, 709, 4)
    assert image.dtype == np.uint8
    bare = np.ones(image.shape[:2], dtype=bool)
    for patch in layout.on_tile(1):
        top, left = layout.cell_corner(*(int(v) for v in layout.places[patch, 1:]))
        square = np.s_[top : top + layout.patch_px, left : left + layout.patch_px]
        assert (image[square] == layout.ink_counts[patch]).all()
        assert bare[square].all()
        bare[square] = False
    for corner in range(4):
        top, left = layout.mark_corner(corner)
        mark = image[top : top + layout.mark_px, left : left + layout.mark_px]
        assert (mark[0] == layout.mark_counts).all()
        assert (mark[:, -1] == layout.mark_counts).all()
        clear = layout.module_px
        around = bare[top - clear : top + layout.mark_px + clear, left - clear : left + layout.mark_px + clear]
        assert around.all()
        ring = image[top - clear : top, left - clear : left + layout.mark_px + clear]
        assert not ring.any()
        bare[top : top + layout.mark_px, left : left + layout.mark_px] = False
    inked = image[bare]
    assert inked.any() == labels
    assert ((inked == 0).all(axis=1) | (inked == layout.mark_counts).all(axis=1)).all()
    margin = layout.margin_px
    assert not image[:margin].any()
    assert not image[:, -margin:].any()


def test_sixteen_bits_print_the_same_amounts() -> None:
    layout = make(100)
    np.testing.assert_array_equal(render_tile(layout, 0, bits=16), render_tile(layout, 0).astype(np.uint16) * 257)


def test_marks_are_dark_and_within_the_limits() -> None:
    full = np.array([255, 255, 255, 255], dtype=np.uint8)
    assert mark_recipe(4, full, 300.0, 3).tolist() == [119, 119, 119, 255]
    assert mark_recipe(4, full, 100.0, 3).tolist() == [0, 0, 0, 255]
    assert mark_recipe(3, full[:3], 150.0, None).tolist() == [127, 127, 127]
    assert mark_recipe(1, full[:1], 100.0, None).tolist() == [255]
    assert mark_recipe(2, np.array([255, 100], dtype=np.uint8), 200.0, 0).tolist() == [255, 100]


def test_locations_are_what_is_printed_beside_the_patches() -> None:
    layout = make()
    assert len({layout.location(patch) for patch in range(400)}) == 400
    tile, row, col = (int(value) for value in layout.places[7])
    assert layout.location(7) == f"{tile + 1}-{chr(65 + row)}{col + 1}"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"patch_mm": 1.0}, "needs 12"),
        ({"gap_mm": 0.01}, "would touch"),
        ({"tile_mm": SizeMm(25.0, 25.0)}, "holds no patch"),
        ({"patch_mm": 200.0}, "holds no patch"),
        ({"patches": 3000, "tile_mm": SizeMm(60.0, 60.0)}, "128 are the most"),
    ],
)
def test_what_can_t_be_laid_out(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**options)


def test_no_such_tile() -> None:
    layout = make(100)
    with pytest.raises(ValueError):
        render_tile(layout, layout.tiles)
    with pytest.raises(ValueError):
        render_tile(layout, 0, bits=12)
