"""A job and a map in plain facts, for people and programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.pipeline.crop_sample import shown_crops
from tilefab.pipeline.main_job import JobOutcome
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.run_report import preparation_log
from tilefab.report import ColourView
from tilefab.sampling import FORMAT_VERSION, CropMap, TextureMap, TileMap
from tilefab.units import mm_from_px


def plan_facts(plan: Plan) -> dict[str, Any]:
    """Return a resolved job: every setting with its defaults, every path whole, sizes in pixels, hashes."""
    job = plan.job.model_dump(mode="json")
    job["job"]["name"] = plan.name
    job["slab"]["scans"] = [str(scan.path) for scan in plan.scans]
    job["slab"]["masks"] = [str(scan.mask) if scan.mask else "" for scan in plan.scans]
    job["slab"]["weights"] = [str(scan.weights) if scan.weights else "" for scan in plan.scans]
    job["slab"]["dpi"] = [scan.dpi for scan in plan.scans]
    job["slab"]["size_px"] = [f"{scan.facts.size.cols} x {scan.facts.size.rows}" for scan in plan.scans]
    job["slab"]["input_profile"] = plan.input_profile.path if plan.input_profile else None
    job["tile"]["size_px"] = [plan.tile_px.cols, plan.tile_px.rows]
    job["tile"]["bleed_px"] = plan.bleed_px
    job["colour"]["press_profile"] = plan.press_profile.path
    job["colour"]["press_profile_name"] = plan.press_profile.description
    job["colour"]["ink_names"] = list(plan.ink_names)
    job["output"]["directory"] = str(plan.output)
    return {
        **job,
        "hashes": {"job": plan.job_hash, "map_key": plan.map_key, "press_profile": plan.press_profile.sha256},
    }


def outcome_facts(outcome: JobOutcome) -> dict[str, Any]:
    """What a run did."""
    run = outcome.run
    return {
        "output": str(run.output),
        "faces": run.faces,
        "written": run.written,
        "kept": run.kept,
        "texture_map": run.maps.texture.hash,
        "press_map": run.maps.press.hash,
        "report": str(outcome.report) if outcome.report else None,
        "preparation": _log(outcome.preparation),
        "colour": _colour_facts(outcome.colour),
        "warnings": list(outcome.warnings),
    }


def _colour_facts(colour: ColourView) -> dict[str, Any]:
    return {
        "delta_e_mean": round(colour.delta_e_mean, 3),
        "delta_e_p95": round(colour.delta_e_p95, 3),
        "out_of_gamut_share": round(colour.out_of_gamut_share, 5),
        "out_of_gamut_mean": round(colour.out_of_gamut_mean, 3),
        "out_of_gamut_p95": round(colour.out_of_gamut_p95, 3),
        "mean_total_ink_percent": round(colour.mean_total_ink_percent, 2),
        "max_total_ink_percent": round(colour.max_total_ink_percent, 2),
        "share_limited": round(colour.share_limited, 5),
        "mean_ink_percent": {ink.name: round(ink.mean_percent, 2) for ink in colour.inks},
    }


def _log(entries: tuple[tuple[str, str], ...]) -> list[dict[str, str]]:
    return [{"step": step, "what": what} for step, what in entries]


def map_facts(texture: TextureMap, path: Path) -> dict[str, Any]:
    """What a texture map holds."""
    rows, cols = texture.cell_shape
    facts: dict[str, Any] = {
        "file": str(path),
        "hash": texture.hash,
        "format_version": FORMAT_VERSION,
        "design": texture.design,
        "space": texture.space,
        "channels": list(texture.channels),
        "dtype": str(texture.base.dtype),
        "dpi": texture.dpi,
        "base_px": [texture.base.shape[1], texture.base.shape[0]],
        "cell_px": [cols, rows],
        "cell_mm": [round(mm_from_px(cols, texture.dpi), 1), round(mm_from_px(rows, texture.dpi), 1)],
    }
    if isinstance(texture, CropMap):
        facts |= _crop_facts(texture)
    elif isinstance(texture, TileMap):
        facts |= _tile_facts(texture)
    return {
        **facts,
        "slabs": [slab.name for slab in texture.slabs],
        "preparation": _log(preparation_log(texture)),
    }


def _crop_facts(texture: CropMap) -> dict[str, Any]:
    return {
        "crops": len(texture.crop_row),
        "crops_shown": int(np.count_nonzero(shown_crops(texture))),
        "crops_rationed": int((texture.ration >= 0).sum()),
        "features": len(json.loads(texture.provenance.get("features", "[]"))),
        "overlap_px": texture.overlap_px,
        "candidates": texture.candidates,
        "sweeps": texture.sweeps,
        "weights": texture.provenance.get("weights") == "yes",
    }


def _tile_facts(texture: TileMap) -> dict[str, Any]:
    patches = texture.patches
    area = patches.area_px
    return {
        "patches_a": patches.count_a,
        "patches_b": len(patches) - patches.count_a,
        "patch_area_px": [int(area.min()), int(np.median(area)), int(area.max())] if len(patches) else [],
        "patch_worst_delta_e": round(float(patches.worst_delta_e.max()), 2) if len(patches) else None,
        "activation_probability": round(texture.activation_threshold / 2**32, 6),
        "method": texture.provenance.get("method"),
    }
