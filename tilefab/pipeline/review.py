"""What `tilefab map review` shows: every crop or patch with its costs, and the joins that went worst."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import reduce_srgb, srgb_from_xyz, xyz_from_lab
from tilefab.colour.encoding import decode_lab16
from tilefab.errors import OutputError
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.faces import write_preview
from tilefab.pipeline.crop_sample import CropSample, sample_crops, shown_crops
from tilefab.pipeline.map_view import fit_picture, outlined
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.report.review import ReviewCard, ReviewSection, ReviewView, review_html, review_picture
from tilefab.sampling import CropMap, TextureMap, TileMap, plan_region, render_plan
from tilefab.sampling.tracing import seam_mask
from tilefab.types import Array

STAGE = "Drawing the sheet"
HTML_SUFFIXES = (".html", ".htm")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
_THUMBNAIL_PX = 72
_MOST_THUMBNAIL_PX = 120
_TILE_PX = 700
_JOIN_PX = 200
_JOIN_CELLS = 1.5
_WORST_JOINS = 24
_SAMPLED_CELLS = 44
_SHEET_DPI = 96
_PALE = 190


def check_sheet_path(path: Path) -> None:
    """Refuse a sheet's path whose suffix names no format, before the work of drawing it.

    Raises
    ------
    OutputError
        If it is neither HTML nor a picture.
    """
    if path.suffix.lower() not in HTML_SUFFIXES + PICTURE_SUFFIXES:
        raise OutputError(
            f"{path}: unknown format {path.suffix or '(no ending)'}; use .html, or .png for a picture", path=str(path)
        )


def write_review(plan: Plan, texture: TextureMap, path: Path, progress: Progress, threads: int | None = None) -> None:
    """Write the sheet of a job's texture map: HTML, or a picture if ``path`` ends in .png or .jpg.

    Raises
    ------
    OutputError
        If the ending is unknown or the file can't be written.
    """
    check_sheet_path(path)
    progress.stage(STAGE, 0.0)
    view = review_view(plan, texture, threads or 1)
    progress.stage(STAGE, 0.7)
    if path.suffix.lower() in HTML_SUFFIXES:
        atomic_write_bytes(path, review_html(view).encode())
    else:
        write_preview(path, review_picture(view), _SHEET_DPI)
    progress.stage(STAGE, 1.0)


def review_view(plan: Plan, texture: TextureMap, threads: int = 1) -> ReviewView:
    """Everything on the sheet of a texture map, in the stone's own colours."""
    if isinstance(texture, CropMap):
        return _crops_view(plan, texture, threads)
    if isinstance(texture, TileMap):
        return _tile_view(plan, texture)
    raise TypeError(f"a {type(texture).__name__} is of no design that can be shown")


def stone_srgb(lab16: Array) -> NDArray[np.uint8]:
    """Stored colours of the stone for the screen, (rows, cols, 3)."""
    rgb = srgb_from_xyz(xyz_from_lab(decode_lab16(np.ascontiguousarray(lab16))))
    picture: NDArray[np.uint8] = np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)
    return picture


def _crops_view(plan: Plan, texture: CropMap, threads: int) -> ReviewView:
    sample = sample_crops(texture, plan.seed, threads, _SAMPLED_CELLS)
    crops = len(texture.crop_row)
    cost, shown = sample.join_costs(crops), shown_crops(texture)
    level = 0
    while texture.crop_px >> (level + 1) >= _THUMBNAIL_PX:
        level += 1
    small = stone_srgb(texture.base_level(level))
    cards = []
    for crop in sorted(range(crops), key=lambda k: (-np.nan_to_num(cost[k], nan=-1.0), k)):
        top, left, side = (int(n) >> level for n in (texture.crop_row[crop], texture.crop_col[crop], texture.crop_px))
        notes = [
            f"crop {crop}",
            f"{sample.uses[crop]} uses",
            "joins -" if np.isnan(cost[crop]) else f"joins {cost[crop]:.1f}",
        ]
        if texture.ration[crop] >= 0:
            notes.append("takes turns")
        if not shown[crop]:
            notes.append("dropped")
        image = _thumbnail(small[top : top + side, left : left + side])
        cards.append(ReviewCard(image, tuple(notes), crop))
    joins = sample.joins
    worst = np.argsort(-joins.delta_e, kind="stable")[:_WORST_JOINS]
    return ReviewView(
        title=f"{plan.name}: {crops} crops",
        text="Faces are put together from these crops of the slab. Costs are CIE76 colour steps along the seams, 0 for "
        "none to be seen, measured on a piece of the plane. To be rid of a crop, write its number into the job file, "
        "in [texture]: drop = [12, 40]. To use nothing but some, write keep = [1, 2, 3]. Then run `tilefab map build` "
        "again: it takes seconds, and the numbers stay.",
        sections=(
            ReviewSection(
                "Worst joins",
                f"The {len(worst)} dearest of {len(joins.delta_e)} joins: as it is printed, and with its seams.",
                tuple(_join_card(plan, texture, sample, int(k)) for k in worst),
            ),
            ReviewSection(
                "Crops",
                "All of them, those that join worst first. Uses are counted on a larger piece of the plane, "
                f"{int(sample.uses.sum())} cells.",
                tuple(cards),
            ),
        ),
        choosable=True,
    )


def _join_card(plan: Plan, texture: CropMap, sample: CropSample, k: int) -> ReviewCard:
    joins = sample.joins
    level = 0
    while level < texture.coarsest_level and _JOIN_CELLS * (texture.pitch_px >> (level + 1)) >= _JOIN_PX:
        level += 1
    pitch = texture.pitch_px >> level
    side = max(int(_JOIN_CELLS * pitch), 1)
    row, col = int(joins.row[k]) * pitch, int(joins.col[k]) * pitch
    if joins.below[k]:
        col += pitch // 2
    else:
        row += pitch // 2
    region = plan_region(texture, row - side // 2, col - side // 2, side, side, seed=plan.seed, level=level)
    picture = stone_srgb(render_plan(texture, region))
    lined = picture.copy()
    lined[seam_mask(texture, region)] = 255
    factor = max(1, side // _JOIN_PX)
    pair = [_enlarged(reduce_srgb(part, factor), _JOIN_PX) for part in (picture, lined)]
    image = np.concatenate(pair, axis=1)
    first, second = int(joins.first[k]), int(joins.second[k])
    where = "above" if joins.below[k] else "left of"
    return ReviewCard(image, (f"cost {joins.delta_e[k]:.1f}", f"crop {first} {where} crop {second}"))


def _thumbnail(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return _enlarged(fit_picture(rgb, _MOST_THUMBNAIL_PX), _THUMBNAIL_PX)


def _enlarged(rgb: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    """Enlarge a picture by a whole number as long as its longer side stays within ``side_px``."""
    factor = max(1, side_px // max(rgb.shape[:2]))
    return rgb.repeat(factor, axis=0).repeat(factor, axis=1)


def _tile_view(plan: Plan, texture: TileMap) -> ReviewView:
    patches = texture.patches
    shown = texture.with_base(stone_srgb(texture.base), "srgb8", ("R", "G", "B"))
    cards = []
    for k in np.argsort(-patches.worst_delta_e, kind="stable").tolist():
        top, left = int(patches.base_row[k]), int(patches.base_col[k])
        mask = patches.mask(k)
        picture = shown.base[top : top + mask.shape[0], left : left + mask.shape[1]].copy()
        picture[~mask] = picture[~mask] // 4 + _PALE
        image = _thumbnail(picture)
        lines = (
            f"patch {k}, set {'A' if k < patches.count_a else 'B'}",
            f"worst step {patches.worst_delta_e[k]:.1f}",
            f"mean {patches.mean_delta_e[k]:.1f}",
        )
        cards.append(ReviewCard(image, lines))
    tile = (
        ReviewCard(fit_picture(np.asarray(shown.tile), _TILE_PX), ("the tile",)),
        ReviewCard(fit_picture(outlined(texture, shown), _TILE_PX), ("outlines of the patches",)),
    )
    worst, mean = (texture.provenance.get(f"tile_{name}_seam_delta_e", "-") for name in ("worst", "mean"))
    return ReviewView(
        title=f"{plan.name}: a tile and {len(patches)} patches",
        text="Faces are cut from this repeating tile with some of the patches laid over it. Costs are CIE76 colour "
        "steps along the cuts, 0 for none to be seen. Fewer patches in the job file keep the cheapest; another seed "
        "cuts others.",
        sections=(
            ReviewSection("Tile", f"Its own seams: worst step {worst}, mean {mean}.", tile),
            ReviewSection("Patches", "The dearest first; what a patch leaves out is paled.", tuple(cards)),
        ),
        choosable=False,
    )
