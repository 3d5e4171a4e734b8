"""What the report shows of a texture map, for either design."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour import reduce_srgb
from tilefab.pipeline.crop_sample import CropSample, sample_crops, shown_crops
from tilefab.pipeline.plan import Plan
from tilefab.report import ChartView, HistogramView, PictureView, TextureMapView
from tilefab.sampling import CropMap, TextureMap, TileMap, plan_region, render_plan
from tilefab.sampling.tracing import seam_mask
from tilefab.units import mm_from_px

PICTURE_PX = 900
_SHOWN_CELLS = 6
_LINE_PX = 3
_BINS = 24
_HEAT_AT_MOST = 2.5
# Never shown, shown as often as any place, shown far too often.
_HEAT = np.array([[247, 247, 240], [244, 190, 84], [178, 32, 46], [48, 8, 40]], dtype=np.float64)


def map_view(plan: Plan, texture: TextureMap, proof: TextureMap, threads: int | None = None) -> TextureMapView:
    """Pictures, facts and figures of a texture map.

    Parameters
    ----------
    plan
        The job.
    texture, proof
        Its map, and the same in fired colours.
    threads
        For measuring.
    """
    if isinstance(texture, CropMap) and isinstance(proof, CropMap):
        return _crops_view(plan, texture, proof, threads or 1)
    if isinstance(texture, TileMap) and isinstance(proof, TileMap):
        return _tile_view(texture, proof)
    raise TypeError(f"a {type(texture).__name__} is of no design that can be shown")


def fit_picture(rgb: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    """Reduce a picture by a whole number so that its longer side is at most ``side_px``."""
    return reduce_srgb(rgb, max(1, -(-max(rgb.shape[:2]) // side_px)))


def _size(texture: TextureMap) -> str:
    rows, cols = texture.cell_shape
    return f"{cols} x {rows} pixels, {mm_from_px(cols, texture.dpi):.0f} x {mm_from_px(rows, texture.dpi):.0f} mm"


def _slab_facts(texture: TextureMap) -> tuple[str, str]:
    slab_px = sum(slab.rows * slab.cols for slab in texture.slabs)
    return "Slab", f"{len(texture.slabs)} scan{'s' if len(texture.slabs) > 1 else ''}, {slab_px / 1e6:.2f} megapixels"


def _exemplar(proof: TextureMap) -> PictureView:
    image = fit_picture(np.ascontiguousarray(proof.base), PICTURE_PX)
    return PictureView("Exemplar", "the slab, with what was left out marked", image)


def _crops_view(plan: Plan, texture: CropMap, proof: CropMap, threads: int) -> TextureMapView:
    sample = sample_crops(texture, plan.seed, threads)
    crops = len(texture.crop_row)
    features = json.loads(texture.provenance.get("features", "[]"))
    dropped = crops - int(np.count_nonzero(shown_crops(texture)))
    costs = sample.joins.delta_e
    facts = (
        ("Cell", _size(texture)),
        _slab_facts(texture),
        ("Crops", f"{crops} of {texture.crop_px} pixels square" + (f", {dropped} not shown" if dropped else "")),
        ("Overlap", f"{texture.overlap_px} pixels, {mm_from_px(texture.overlap_px, texture.dpi):.0f} mm"),
        ("Joins", f"mean CIE76 {costs.mean():.1f}, 95 % below {np.percentile(costs, 95):.1f}" if costs.size else "-"),
        ("Slab used", f"{100 * sample.coverage:.0f} %, the most used place {sample.most_used:.1f} times the mean"),
        ("Features rationed", f"{len(features)}, in {int((texture.ration >= 0).sum())} crops"),
        ("Hash", texture.hash),
    )
    return TextureMapView(
        pictures=(
            _exemplar(proof),
            PictureView("Crops", "a piece of the plane, with the seams between crops", _seams(plan, proof)),
            PictureView("Use of the slab", "dark where it is shown more often than elsewhere", _heat(sample)),
        ),
        facts=facts,
        charts=(
            ChartView("Cost of the joins", "mean step along the seam, CIE76", "joins", histogram(costs)),
            ChartView(
                "Use of the slab",
                "how often a place is shown, divided by the mean",
                "places",
                histogram(sample.usage[sample.can_show]),
            ),
        ),
    )


def _seams(plan: Plan, proof: CropMap) -> NDArray[np.uint8]:
    """A piece of the plane with white lines along the seams."""
    level = 0
    while level < proof.coarsest_level and _SHOWN_CELLS * (proof.pitch_px >> level) > PICTURE_PX:
        level += 1
    side = _SHOWN_CELLS * (proof.pitch_px >> level)
    region = plan_region(proof, 0, 0, side, side, seed=plan.seed, level=level)
    picture = np.asarray(render_plan(proof, region))
    factor = max(1, -(-side // PICTURE_PX))
    line = ndimage.binary_dilation(seam_mask(proof, region), iterations=max(1, _LINE_PX * factor // 2))
    picture[line] = 255
    return fit_picture(picture, PICTURE_PX)


def _heat(sample: CropSample) -> NDArray[np.uint8]:
    place = np.clip(sample.usage / _HEAT_AT_MOST, 0, 1) * (len(_HEAT) - 1)
    colours = [np.interp(place, np.arange(len(_HEAT)), _HEAT[:, k]) for k in range(3)]
    return np.rint(np.stack(colours, axis=2)).astype(np.uint8)


def _tile_view(texture: TileMap, proof: TileMap) -> TextureMapView:
    patches = texture.patches
    area = patches.area_px
    facts = [
        ("Repeatable tile", _size(texture)),
        _slab_facts(texture),
        ("Method", texture.provenance.get("method", "unknown")),
        (
            "Seams of the tile",
            f"mean CIE76 {texture.provenance.get('tile_mean_seam_delta_e', '-')}, "
            f"worst {texture.provenance.get('tile_worst_seam_delta_e', '-')}",
        ),
        ("Patches", f"{patches.count_a} in set A, {len(patches) - patches.count_a} in set B"),
    ]
    if len(patches):
        facts += [
            ("Patch size", f"{int(area.min())} to {int(area.max())} pixels, median {int(np.median(area))}"),
            (
                "Patch seams",
                f"mean CIE76 {float(patches.mean_delta_e.mean()):.1f}, "
                f"worst of all {float(patches.worst_delta_e.max()):.1f}",
            ),
        ]
    facts.append(("Hash", texture.hash))
    return TextureMapView(
        pictures=(
            _exemplar(proof),
            PictureView(
                "Tile", "repeats without a seam; every face starts from it", fit_picture(proof.tile, PICTURE_PX)
            ),
            PictureView(
                "Patches", "outlines of the patches that faces swap", fit_picture(outlined(texture, proof), PICTURE_PX)
            ),
        ),
        facts=tuple(facts),
        charts=(
            ChartView(
                "Cost of the patches' seams",
                "worst step, CIE76",
                "patches",
                histogram(patches.worst_delta_e.astype(np.float64)),
            ),
            ChartView(
                "Size of the patches",
                "side of an equal square, pixels",
                "patches",
                histogram(np.sqrt(area.astype(np.float64))),
            ),
        ),
    )


def outlined(texture: TileMap, proof: TileMap) -> NDArray[np.uint8]:
    """Draw the outlines of the patches on a paled tile: white for set A, black for B."""
    rows, cols = texture.tile_shape
    picture: NDArray[np.uint8] = (proof.tile // 2 + 64).astype(np.uint8)
    for index in range(len(texture.patches)):
        mask = np.pad(texture.patches.mask(index), 1)
        edge = np.argwhere(mask & ~ndimage.binary_erosion(mask)) - 1
        at_row = (edge[:, 0] + int(texture.patches.cell_row[index])) % rows
        at_col = (edge[:, 1] + int(texture.patches.cell_col[index])) % cols
        picture[at_row, at_col] = 255 if index < texture.patches.count_a else 0
    return picture


def histogram(values: NDArray[np.float64]) -> HistogramView:
    """Histogram of some values; empty of none."""
    if values.size == 0:
        return HistogramView(np.zeros(0), np.zeros(0))
    counts, edges = np.histogram(values, bins=_BINS)
    return HistogramView(edges, counts)
