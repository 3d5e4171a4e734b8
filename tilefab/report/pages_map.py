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
    blocks += [space(6 * MM), _charts_block(texture_map)]
    return flow("Texture map", blocks)


def _images_block(texture_map: TextureMapView) -> Block:
    pictures = texture_map.pictures
    width = (WIDTH - (len(pictures) - 1) * GUTTER) / len(pictures)
    heights = [fit_size(view.image.shape[0], view.image.shape[1], width, _MOST_HEIGHT)[1] for view in pictures]

    def draw(canvas: Canvas, top: float) -> None:
        for place, view in enumerate(pictures):
            x = LEFT + place * (width + GUTTER)
            y = draw_text(canvas, view.title, x, top, width, SUBHEADING)
            draw_text(canvas, view.caption, x, y, width, MUTED, max_lines=2)
            draw_image(canvas, view.image, x, top - _PICTURE_TOP, width, _MOST_HEIGHT, centre=False)

    return Block(_PICTURE_TOP + max(heights), draw)


def _charts_block(texture_map: TextureMapView) -> Block:
    half = (WIDTH - GUTTER) / 2

    def draw(canvas: Canvas, top: float) -> None:
        for place, chart in enumerate(texture_map.charts):
            draw_histogram(
                canvas,
                chart.histogram,
                LEFT + place * (half + GUTTER),
                top,
                half,
                _PLOT_HEIGHT,
                title=chart.title,
                x_label=chart.x_label,
                y_label=chart.y_label,
                hatched=place > 0,
            )

    return Block(_PLOT_HEIGHT, draw)
