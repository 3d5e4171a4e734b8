"""How the profile separates: neutrals, hues, and smooth fields in which bands would show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tilefab.report.charts import draw_grid
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.profile_charts import (
    chart_axes,
    draw_curves,
    draw_falling_grid,
    draw_line_legend,
    draw_picture,
    draw_strip,
    draw_title,
    lightness_axes,
    line_colour,
)
from tilefab.report.profile_view import FieldView, ProfileCheckView, RampView
from tilefab.report.style import (
    GREY,
    GUTTER,
    INK,
    LEFT,
    MM,
    RULE,
    SMALL_MUTED,
    WIDTH,
    Canvas,
    draw_text,
)

SEPARATION = "Separation"
SMOOTHNESS = "Ramps to look at"
_LEFT_WIDTH = 0.60 * WIDTH
_RIGHT_WIDTH = WIDTH - _LEFT_WIDTH - GUTTER
_NEUTRAL_HEIGHT = 64 * MM
_HUE_HEIGHT = 46 * MM
_HALF = (WIDTH - GUTTER) / 2
_STRIP = 4.2 * MM
_FIELD_HEIGHT = 38 * MM
_RAMP_HEIGHT = 7 * MM
_PRINTED_NOTE = "upper half: as wanted; lower half: as printed"


def ramp_pages(view: ProfileCheckView) -> list[Page]:
    """Make the pages on neutrals and hues, and the one with ramps to look at."""
    if not view.neutrals:
        text = "The profile has no table from colour to inks: there is no separation to show."
        return flow(SEPARATION, [section_heading(SEPARATION), text_block(text)])
    return [*_separation(view), *_fields(view)]


def _separation(view: ProfileCheckView) -> list[Page]:
    colours = [line_colour(rgb) for rgb in view.ink_rgb]
    same = f" The same tables serve {' and '.join(view.facts.same_tables)}." if view.facts.same_tables else ""
    note = f"Inks along neutral colours from white to black, and what is printed. Strips: {_PRINTED_NOTE}.{same}"
    blocks = [section_heading(SEPARATION, note), _legend(view)]
    blocks += [_neutral_block(ramp, colours) for ramp in view.neutrals]
    note = "Relative intent, from white to the strongest colour of a hue and on to black, at even steps of ΔE*ab"
    rows = [_hue_block(view.hues[place : place + 2], colours) for place in range(0, len(view.hues), 2)]
    blocks += [space(1 * MM), text_block(note), *(replace(row, head=_legend(view)) for row in rows)]
    return flow(SEPARATION, blocks)


def _legend(view: ProfileCheckView) -> Block:
    colours = [line_colour(rgb) for rgb in view.ink_rgb]

    def draw(canvas: Canvas, top: float) -> None:
        draw_line_legend(canvas, view.facts.ink_names, colours, LEFT, top, WIDTH)

    return Block(6 * MM, draw, keep=True)


def _draw_pair(canvas: Canvas, ramp: RampView, x: float, top: float, width: float) -> None:
    """Draw wanted colours over printed ones, with no line between."""
    half = _STRIP / 2
    draw_strip(canvas, ramp.rgb_wanted, x, top, width, half, frame=False)
    draw_strip(canvas, ramp.rgb_printed, x, top - half, width, half, frame=False)
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.4)
    canvas.rect(x, top - _STRIP, width, _STRIP, stroke=1, fill=0)


def _neutral_block(ramp: RampView, colours: Sequence[object]) -> Block:
    lightness = ramp.wanted[:, 0]
    off = np.abs(ramp.printed[:, 1:]).max()
    reach = max(2.0, 2.0 * math.ceil(float(min(off, 40.0)) / 2.0))

    def draw(canvas: Canvas, top: float) -> None:
        draw_title(canvas, f"Neutrals, {ramp.title} intent: inks in %", LEFT, top, _LEFT_WIDTH)
        axes = lightness_axes(LEFT, top, _LEFT_WIDTH, _NEUTRAL_HEIGHT, (0.0, 100.0))
        draw_falling_grid(canvas, axes, "", "ink, %")
        draw_curves(canvas, axes, lightness, list(ramp.ink_percent.T), colours)
        _draw_pair(canvas, ramp, axes.x, axes.bottom - 4.2 * MM, axes.width)
        draw_text(canvas, "L*", LEFT, axes.bottom - 2, 8 * MM, SMALL_MUTED)
        right = LEFT + _LEFT_WIDTH + GUTTER
        draw_title(canvas, "Printed a* (full) and b* (dashed)", right, top, _RIGHT_WIDTH)
        axes = lightness_axes(right, top, _RIGHT_WIDTH, _NEUTRAL_HEIGHT, (-reach, reach))
        draw_falling_grid(canvas, axes, "L* wanted", "a*, b*")
        draw_curves(canvas, axes, lightness, [ramp.printed[:, 1], ramp.printed[:, 2]], [INK, GREY])

    return Block(_NEUTRAL_HEIGHT + 4 * MM, draw)


def _hue_block(ramps: Sequence[RampView], colours: Sequence[object]) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        for place, ramp in enumerate(ramps):
            left = LEFT + place * (_HALF + GUTTER)
            chroma = np.hypot(ramp.wanted[:, 1], ramp.wanted[:, 2])
            peak = int(chroma.argmax())
            hue = math.degrees(math.atan2(ramp.wanted[peak, 2], ramp.wanted[peak, 1])) % 360.0
            title = f"{ramp.title[:1].upper()}{ramp.title[1:]}: hue {hue:.0f}°, C* {chroma[peak]:.0f}"
            draw_title(canvas, title, left, top, _HALF)
            steps = np.linspace(0.0, 100.0, len(ramp.wanted))
            axes = chart_axes(left, top, _HALF, _HUE_HEIGHT, (0.0, 100.0), (0.0, 100.0))
            draw_grid(canvas, axes, "", "ink, %")
            draw_text(canvas, "way, %", left, axes.bottom - 2, 10 * MM, SMALL_MUTED)
            draw_curves(canvas, axes, steps, list(ramp.ink_percent.T), colours)
            _draw_pair(canvas, ramp, axes.x, axes.bottom - 4.2 * MM, axes.width)

    return Block(_HUE_HEIGHT + 4 * MM, draw)


def _fields(view: ProfileCheckView) -> list[Page]:
    note = (
        "Smooth colours as the relative intent prints them, as sRGB: where the tables are not smooth, bands and kinks "
        "show. Colours beyond sRGB are clipped, which makes edges of its own."
    )
    blocks = [section_heading(SMOOTHNESS, note)]
    ramps = [ramp for ramp in view.neutrals if ramp.title == "relative"] + list(view.hues)
    blocks += [_wide_ramp(ramp) for ramp in ramps]
    blocks.append(space(2 * MM))
    blocks += [_field(found) for found in view.fields]
    return flow(SMOOTHNESS, blocks)


def _wide_ramp(ramp: RampView) -> Block:
    name_width = 30 * MM
    name = "neutrals" if ramp.title == "relative" else ramp.title

    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, name, LEFT, top - 0.5 * (_RAMP_HEIGHT - SMALL_MUTED.leading), name_width, SMALL_MUTED)
        draw_strip(canvas, ramp.rgb_printed, LEFT + name_width, top, WIDTH - name_width, _RAMP_HEIGHT, frame=False)

    return Block(_RAMP_HEIGHT + 1 * MM, draw)


def _field(found: FieldView) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, found.title, LEFT, top, WIDTH, SMALL_MUTED)
        bottom = top - SMALL_MUTED.leading - 0.5 * MM - _FIELD_HEIGHT
        draw_picture(canvas, found.picture, LEFT, bottom, WIDTH, _FIELD_HEIGHT)

    return Block(_FIELD_HEIGHT + SMALL_MUTED.leading + 2 * MM, draw)
