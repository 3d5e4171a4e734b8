"""What may stand in a job file. Each field is documented where it is declared; `docs/job_files.md` is made from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tilefab.synthesis import METHODS

if TYPE_CHECKING:
    MethodName: TypeAlias = str
else:
    # Whatever methods there are: pydantic checks against their names, and lists them.
    MethodName = Literal[tuple(METHODS)]

SCHEMA_VERSION = 1
LARGEST_FACE_PX = 1 << 30
"""More pixels than this a face can't have: some 3.3 m square at 250 dpi."""

OF_DESIGN = {
    "crops": ("crops", "ration", "drop", "keep", "grow", "grown_size_mm"),
    "tile": ("method", "map_size_mm", "patches", "active_per_cell"),
}
"""Settings of [texture] that mean something to one design only."""


class Section(BaseModel):
    """A table of a job file: unknown keys are errors, values can't change once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


Size = Annotated[
    list[Annotated[float, Field(gt=0)]],
    Field(min_length=2, max_length=2, description="[width, height]"),
]


class JobFacts(Section):
    """[job]: what people call it."""

    name: str = Field("", max_length=200, description="Name of the job, shown in the report.")


class Slab(Section):
    """[slab]: the scanned stone."""

    scans: list[str] = Field(
        min_length=1,
        max_length=64,
        description="Scans of one stone: TIFF, PNG, JPEG or EXR. "
        "`package:NAME/FILE` names a file inside an installed Python package.",
    )
    dpi: float | None = Field(
        None,
        ge=10,
        le=20000,
        description="Resolution of the scans, if the files don't state it; overrides them.",
    )
    input_profile: str | None = Field(
        None,
        description="ICC profile of the scanner; overrides one embedded in the scans. "
        "Without any: sRGB, or linear sRGB for float images.",
    )
    masks: list[str] | None = Field(
        None,
        description='One mask for each scan, white where it is not to be used; "" for a scan without one.',
    )
    weights: list[str] | None = Field(
        None,
        description="One grayscale image for each scan, as large as it, the brighter the less may be cut there: paint "
        'what must stay whole; "" for a scan without one. Only for `design = "crops"`.',
    )
    square: bool = Field(True, description="Find the slab on the scanner, turn it upright and trim its surround.")
    trim_mm: float = Field(0.0, ge=0, le=1000, description="Width to trim off each edge of the slab.")
    lighting: bool = Field(True, description="Remove uneven lighting of the scanner.")
    match: bool = Field(True, description="Bring several slabs to a common colour mean and spread.")
    target_lab: list[float] | None = Field(
        None,
        min_length=3,
        max_length=3,
        description="Colour mean to bring the slabs to, [L*, a*, b*]; a grayscale scan is tinted by it.",
    )

    @model_validator(mode="after")
    def _check(self) -> Slab:
        if self.masks is not None and len(self.masks) != len(self.scans):
            raise ValueError(f"masks: {len(self.masks)} given for {len(self.scans)} scans; give one each")
        if self.weights is not None and len(self.weights) != len(self.scans):
            raise ValueError(f"weights: {len(self.weights)} given for {len(self.scans)} scans; give one each")
        if self.target_lab is not None and not (
            0 <= self.target_lab[0] <= 100 and all(abs(v) <= 127 for v in self.target_lab[1:])
        ):
            raise ValueError("target_lab: L* must be within 0 .. 100, a* and b* within -127 .. 127")
        return self


CropNumbers = list[Annotated[int, Field(ge=0, lt=1 << 20)]]


class Texture(Section):
    """[texture]: how the texture map is made."""

    design: Literal["crops", "tile"] = Field(
        "crops",
        description="`crops`: pieces of the slab, chosen so that neighbours join well; nothing repeats. `tile`: one "
        "repeatable tile with interchangeable patches.",
    )
    feature_mm: float | None = Field(
        None,
        gt=0,
        description="Size of the largest thing in the stone that should stay whole. Default: a quarter of the slab.",
    )
    crops: int = Field(
        1024,
        ge=16,
        le=4096,
        description="How many crops of the slab to choose from: more join better and take longer (crops only).",
    )
    ration: bool = Field(
        True,
        description="Let striking features of the stone take turns, so that none recurs close by (crops only).",
    )
    drop: CropNumbers = Field(
        [], max_length=4096, description="Crops never to show, by their numbers in `tilefab map review` (crops only)."
    )
    keep: CropNumbers = Field(
        [],
        max_length=4096,
        description="The only crops to show, less those in `drop`; empty: all (crops only).",
    )
    grow: MethodName | None = Field(
        None,
        description="Grow the slab by this method to a larger one first, and take the crops from that (crops only). "
        "Default: crops of the slab itself. See [synthesis.md](synthesis.md).",
    )
    grown_size_mm: Size | None = Field(
        None,
        description="Size of the grown slab (crops only). Default: twice the slab, at most 4,096 pixels a side.",
    )
    method: MethodName = Field(
        "quilting",
        description="How the repeatable tile is grown (tile only). See [synthesis.md](synthesis.md).",
    )
    map_size_mm: Size | None = Field(
        None, description="Size of the repeatable tile (tile only). Default: 1.5 times the slab, at most 4,096 pixels."
    )
    patches: int = Field(600, ge=0, le=4000, description="Interchangeable patches to aim for (tile only).")
    active_per_cell: float = Field(
        40.0,
        ge=0,
        le=4000,
        description="Patches that each cell of the plane tries to show, on average (tile only).",
    )
    seed: int = Field(0, ge=0, lt=1 << 63, description="Job seed: another seed gives other faces.")

    @model_validator(mode="after")
    def _check(self) -> Texture:
        other = "tile" if self.design == "crops" else "crops"
        for key in sorted(self.model_fields_set & set(OF_DESIGN[other]), key=OF_DESIGN[other].index):
            raise ValueError(
                f'{key}: means something with design = "{other}" only, this job has "{self.design}"; remove it, or '
                f'write design = "{other}"'
            )
        for key in ("drop", "keep"):
            for number in getattr(self, key):
                if number >= self.crops:
                    raise ValueError(f"{key}: there is no crop {number}; the job has crops 0 to {self.crops - 1}")
        if self.grown_size_mm is not None and self.grow is None:
            raise ValueError("grown_size_mm: only where the slab is grown; say how with grow = ..., or remove it")
        if self.keep and set(self.keep) <= set(self.drop):
            raise ValueError("keep: every crop in it is in drop as well, so none is left to show")
        return self


class Tile(Section):
    """[tile]: the faces."""

    size_mm: Size = Field(description="Finished size of a tile, [width, height].")
    dpi: float = Field(ge=10, le=2400, description="Resolution of the printer.")
    count: int = Field(1, ge=1, le=1 << 40, description="How many faces to print.")
    layout: Literal["scatter", "continuous"] = Field(
        "scatter",
        description="`scatter`: faces from all over the plane. `continuous`: a wall whose veins run on.",
    )
    columns: int | None = Field(None, ge=1, le=100_000, description="Faces in a row of the wall (continuous only).")
    bleed_mm: float = Field(0.0, ge=0, le=100, description="Margin printed beyond each edge.")

    @model_validator(mode="after")
    def _check(self) -> Tile:
        if self.layout == "continuous" and self.columns is None:
            raise ValueError('columns: needed with layout = "continuous": how many faces a row of the wall has')
        if self.layout == "scatter" and self.columns is not None:
            raise ValueError('columns: only for layout = "continuous"; remove it or change the layout')
        sides = [(length + 2 * self.bleed_mm) / 25.4 * self.dpi for length in self.size_mm]
        if sides[0] * sides[1] > LARGEST_FACE_PX:
            raise ValueError(
                f"size_mm: {self.size_mm[0]:g} x {self.size_mm[1]:g} mm at {self.dpi:g} dpi is {sides[0]:.0f} x "
                f"{sides[1]:.0f} pixels; a face can have 2**30 at most: check size_mm, bleed_mm and dpi"
            )
        if min(self.size_mm) / 25.4 * self.dpi < 1:
            raise ValueError(f"size_mm: smaller than a pixel at {self.dpi:g} dpi: check size_mm and dpi")
        return self


class Colour(Section):
    """[colour]: how the stone's colours become inks."""

    press_profile: str = Field(description="ICC output profile of the press: a file, or the name of a shipped one.")
    intent: Literal["perceptual", "relative", "absolute", "saturation"] = Field(
        "perceptual", description="Rendering intent."
    )
    ink_limit_percent: float = Field(300.0, gt=0, le=800, description="Most ink at any place, all inks added up.")
    ink_names: list[str] | None = Field(
        None,
        min_length=1,
        max_length=8,
        description="Names of the inks. Default: those in the profile, or Cyan, Magenta, Yellow, Black.",
    )
    separation: Literal["profile", "standard", "least_ink"] = Field(
        "profile",
        description="How inks are chosen among recipes of one colour. `profile`: as the profile does (with `gamut` or "
        "`drift`: as `standard`). `standard`: black as printers are used to. `least_ink`: the cheapest recipe. All but "
        "`profile` need a profile that carries its measurements, as do `gamut` and `drift`.",
    )
    ink_prices: dict[str, Annotated[float, Field(gt=0)]] | None = Field(
        None,
        min_length=1,
        max_length=8,
        description="What each ink costs, in any unit, as { Blue = 30.0 }; inks not named cost 1 (least_ink only).",
    )
    gamut: Literal["any", "image"] = Field(
        "any",
        description="What the perceptual intent makes room for: `any` colour, or only those of this stone (`image`), "
        "which then keeps more of its own.",
    )
    drift: str | None = Field(
        None, description="Drift state of the press since it was profiled: a file of `tilefab profile drift`."
    )

    @property
    def rebuilds_tables(self) -> bool:
        """Whether the press's tables are made for this job, instead of taken from the profile."""
        return self.separation != "profile" or self.gamut != "any" or self.drift is not None

    @model_validator(mode="after")
    def _check(self) -> Colour:
        if self.ink_prices is not None and self.separation != "least_ink":
            raise ValueError('ink_prices: only for separation = "least_ink"; remove it or change the separation')
        if self.gamut == "image" and self.intent != "perceptual":
            raise ValueError('gamut: "image" is for intent = "perceptual" only; remove it or change the intent')
        for name in self.ink_names or []:
            if not name or not name.isascii() or not name.isprintable() or len(name) > 40:
                raise ValueError(f"ink_names: {name!r} must be 1 to 40 printable ASCII characters")
        return self


class Output(Section):
    """[output]: where the faces go."""

    directory: str = Field(min_length=1, description="Folder of the run; relative to the job file.")
    format: Literal["tiff"] = Field("tiff", description="File format of the faces.")
    bits: Literal[8, 16] = Field(8, description="Bits per ink.")
    compression: Literal["none", "lzw", "deflate"] = Field("none", description="Of the TIFF files.")
    proofs: bool = Field(True, description="Also write each face as it will look fired, as sRGB PNG.")


class Report(Section):
    """[report]: the PDF."""

    pdf: str | Literal[False] = Field(
        "report.pdf", description="File name, relative to the run's folder; false for none."
    )
    faces: int = Field(24, ge=1, le=1000, description="Most faces to show on the contact sheet.")

    @model_validator(mode="after")
    def _check(self) -> Report:
        if self.pdf is not False and not self.pdf.lower().endswith(".pdf"):
            raise ValueError(f"pdf: {self.pdf!r} must end in .pdf, so that it can't replace another file of the run")
        return self


class OnLine(Section):
    """[line]: how a factory line runs the job."""

    recipe: str = Field(
        "default",
        min_length=1,
        max_length=60,
        description="Recipe of the line's file (belt, kiln) to print it with; never changes a pixel.",
    )


class Job(Section):
    """A whole job file."""

    schema_version: Literal[1] = Field(1, description="Version of the job file's format.")
    job: JobFacts = Field(default_factory=lambda: JobFacts.model_validate({}))
    slab: Slab
    texture: Texture = Field(default_factory=lambda: Texture.model_validate({}))
    tile: Tile
    colour: Colour
    output: Output
    report: Report = Field(default_factory=lambda: Report.model_validate({}))
    line: OnLine = Field(default_factory=lambda: OnLine.model_validate({}))
