"""A job and a map in plain facts, for people and programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tilefab.pipeline.main_job import JobOutcome
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.run_report import preparation_log
from tilefab.sampling import FORMAT_VERSION, TextureMap
from tilefab.units import mm_from_px


def plan_facts(plan: Plan) -> dict[str, Any]:
    """Return a resolved job: every setting with its defaults, every path whole, sizes in pixels, hashes."""
    job = plan.job.model_dump(mode="json")
    job["job"]["name"] = plan.name
    job["slab"]["scans"] = [str(scan.path) for scan in plan.scans]
    job["slab"]["masks"] = [str(scan.mask) if scan.mask else "" for scan in plan.scans]
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
        "warnings": list(outcome.warnings),
    }


def _log(entries: tuple[tuple[str, str], ...]) -> list[dict[str, str]]:
    return [{"step": step, "what": what} for step, what in entries]


def map_facts(texture: TextureMap, path: Path) -> dict[str, Any]:
    """What a texture map holds."""
    patches = texture.patches
    rows, cols = texture.tile_shape
    area = patches.area_px
    return {
        "file": str(path),
        "hash": texture.hash,
        "format_version": FORMAT_VERSION,
        "space": texture.space,
        "channels": list(texture.channels),
        "dtype": str(texture.base.dtype),
        "dpi": texture.dpi,
        "base_px": [texture.base.shape[1], texture.base.shape[0]],
        "tile_px": [cols, rows],
        "tile_mm": [round(mm_from_px(cols, texture.dpi), 1), round(mm_from_px(rows, texture.dpi), 1)],
        "patches_a": patches.count_a,
        "patches_b": len(patches) - patches.count_a,
        "patch_area_px": [int(area.min()), int(np.median(area)), int(area.max())] if len(patches) else [],
        "patch_worst_delta_e": round(float(patches.worst_delta_e.max()), 2) if len(patches) else None,
        "activation_probability": round(texture.activation_threshold / 2**32, 6),
        "slabs": [slab.name for slab in texture.slabs],
        "method": texture.provenance.get("method"),
        "preparation": _log(preparation_log(texture)),
    }
