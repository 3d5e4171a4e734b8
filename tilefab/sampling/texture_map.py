"""The texture map: everything the sampler needs, and nothing that depends on a face."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from tilefab.types import Array

FORMAT_VERSION = 2
"""Version of what a map means: raised whenever the same map would render to other pixels."""

_MAX_CHANNELS = 8


@dataclass(frozen=True)
class SlabArea:
    """Which part of the base shows which slab, for tracing a pixel back to the stone."""

    name: str
    base_row: int
    base_col: int
    rows: int
    cols: int


@dataclass(frozen=True, eq=False, kw_only=True)
class TextureMap(ABC):
    """A small image and the references into it from which every face is copied.

    How the references are made up is its design: `tilefab.sampling.CropMap` or `tilefab.sampling.TileMap`.

    Attributes
    ----------
    base
        (rows, cols, channels), any dtype, C-contiguous: the image that all pixels come from.
    space
        What the numbers of ``base`` are: ``"lab16"`` (see `tilefab.colour.encoding`), ``"ink8"`` or ``"ink16"``
        (0 = no ink), or anything a caller made up.
    channels
        Name of each channel.
    dpi
        Print resolution that the base was prepared for.
    slabs
        Where each slab lies in the base.
    provenance
        What the map was made from and how, as text by name; part of the hash.

    Raises
    ------
    ValueError
        If the parts don't fit together.
    """

    design: ClassVar[str]

    base: Array
    space: str
    channels: tuple[str, ...]
    dpi: float
    slabs: tuple[SlabArea, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.base.ndim != 3 or not self.base.flags.c_contiguous:
            raise ValueError(f"base must be C-contiguous (rows, cols, channels), not {self.base.shape}")
        if self.base.shape[2] != len(self.channels) or not 1 <= len(self.channels) <= _MAX_CHANNELS:
            raise ValueError(f"base has {self.base.shape[2]} channels but {len(self.channels)} names")

    @property
    @abstractmethod
    def cell_shape(self) -> tuple[int, int]:
        """Rows and columns of a cell of the plane, in pixels."""

    @property
    @abstractmethod
    def reach_cells(self) -> int:
        """How many cells beyond a region a choice can be that still decides what the region shows."""

    @abstractmethod
    def parameters(self) -> dict[str, int]:
        """Numbers of the design, by name."""

    @abstractmethod
    def design_arrays(self) -> dict[str, Array]:
        """Arrays of the design, by name."""

    @classmethod
    @abstractmethod
    def design_fields(cls, parameters: dict[str, int], arrays: dict[str, Array]) -> dict[str, object]:
        """What the constructor takes, from what `parameters` and `design_arrays` gave."""

    def with_base(self, base: Array, space: str, channels: tuple[str, ...], **provenance: str) -> Self:
        """Return the same map over another image of the same size: every pixel keeps its place in the stone.

        This is how a map is converted to inks: the small base once, never the faces.
        """
        if base.shape[:2] != self.base.shape[:2]:
            raise ValueError(f"a base of {base.shape[:2]} can't replace one of {self.base.shape[:2]}")
        return replace(
            self,
            base=np.ascontiguousarray(base),
            space=space,
            channels=channels,
            provenance={**self.provenance, **provenance},
        )

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that decides pixels, and of the provenance, as 64 hexadecimal digits."""
        digest = hashlib.sha256(f"tilefab texture map {FORMAT_VERSION} {self.design}\n".encode())
        facts = (
            sorted((name, int(value)) for name, value in self.parameters().items()),
            self.space,
            tuple(self.channels),
            repr(float(self.dpi)),
            [(s.name, int(s.base_row), int(s.base_col), int(s.rows), int(s.cols)) for s in self.slabs],
            sorted(self.provenance.items()),
        )
        digest.update(repr(facts).encode())
        for name, array in self.arrays().items():
            little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
            digest.update(f"\n{name} {little.dtype.str} {little.shape}\n".encode())
            digest.update(little.data)
        return digest.hexdigest()

    def arrays(self) -> dict[str, Array]:
        """Every array of the map by name, in a fixed order."""
        return {"base": self.base, **self.design_arrays()}
