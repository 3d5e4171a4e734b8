"""The texture map: building it, and the sampler that renders any region of the endless plane from it.

The first seed's chapter 5. A map holds one small image (the base), a repeatable tile and interchangeable patches,
both as references into the base; the sampler decides by integer hashing which patches are active in which cell of
the plane and copies pixels. Any pixel can be had without any other.
"""

from tilefab.sampling.layout import PlaneLayout, Region
from tilefab.sampling.map_builder import BuildOptions, build
from tilefab.sampling.render import render, render_points
from tilefab.sampling.texture_map import FORMAT_VERSION, Patches, TextureMap

__all__ = [
    "FORMAT_VERSION",
    "BuildOptions",
    "Patches",
    "PlaneLayout",
    "Region",
    "TextureMap",
    "build",
    "render",
    "render_points",
]
