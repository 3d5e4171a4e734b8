"""Colours into the inks of a press and back, through the tables of its profile.

The tables are interpolated by tilefab's own kernels, over tetrahedra and simplices, in floating point. Every pixel is
computed alone: threads and strips never change a value.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.grid_float import apply_float
from tilefab.colour.grid_layout import MOST_CHANNELS, channels_in, each_strip
from tilefab.colour.spaces import absolute_lab, lab_from_xyz, relative_lab, xyz_from_lab
from tilefab.colour.stages import ColourTable

Intent = Literal["perceptual", "relative", "saturation", "absolute"]
"""The four rendering intents of ICC profiles."""

Colorimetric = Literal["relative", "absolute"]
"""How a printed colour is stated: against the unprinted tile's white, or as an instrument reads it."""


@dataclass(frozen=True)
class PressTransform:
    """A press's conversions, both ways; `tilefab.io.press_profile` makes it of a profile.

    Attributes
    ----------
    to_inks
        From CIELAB or XYZ, against the unprinted tile's white, to 1 to 8 inks: the table of the intent.
    to_lab
        From the inks to CIELAB or XYZ, against the unprinted tile's white: the colorimetric table.
    white_xyz
        Media white under D50, Y = 1 for a perfect diffuser, each above 0.
    intent
        "perceptual", "relative", "saturation" or "absolute".

    Raises
    ------
    ValueError
        If the tables don't belong together, the white is dark, or the intent has no such name.

    References
    ----------
    ICC.1:2010 section 6.3 (connection space, media white).
    """

    to_inks: ColourTable = field(repr=False)
    to_lab: ColourTable = field(repr=False)
    white_xyz: tuple[float, float, float]
    intent: Intent

    def __post_init__(self) -> None:
        if self.intent not in get_args(Intent):
            raise ValueError(f"intent {self.intent!r} is none of {', '.join(get_args(Intent))}")
        ends = (self.to_inks.target, self.to_lab.source)
        colours = {self.to_inks.source, self.to_lab.target}
        if ends != ("ink", "ink") or not colours <= {"lab", "xyz"}:
            raise ValueError("a press's tables go from CIELAB or XYZ to inks, and from inks to CIELAB or XYZ")
        found = len(self.to_inks(np.zeros(3)))
        if not 1 <= self.inks <= MOST_CHANNELS or found != self.inks:
            raise ValueError(f"tables to {found} and from {self.inks} inks: both must be for the same 1 to 8")
        if not min(self.white_xyz) > 0.0:
            raise ValueError(f"a media white of {self.white_xyz} is none: all its values must be above 0")

    @property
    def inks(self) -> int:
        """Number of ink channels."""
        return channels_in(self.to_lab.stages[0])

    def inks_from_lab(self, lab_d50: NDArray[np.floating], *, threads: int = 1) -> NDArray[np.float32]:
        """Inks that print given colours.

        Parameters
        ----------
        lab_d50
            (rows, cols, 3): L*, a*, b* under D50; relative to the unprinted tile's white unless the intent is
            "absolute".
        threads
            Number of threads, 1 or more; never changes the result.

        Returns
        -------
        numpy.ndarray
            (rows, cols, inks) float32 ink fractions, 0 to 1, before any total ink limit but the profile's
            own.

        Raises
        ------
        ValueError
            If the shape is not (rows, cols, 3), or threads are below 1.
        """
        if lab_d50.ndim != 3 or lab_d50.shape[2] != 3:
            raise ValueError(f"lab_d50 must be (rows, cols, 3), but its shape is {lab_d50.shape}")
        if self.intent != "absolute" and self.to_inks.source == "lab":
            return apply_float(self.to_inks, lab_d50.astype(np.float32, copy=False), threads=threads)
        colours = np.empty(lab_d50.shape, np.float32)
        flat = colours.reshape(-1, 3)

        def convert(strip: NDArray[np.floating], to: int) -> None:
            lab = strip.reshape(-1, 3).astype(np.float64)
            if self.intent == "absolute":
                lab = relative_lab(lab, lab_from_xyz(self.white_xyz))
            flat[to : to + len(lab)] = xyz_from_lab(lab) if self.to_inks.source == "xyz" else lab

        each_strip(lab_d50, convert, threads)
        return apply_float(self.to_inks, colours, threads=threads)

    def lab_from_inks(
        self, ink_frac: NDArray[np.floating], *, intent: Colorimetric = "relative", threads: int = 1
    ) -> NDArray[np.float32]:
        """Colours that given inks print: the profile backwards.

        Parameters
        ----------
        ink_frac
            (rows, cols, inks) ink fractions, 0 to 1.
        intent
            "relative" gives colours against the unprinted tile's white, "absolute" as an instrument reads
            them.
        threads
            Number of threads, 1 or more; never changes the result.

        Returns
        -------
        numpy.ndarray
            (rows, cols, 3) float32: L*, a*, b* under D50.

        Raises
        ------
        ValueError
            If the shape is not (rows, cols, inks), threads are below 1, or the intent has no such name.
        """
        if ink_frac.ndim != 3 or ink_frac.shape[2] != self.inks:
            raise ValueError(f"ink_frac must be (rows, cols, {self.inks}), but its shape is {ink_frac.shape}")
        if intent not in get_args(Colorimetric):
            raise ValueError(f"intent {intent!r} is none of {', '.join(get_args(Colorimetric))}")
        found = apply_float(self.to_lab, ink_frac.astype(np.float32, copy=False), threads=threads)
        if intent == "relative" and self.to_lab.target == "lab":
            return found
        flat = found.reshape(-1, 3)

        def convert(strip: NDArray[np.floating], to: int) -> None:
            lab = strip.reshape(-1, 3).astype(np.float64)
            if self.to_lab.target == "xyz":
                lab = lab_from_xyz(lab)
            if intent == "absolute":
                lab = absolute_lab(lab, lab_from_xyz(self.white_xyz))
            flat[to : to + len(lab)] = lab

        each_strip(found, convert, threads)
        return found
