"""Cleaning the scan of a stone slab, one pure step at a time.

Each step takes an image, its mask and options, and returns an image, a mask and a record of what it did, in numbers
and one sentence: `square_slab` makes a skewed scan upright, `estimate_lighting` and `remove_lighting` even out the
scanner's light, `resample` brings it to the printer's resolution, `match_slabs` gives several slabs one colour, and
`build_atlas` lays them into one base image. Geometry and lighting work in linear XYZ D50, matching and the atlas in
CIELAB D50; a step that finds nothing it can rely on does nothing and says why. Arrays given are never written to but
where the caller asks for it, and come back themselves where a step has nothing to do: slabs are large. What must not be
cut travels beside the slab: `square_weights`, `resample_weights`, `join_weights`.
"""

from tilefab.slab.atlas import AtlasRecord, SlabPlacement, build_atlas, locate
from tilefab.slab.bands import over_bands
from tilefab.slab.lighting import LightingModel, LightingRecord, estimate_lighting, remove_lighting
from tilefab.slab.match import MatchOptions, MatchRecord, SlabColour, match_slabs, slab_colour
from tilefab.slab.resampling import ResampleRecord, resample, resampled_size
from tilefab.slab.squaring import SquaringOptions, SquaringRecord, square_slab
from tilefab.slab.weights import join_weights, resample_weights, square_weights

__all__ = [
    "AtlasRecord",
    "LightingModel",
    "LightingRecord",
    "MatchOptions",
    "MatchRecord",
    "ResampleRecord",
    "SlabColour",
    "SlabPlacement",
    "SquaringOptions",
    "SquaringRecord",
    "build_atlas",
    "estimate_lighting",
    "join_weights",
    "locate",
    "match_slabs",
    "over_bands",
    "remove_lighting",
    "resample",
    "resample_weights",
    "resampled_size",
    "slab_colour",
    "square_slab",
    "square_weights",
]
