"""The gamut, and how colour and measurements agree."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tilefab.report.charts import draw_grid, draw_histogram
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.profile_charts import (
    chart_axes,
    draw_curves,
    draw_level_key,
    draw_levels,
    draw_line_legend,
    draw_no_data,
    draw_picture,
    draw_plane,
    draw_strip,
    draw_title,
    fill_colour,
    line_colour,
)
from tilefab.report.profile_pages_summary import column, lab_text, subheading
from tilefab.report.profile_view import BiasView, GamutView, MatchView, PatchView, ProfileCheckView, SolidView
from tilefab.report.style import (
    BODY,
    GREY,
    GUTTER,
    INK,
    LEFT,
    MM,
    SMALL,
    SMALL_MUTED,
    STRONG,
    WIDTH,
    Canvas,
    draw_rule,
    draw_text,
    number,
    percent,
)

GAMUT = "Gamut"
TONE = "Tone and measurements"
_HALF = (WIDTH - GUTTER) / 2
_THIRD = (WIDTH - 2 * GUTTER) / 3
_PLANE_HEIGHT = 66 * MM
_TONE_HEIGHT = 58 * MM
_HISTOGRAM_HEIGHT = 46 * MM
_MOST_POINTS = 1500
_STRIP = 3.6 * MM
_STRIP_NAME = 26 * MM
_PATCH_ROW = 6.0 * MM
_PATCH_COLUMNS = (0.0, 16 * MM, 38 * MM, 98 * MM, 128 * MM, 158 * MM)
_BIAS_ROW = 4.8 * MM
_BIAS_COLUMNS = (0.0, 22 * MM, 34 * MM, 46 * MM, 58 * MM, 70 * MM)


def gamut_pages(view: ProfileCheckView) -> list[Page]:
    """Make the page on the gamut."""
    gamut = view.gamut
    note = (
        "Relative colours. Lines: what the inks can mix within the profile's limits. Coloured areas: what also goes "
        f"through the relative tables to inks and comes back within 1 (ΔE*ab). Points: {gamut.sample_name}."
    )
    blocks = [section_heading("Gamut", note)]
    blocks += [_levels_block(gamut), space(2 * MM)]
    for place in range(0, len(gamut.hue_planes), 2):
        blocks.append(_planes_block(gamut, place))
    return flow(GAMUT, blocks)


def _levels_block(gamut: GamutView) -> Block:
    height = _HALF + 5 * MM
    half = (height - 3 * MM) / 2

    def draw(canvas: Canvas, top: float) -> None:
        draw_levels(canvas, gamut.levels, gamut.sample, LEFT, top, _HALF, _MOST_POINTS)
        draw_text(canvas, "L*", LEFT, top - _HALF - 1 * MM, 10 * MM, SMALL)
        draw_level_key(canvas, gamut.levels, LEFT + 11 * MM, top - _HALF - 1 * MM, _HALF - 13 * MM)
        for place, solid in enumerate(gamut.solids):
            _draw_solid(canvas, solid, LEFT + _HALF + GUTTER, top - place * (half + 3 * MM), _HALF, half)

    return Block(height, draw)


def _draw_solid(canvas: Canvas, solid: SolidView, x: float, top: float, width: float, height: float) -> None:
    draw_title(canvas, f"The solid {solid.title}", x, top, width)
    side = min(width, height - 5 * MM)
    if solid.picture is None:
        draw_no_data(canvas, x, top - 5 * MM, side, side, "no volume")
    else:
        draw_picture(canvas, solid.picture, x + (width - side) / 2, top - 5 * MM - side, side, side)


def _planes_block(gamut: GamutView, place: int) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        for offset, plane in enumerate(gamut.hue_planes[place : place + 2]):
            draw_plane(canvas, plane, LEFT + offset * (_HALF + GUTTER), top, _HALF, _PLANE_HEIGHT)

    return Block(_PLANE_HEIGHT + 1 * MM, draw)


def tone_pages(view: ProfileCheckView) -> list[Page]:
    """Make the page on single inks, and on the agreement with measurements."""
    blocks = [section_heading("Tone and measurements"), _tone_block(view), *_strip_blocks(view), space(4 * MM)]
    if view.match is None:
        blocks.append(text_block("There are no measurements to compare with; give them with --data."))
    else:
        blocks += [_match_block(view.match), space(3 * MM), *_patch_blocks(view.match.worst)]
    return flow(TONE, blocks)


def _tone_block(view: ProfileCheckView) -> Block:
    tone = view.tone
    x = 100.0 * tone.ink_frac
    chroma = np.hypot(tone.lab[..., 1], tone.lab[..., 2])
    charts = (
        ("Lightness of each ink", "L*", tone.lab[..., 0]),
        ("Chroma", "C*", chroma),
        ("Difference to the bare medium", "ΔE00", tone.to_white),
    )
    colours = [line_colour(rgb) for rgb in view.ink_rgb]

    def draw(canvas: Canvas, top: float) -> None:
        for place, (title, label, curves) in enumerate(charts):
            left = LEFT + place * (_THIRD + GUTTER)
            draw_title(canvas, title, left, top, _THIRD)
            high = 100.0 if place == 0 else max(10.0, 10.0 * math.ceil(float(curves.max()) / 10.0))
            low = min(0.0, 10.0 * math.floor(float(curves.min()) / 10.0))
            high = max(high, float(curves.max()))
            axes = chart_axes(left, top, _THIRD, _TONE_HEIGHT, (0.0, 100.0), (low, high))
            draw_grid(canvas, axes, "ink, %", label, x_most=5)
            draw_curves(canvas, axes, x, list(curves), colours)
        draw_line_legend(canvas, view.facts.ink_names, colours, LEFT, top - _TONE_HEIGHT - 1 * MM, WIDTH)

    return Block(_TONE_HEIGHT + 6 * MM, draw)


def _strip_blocks(view: ProfileCheckView) -> list[Block]:
    def strip(name: str, place: int) -> Block:
        def draw(canvas: Canvas, top: float) -> None:
            y = top - 0.5 * (_STRIP - BODY.leading)
            draw_text(canvas, name, LEFT, y, _STRIP_NAME - 2 * MM, BODY, shrink=0.75)
            draw_strip(canvas, view.tone.rgb[place], LEFT + _STRIP_NAME, top, WIDTH - _STRIP_NAME, _STRIP)

        return Block(_STRIP + 0.7 * MM, draw)

    return [strip(name, place) for place, name in enumerate(view.facts.ink_names)]


def _match_block(match: MatchView) -> Block:
    height = max(_HISTOGRAM_HEIGHT, (len(match.biases) + 1) * _BIAS_ROW + 10 * MM)

    def draw(canvas: Canvas, top: float) -> None:
        draw_histogram(
            canvas,
            match.histogram,
            LEFT,
            top,
            _HALF,
            _HISTOGRAM_HEIGHT,
            title="Differences to the measurements",
            x_label="ΔE00 (the last bar holds all beyond)",
            y_label="patches",
            hatched=False,
        )
        _draw_biases(canvas, match.biases, LEFT + _HALF + GUTTER, top)

    return Block(height, draw)


def _draw_biases(canvas: Canvas, biases: Sequence[BiasView], x: float, top: float) -> None:
    draw_title(canvas, "Bias: predicted less measured, by the largest ink", x, top, _HALF)
    y = top - 5.5 * MM
    heads = ("", "patches", "ΔL*", "Δa*", "Δb*", "ΔE00")
    ends = [*_BIAS_COLUMNS[1:], _HALF]
    for place, head in enumerate(heads):
        room = ends[place] - _BIAS_COLUMNS[place] - 1 * MM
        draw_text(canvas, head, x + _BIAS_COLUMNS[place], y, room, SMALL_MUTED, align="left" if place == 0 else "right")
    y -= SMALL.leading + 1 * MM
    draw_rule(canvas, x, y, _HALF, INK, 0.6)
    for bias in biases:
        row = y - 0.5 * (_BIAS_ROW - BODY.leading)
        draw_text(canvas, bias.ink, x, row, _BIAS_COLUMNS[1] - 1 * MM, BODY, shrink=0.75)
        figures = ["0", "–", "–", "–", "–"]
        if bias.patches:
            figures = [str(bias.patches), *(number(v, 2) for v in bias.lab), number(bias.delta_e_mean, 2)]
        for place, figure in enumerate(figures, 1):
            room = ends[place] - _BIAS_COLUMNS[place] - 1 * MM
            draw_text(canvas, figure, x + _BIAS_COLUMNS[place], row, room, BODY, align="right", shrink=0.6)
        y -= _BIAS_ROW
        draw_rule(canvas, x, y, _HALF, thickness=0.35)


def _patch_blocks(patches: Sequence[PatchView]) -> list[Block]:
    def draw_head(canvas: Canvas, top: float) -> None:
        heads = ("patch", "meas. | pred.", "inks, %", "measured L* a* b*", "predicted L* a* b*", "ΔE00")
        for place, head in enumerate(heads):
            x, room = column(_PATCH_COLUMNS, place)
            draw_text(canvas, head, x, top, room, SMALL_MUTED, align="right" if place == 5 else "left", shrink=0.8)
        draw_rule(canvas, LEFT, top - SMALL.leading - 1 * MM, WIDTH, INK, 0.6)

    head = Block(SMALL.leading + 1.2 * MM, draw_head, keep=True)
    return [subheading("Patches that differ most"), head, *(_patch_row(patch, head) for patch in patches)]


def _patch_row(patch: PatchView, head: Block) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        y = top - 0.5 * (_PATCH_ROW - BODY.leading)
        draw_text(canvas, patch.sample, LEFT, y, _PATCH_COLUMNS[1] - 3 * MM, STRONG, shrink=0.6, middle=True)
        x, room = column(_PATCH_COLUMNS, 1)
        side = room / 2
        canvas.setStrokeColor(GREY)
        canvas.setLineWidth(0.4)
        for place, colour in enumerate((patch.rgb_measured, patch.rgb_predicted)):
            canvas.setFillColor(fill_colour(colour))
            canvas.rect(x + place * side, top - _PATCH_ROW + 0.7 * MM, side, _PATCH_ROW - 1.4 * MM, stroke=0, fill=1)
        canvas.rect(x, top - _PATCH_ROW + 0.7 * MM, room, _PATCH_ROW - 1.4 * MM, stroke=1, fill=0)
        inks = "  ".join(percent(value).removesuffix(" %") for value in patch.ink_percent)
        texts = ((2, inks), (3, lab_text(patch.lab_measured)), (4, lab_text(patch.lab_predicted)))
        for place, text in texts:
            x, room = column(_PATCH_COLUMNS, place)
            draw_text(canvas, text, x, y, room, BODY, shrink=0.6)
        x, room = column(_PATCH_COLUMNS, 5)
        draw_text(canvas, number(patch.delta_e_2000, 2), x, y, room, STRONG, align="right")
        draw_rule(canvas, LEFT, top - _PATCH_ROW, WIDTH, thickness=0.35)

    return Block(_PATCH_ROW, draw, head=head)
