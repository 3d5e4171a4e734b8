"""Colour: how much ink the job takes, and how near the print comes to the stone."""

from __future__ import annotations

from collections.abc import Sequence

from reportlab.lib.colors import Color

from tilefab.report.charts import (
    draw_gamut_ab,
    draw_gamut_lc,
    draw_gamut_legend,
    draw_ink_bar,
    tick_labels,
    ticks,
)
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block, two_columns
from tilefab.report.style import (
    BODY,
    GREY,
    GUTTER,
    INK,
    LEFT,
    MM,
    RULE,
    SMALL,
    SMALL_MUTED,
    STRONG,
    SUBHEADING,
    WIDTH,
    Canvas,
    draw_rule,
    draw_text,
    number,
    percent,
)
from tilefab.report.view_model import ColourView, InkView, Rgb, SwatchView

_INK_ROW = 5.4 * MM
_INK_COLUMNS = (0.0, 42 * MM, 60 * MM, 78 * MM, 102 * MM)
_SWATCH_ROW = 8.4 * MM
_SWATCH_COLUMNS = (0.0, 9 * MM, 49 * MM, 87 * MM, 125 * MM, 145 * MM)
_PLOT_HEIGHT = 80 * MM


def colour_pages(colour: ColourView) -> list[Page]:
    """Make the pages on colour."""
    blocks = [section_heading("Colour"), *two_columns(_facts(colour)), space(5 * MM)]
    blocks += _ink_blocks(colour.inks)
    blocks.append(space(5 * MM))
    blocks += _swatch_blocks(colour.swatches)
    blocks.append(space(5 * MM))
    blocks.append(_gamut_block(colour))
    return flow("Colour", blocks)


def _facts(colour: ColourView) -> list[tuple[str, str]]:
    limit = "none" if colour.ink_limit_percent is None else percent(colour.ink_limit_percent)
    return [
        ("Press profile", colour.press_profile),
        ("Rendering intent", colour.intent),
        ("Mean ΔE00 to the slab", number(colour.delta_e_mean, 2)),
        ("ΔE00, 95th percentile", number(colour.delta_e_p95, 2)),
        ("Out of gamut", f"{percent(100 * colour.out_of_gamut_share)} of pixels"),
        ("Out of gamut by", f"ΔE00 {number(colour.out_of_gamut_mean)}, 95 %: {number(colour.out_of_gamut_p95)}"),
        ("Ink limit", limit),
        ("Total ink, mean", percent(colour.mean_total_ink_percent)),
        ("Total ink, maximum", percent(colour.max_total_ink_percent)),
        ("Reduced to the limit", f"{percent(100 * colour.share_limited)} of pixels"),
    ]


def _ink_blocks(inks: Sequence[InkView]) -> list[Block]:
    if not inks:
        return [_subheading("Ink use"), text_block("No inks were recorded.")]
    most = max(max(ink.max_percent, ink.mean_percent) for ink in inks)
    full = 100.0 if most <= 100 else ticks(0.0, most * 1.2, 5)[-1]
    left = LEFT + _INK_COLUMNS[4] + 3 * MM
    width = WIDTH - _INK_COLUMNS[4] - 6 * MM

    def draw_head(canvas: Canvas, top: float) -> None:
        heads = ("ink", "mean", "maximum", "m² per m²")
        _draw_head(canvas, heads, _INK_COLUMNS, top, aligns=("left", "right", "right", "right"))
        marks = ticks(0.0, full, 5)
        for value, label in zip(marks, tick_labels(marks), strict=True):
            x = left + value / full * width
            draw_text(canvas, label, x - 20, top, 40, SMALL_MUTED, align="centre")

    head = Block(SMALL.leading + 1.5 * MM, draw_head, keep=True)

    def row(ink: InkView) -> Block:
        def draw(canvas: Canvas, top: float) -> None:
            _draw_scale(canvas, full, left, top, width)
            y = top - 0.5 * (_INK_ROW - BODY.leading)
            draw_text(canvas, ink.name, LEFT, y, _INK_COLUMNS[1] - 2 * MM, BODY, shrink=0.75, middle=True)
            figures = (
                percent(ink.mean_percent, even=True),
                percent(ink.max_percent, even=True),
                number(ink.full_coverage_m2_per_m2, 4),
            )
            for place, figure in enumerate(figures, 1):
                x, room = _column(_INK_COLUMNS, place)
                draw_text(canvas, figure, x, y, room, BODY, align="right", shrink=0.6)
            draw_ink_bar(canvas, ink.mean_percent, ink.max_percent, full, left, top, width, _INK_ROW)
            draw_rule(canvas, LEFT, top - _INK_ROW, WIDTH, thickness=0.35)

        return Block(_INK_ROW, draw, head=head)

    legend = (
        "bar: mean over the map in %; line and end stroke: maximum at any pixel; "
        "m² per m²: 100 % ink for each m² of tile"
    )

    def draw_legend(canvas: Canvas, top: float) -> None:
        draw_text(canvas, legend, LEFT, top - 0.6 * MM, WIDTH, SMALL_MUTED, shrink=0.8)

    rows = [row(ink) for ink in inks]
    return [_subheading("Ink use"), head, *rows, Block(SMALL.leading + 1 * MM, draw_legend)]


def _draw_scale(canvas: Canvas, full: float, left: float, top: float, width: float) -> None:
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.35)
    for value in ticks(0.0, full, 5):
        x = left + value / full * width
        canvas.line(x, top, x, top - _INK_ROW)


def _swatch_blocks(swatches: Sequence[SwatchView]) -> list[Block]:
    if not swatches:
        return [_subheading("Main colours of the slab"), text_block("No main colours were recorded.")]

    def draw_head(canvas: Canvas, top: float) -> None:
        heads = ("", "slab | print", "slab: L*, a*, b*", "print: L*, a*, b*", "ΔE00", "share of slab")
        _draw_head(canvas, heads, _SWATCH_COLUMNS, top, aligns=("left", "left", "left", "left", "right", "right"))

    head = Block(SMALL.leading + 1.5 * MM, draw_head, keep=True)
    rows = [_swatch_row(place, swatch, head) for place, swatch in enumerate(swatches, 1)]
    return [_subheading("Main colours of the slab"), head, *rows]


def _swatch_row(place: int, swatch: SwatchView, head: Block) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        y = top - 0.5 * (_SWATCH_ROW - BODY.leading)
        draw_text(canvas, str(place), LEFT, y, 8 * MM, STRONG)
        x, room = _column(_SWATCH_COLUMNS, 1)
        patch = (room - 1 * MM) / 2
        canvas.setStrokeColor(GREY)
        canvas.setLineWidth(0.4)
        for side, colour in enumerate((swatch.rgb_slab, swatch.rgb_printed)):
            canvas.setFillColor(_colour(colour))
            canvas.rect(x + side * patch, top - _SWATCH_ROW + 1 * MM, patch, _SWATCH_ROW - 2 * MM, stroke=1, fill=1)
        for column, lab in ((2, swatch.lab_slab), (3, swatch.lab_printed)):
            x, room = _column(_SWATCH_COLUMNS, column)
            for axis, value in enumerate(lab):
                part = 11 * MM
                at = x + axis * part
                draw_text(canvas, number(value), at, y, part - 1 * MM, BODY, align="right", shrink=0.5)
        for column, figure in (
            (4, number(swatch.delta_e_2000, 2)),
            (5, percent(100 * swatch.share, even=True)),
        ):
            x, room = _column(_SWATCH_COLUMNS, column)
            draw_text(canvas, figure, x, y, room, STRONG if column == 4 else BODY, align="right", shrink=0.6)
        draw_rule(canvas, LEFT, top - _SWATCH_ROW, WIDTH, thickness=0.35)

    return Block(_SWATCH_ROW, draw, head=head)


def _gamut_block(colour: ColourView) -> Block:
    half = (WIDTH - GUTTER) / 2

    def draw(canvas: Canvas, top: float) -> None:
        draw_gamut_ab(canvas, colour, LEFT, top, half, _PLOT_HEIGHT)
        draw_gamut_lc(canvas, colour, LEFT + half + GUTTER, top, half, _PLOT_HEIGHT)
        draw_gamut_legend(canvas, LEFT, top - _PLOT_HEIGHT - 1 * MM, WIDTH)

    return Block(_PLOT_HEIGHT + 5 * MM, draw)


def _subheading(text: str) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, text, LEFT, top, WIDTH, SUBHEADING)

    return Block(SUBHEADING.leading + 1.5 * MM, draw, keep=True)


def _draw_head(
    canvas: Canvas, heads: Sequence[str], columns: Sequence[float], top: float, aligns: Sequence[str]
) -> None:
    for place, (head, align) in enumerate(zip(heads, aligns, strict=True)):
        x, room = _column(columns, place)
        draw_text(canvas, head, x, top, room, SMALL_MUTED, align=align)
    draw_rule(canvas, LEFT, top - SMALL.leading - 1.5 * MM, WIDTH, INK, 0.6)


def _column(columns: Sequence[float], place: int) -> tuple[float, float]:
    """Left edge of a table's column, and its width less the gap to the next."""
    end = columns[place + 1] - 3 * MM if place + 1 < len(columns) else WIDTH
    return LEFT + columns[place], end - columns[place]


def _colour(rgb: Rgb) -> Color:
    return Color(rgb[0] / 255, rgb[1] / 255, rgb[2] / 255)
