"""Colour: spaces and differences, scans and inks through ICC profiles, and the making of press profiles."""

from __future__ import annotations

from tilefab.colour.differences import delta_e_76, delta_e_94, delta_e_cmc
from tilefab.colour.inks import black_channel
from tilefab.colour.limits import limit_total_ink, max_total_counts, quantise_inks
from tilefab.colour.lut import BackwardTables, ForwardTable, build_backward, build_forward
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.preview import reduce_srgb
from tilefab.colour.separation import SeparationSettings, Separator
from tilefab.colour.spaces import (
    WHITE_XYZ_D50,
    absolute_lab,
    delta_e_2000,
    lab_from_xyz,
    relative_lab,
    srgb_from_xyz,
    xyz_from_lab,
)
from tilefab.colour.transform import Intent, PressTransform, scan_to_xyz

__all__ = [
    "WHITE_XYZ_D50",
    "BackwardTables",
    "ForwardTable",
    "Intent",
    "PressModel",
    "PressTransform",
    "SeparationSettings",
    "Separator",
    "absolute_lab",
    "black_channel",
    "build_backward",
    "build_forward",
    "delta_e_76",
    "delta_e_94",
    "delta_e_2000",
    "delta_e_cmc",
    "fit_press_model",
    "lab_from_xyz",
    "limit_total_ink",
    "max_total_counts",
    "quantise_inks",
    "reduce_srgb",
    "relative_lab",
    "scan_to_xyz",
    "srgb_from_xyz",
    "xyz_from_lab",
]
