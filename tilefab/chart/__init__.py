"""Characterisation charts: which recipes to print, where on the tiles, and how to find them again in a scan."""

from __future__ import annotations

from tilefab.chart.design import ChartDesign, design_chart
from tilefab.chart.layout import ChartLayout, lay_out_chart, render_tile

__all__ = ["ChartDesign", "ChartLayout", "design_chart", "lay_out_chart", "render_tile"]
