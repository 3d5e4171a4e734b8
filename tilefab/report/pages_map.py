"""The texture map: what it was made from, how it is cut, and how well its seams hide."""

from __future__ import annotations

from tilefab.report.charts import draw_histogram
from tilefab.report.figures import draw_image, fit_size
from tilefab.report.layout import Block, Page, flow, section_heading, space, two_columns
from tilefab.report.style import GUTTER, LEFT, MM, MUTED, SUBHEADING, WIDTH, Canvas, draw_text
from tilefab.report.view_model import TextureMapView

_MOST_HEIGHT = 96 * MM
_PLOT_HEIGHT = 58 * MM
_PICTURE_TOP = SUBHEADING.leading + 2 * MUTED.leading + 1.5 * MM


def map_pages(texture_map: TextureMapView) -> list[Page]:
    """Make the pages on the texture map."""
    blocks = [section_heading("Texture map"), _images_block(texture_map), space(5 * MM)]
    blocks += two_columns(texture_map.facts)
    blocks += [space(6 * MM), _histograms_block(texture_map)]
    return flow("Texture map", blocks)


def _images_block(texture_map: TextureMapView) -> Block:
    pictures = (
        (texture_map.exemplar, "Exemplar", "the slab, with what was left out marked"),
        (texture_map.tile, "Tile", "repeats without a seam; every face starts from it"),
        (texture_map.patch_outlines, "Patches", "outlines of the patches that faces swap"),
    )
    width = (WIDTH - 2 * GUTTER) / 3
    heights = [fit_size(image.shape[0], image.shape[1], width, _MOST_HEIGHT)[1] for image, _, _ in pictures]

    def draw(canvas: Canvas, top: float) -> None:
        for place, (image, name, note) in enumerate(pictures):
            x = LEFT + place * (width + GUTTER)
            y = draw_text(canvas, name, x, top, width, SUBHEADING)
            draw_text(canvas, note, x, y, width, MUTED, max_lines=2)
            draw_image(canvas, image, x, top - _PICTURE_TOP, width, _MOST_HEIGHT, centre=False)

    return Block(_PICTURE_TOP + max(heights), draw)


def _histograms_block(texture_map: TextureMapView) -> Block:
    half = (WIDTH - GUTTER) / 2

    def draw(canvas: Canvas, top: float) -> None:
        draw_histogram(
            canvas,
            texture_map.patch_cost,
            LEFT,
            top,
            half,
            _PLOT_HEIGHT,
            title="Cost of the patches' seams",
            x_label="worst step, CIE76",
            y_label="patches",
            hatched=False,
        )
        draw_histogram(
            canvas,
            texture_map.patch_size,
            LEFT + half + GUTTER,
            top,
            half,
            _PLOT_HEIGHT,
            title="Size of the patches",
            x_label="side of an equal square, pixels",
            y_label="patches",
            hatched=True,
        )

    return Block(_PLOT_HEIGHT, draw)
