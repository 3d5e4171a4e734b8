"""Building a job's map of crops: what stands out is found, crops are joined, an earlier build is used again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.encoding import LAB16_CHANNELS, LAB16_SPACE
from tilefab.errors import SynthesisError, TextureMapError
from tilefab.io.texture_map_file import SUFFIX, load_texture_map, read_provenance
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.prepare import PreparedSlab
from tilefab.pipeline.progress import Progress
from tilefab.sampling import CropMap, CropOptions, Feature, build_crop_map
from tilefab.sampling.candidates import largest_valid_square
from tilefab.sampling.crop_builder import barred_crops, crop_geometry
from tilefab.sampling.crop_map import BARRED
from tilefab.sampling.crop_prices import crop_usage, fair_prices
from tilefab.texture.distinctive import distinctive_places
from tilefab.types import Mask

STAGE_FEATURES = "Finding features"
STAGE_CROPS = "Joining crops"
_MOST_FEATURES = 24
# Beyond this share of crops with a feature, taking turns would leave too little to choose from.
_RATIONED_SHARE = 0.4
_FEATURE_PER_PITCH = 0.6
_FLAT_DELTA_E = 1.0
_FEW_CROPS = 48
_SMALL_PITCH_PX = 16
_LITTLE_SHOWN = 0.5
_NONE_SHOWN = 0.5
_USE_GRID_PX = 1024


def build_crops(
    plan: Plan, slab: PreparedSlab, notes: Sequence[str], progress: Progress, threads: int | None
) -> CropMap:
    """Build the map of crops of a prepared slab.

    Raises
    ------
    SynthesisError
        If the slab is too small, or the job drops every crop or one that isn't there.
    """
    texture = plan.job.texture
    lab = slab.lab_d50
    warnings = [*slab.warnings, *notes]
    lightness = lab[..., 0]  # picked from first: a mask over colours would cost an index for each of its pixels
    if float(np.ptp(lightness[slab.valid] if slab.valid.any() else lightness)) < _FLAT_DELTA_E:
        warnings.append("The stone shows no texture at all: every face will be of one colour. Check the scan")
    try:
        features = striking_features(lab, slab.valid, plan.feature_px, progress) if texture.ration else []
        built = build_crop_map(
            lab,
            slab.valid,
            crop_options(plan, threads),
            stored=slab.lab16,
            space=LAB16_SPACE,
            channels=LAB16_CHANNELS,
            dpi=plan.job.tile.dpi,
            slabs=slab.slabs,
            weights=slab.weights,
            features=features,
            progress=lambda share: progress.stage(STAGE_CROPS, share),
        )
    except ValueError as error:
        raise _no_crops(plan, error) from error
    progress.stage(STAGE_CROPS, 1.0)
    facts = {
        "build_key": plan.build_key,
        "crops_wanted": str(texture.crops),
        "features": json.dumps([[f.row, f.col, f.radius_px] for f in features]),
        "usable_px": str(int(np.count_nonzero(slab.valid))),
        "weights": "yes" if slab.weights is not None else "no",
        "preparation": json.dumps(slab.log, ensure_ascii=False),
        "warnings": json.dumps(warnings, ensure_ascii=False),
    }
    if slab.grown_from:
        facts["grown_from"] = json.dumps([astuple(area) for area in slab.grown_from])
    return replace(built, provenance={**facts, **_choice_facts(plan)})


def crop_warnings(crop_map: CropMap) -> tuple[str, ...]:
    """What is wrong with the crops that a map may show, however it came by them."""
    warnings = []
    shown = crop_map.price < BARRED
    if np.count_nonzero(shown) < _FEW_CROPS:
        warnings.append(
            f"Faces are made of {np.count_nonzero(shown)} different crops only: they will be seen to recur. Scan more "
            "of the stone, drop fewer crops, or make feature_mm smaller"
        )
    if crop_map.pitch_px < _SMALL_PITCH_PX:
        warnings.append(
            f"Crops are only {crop_map.pitch_px} pixels apart: faces will look like noise. Scan more of the stone, "
            "make feature_mm larger, or mask larger pieces instead of scattered specks: no crop may hold a masked pixel"
        )
    factor = max(1, max(crop_map.base.shape[:2]) // _USE_GRID_PX)
    reached = np.count_nonzero(crop_usage(crop_map, shown.astype(np.int64), factor) > _NONE_SHOWN) * factor**2
    usable = int(crop_map.provenance.get("usable_px", "0"))
    if reached < _LITTLE_SHOWN * usable:
        warnings.append(f"The crops show {100 * reached / usable:.0f} % of the usable stone: the rest is never printed")
    return tuple(warnings)


def rebuilt_crops(plan: Plan, folder: Path, progress: Progress) -> CropMap | None:
    """Map with other crops dropped, from one of ``folder`` that differs in nothing else; ``None`` if there is none.

    The crops of the slab and what joining them costs stay as they are; only the prices that make the use of the slab
    even are found anew.

    Raises
    ------
    SynthesisError
        If the job drops every crop or one that isn't there.
    """
    earlier = _earlier(plan, folder)
    if earlier is None:
        return None
    progress.note("The crops and joining costs of the map built before are used")
    try:
        barred = barred_crops(len(earlier.crop_row), crop_options(plan, None))
    except ValueError as error:
        raise _no_crops(plan, error) from error
    open_map = replace(
        earlier,
        price=np.where(barred, BARRED, 0).astype(np.int32),
        provenance={**earlier.provenance, **_choice_facts(plan)},
    )
    priced = fair_prices(open_map, barred, plan.seed, lambda share: progress.stage(STAGE_CROPS, share))
    progress.stage(STAGE_CROPS, 1.0)
    return priced


def crop_options(plan: Plan, threads: int | None) -> CropOptions:
    """How the job wants its crops."""
    texture = plan.job.texture
    return CropOptions(
        feature_px=plan.feature_px,
        crops=texture.crops,
        seed=plan.seed,
        threads=threads,
        drop=tuple(texture.drop),
        keep=tuple(texture.keep),
    )


def striking_features(
    lab_d50: NDArray[np.float32], valid: Mask, feature_px: int | None, progress: Progress
) -> list[Feature]:
    """Places of the slab that would be recognised if they recurred close by, the most striking first.

    Raises
    ------
    ValueError
        If the slab is too small to take crops from.
    """
    progress.stage(STAGE_FEATURES, 0.0)
    pitch = crop_geometry(valid.shape, largest_valid_square(valid), feature_px).pitch_px
    # A crop shows a feature wherever in it that lies, so each takes about a cell of the slab.
    most = int(_RATIONED_SHARE * np.count_nonzero(valid) / pitch**2)
    found = []
    if most > 0:
        size_px = max(1, round(_FEATURE_PER_PITCH * pitch))
        found = distinctive_places(lab_d50, valid, size_px, min(most, _MOST_FEATURES))
    progress.stage(STAGE_FEATURES, 1.0)
    return [Feature(place.row, place.col, place.radius_px) for place in found]


def _choice_facts(plan: Plan) -> dict[str, str]:
    texture = plan.job.texture
    return {
        "map_key": plan.map_key,
        "dropped": json.dumps(sorted(set(texture.drop))),
        "kept": json.dumps(sorted(set(texture.keep))),
    }


def _earlier(plan: Plan, folder: Path) -> CropMap | None:
    for path in sorted(folder.glob(f"*.texture{SUFFIX}")):
        try:
            if read_provenance(path).get("build_key") != plan.build_key:
                continue
            loaded = load_texture_map(path)
        except TextureMapError:
            continue
        if isinstance(loaded, CropMap):
            return loaded
    return None


def _no_crops(plan: Plan, error: ValueError) -> SynthesisError:
    texture, dpi = plan.job.texture, plan.job.tile.dpi
    advice = "use a larger scan, or check dpi"
    if texture.drop or texture.keep:
        advice = "look at the numbers in `tilefab map review` and change drop or keep"
    elif texture.feature_mm is not None:
        advice = "use a larger scan, make feature_mm smaller, or check dpi"
    return SynthesisError(f"no crops can be made of this slab at {dpi:g} dpi: {error}; {advice}")
