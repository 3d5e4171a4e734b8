"""The texture map: building it, and the sampler that renders any region of the endless plane from it.

A map holds one small image (the base) and references into it. There are two designs: crops of the slab, chosen so
that neighbours join well, of which nothing on the plane is fixed (`CropMap`); and the first seed's chapter 5, a
repeatable tile with interchangeable patches (`TileMap`). The sampler decides by integer hashing and copies pixels; any
pixel can be had without any other.
"""

from tilefab.sampling.crop_builder import CropOptions, Feature, build_crop_map
from tilefab.sampling.crop_map import CropMap
from tilefab.sampling.crop_plan import CropPlan, plan_region
from tilefab.sampling.layout import PlaneLayout, Region
from tilefab.sampling.render import render, render_plan, render_points, render_reduced
from tilefab.sampling.texture_map import FORMAT_VERSION, SlabArea, TextureMap
from tilefab.sampling.tile_builder import TileOptions, build_tile_map
from tilefab.sampling.tile_map import Patches, TileMap

__all__ = [
    "FORMAT_VERSION",
    "CropMap",
    "CropOptions",
    "CropPlan",
    "Feature",
    "Patches",
    "PlaneLayout",
    "Region",
    "SlabArea",
    "TextureMap",
    "TileMap",
    "TileOptions",
    "build_crop_map",
    "build_tile_map",
    "plan_region",
    "render",
    "render_plan",
    "render_points",
    "render_reduced",
]
