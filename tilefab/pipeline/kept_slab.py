"""The prepared slab, kept while its texture map is being built: an interrupted build needn't prepare it again."""

from __future__ import annotations

import json
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.errors import OutputError
from tilefab.io.atomic import atomic_path
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.prepare import PreparedSlab, prepare_slab
from tilefab.pipeline.progress import Progress
from tilefab.sampling import SlabArea

SUFFIX = ".slab.npz"
_KEY_DIGITS = 16


def kept_or_prepared(plan: Plan, progress: Progress, threads: int | None, folder: Path | None) -> PreparedSlab:
    """Slab of a job, from ``folder`` if an interrupted build left it there, else prepared and kept there.

    Parameters
    ----------
    plan, progress, threads
        See `prepare_slab`.
    folder
        Of the maps; ``None``: nothing is kept.
    """
    if folder is None:
        return prepare_slab(plan, progress, threads)
    path = slab_path(plan, folder)
    slab = _load(path, plan.slab_key, progress)
    if slab is not None:
        progress.note("The slab that an interrupted build has prepared is used")
        return slab
    slab = prepare_slab(plan, progress, threads)
    try:
        _save(path, plan.slab_key, slab)
    except OutputError as error:
        progress.note(f"The prepared slab was not kept: {error.message}")
    return slab


def slab_path(plan: Plan, folder: Path) -> Path:
    """Where a job's prepared slab is kept."""
    return folder / f"{plan.slab_key[:_KEY_DIGITS]}{SUFFIX}"


def forget_slabs(folder: Path) -> None:
    """Remove every prepared slab: the map that it was for is there, or can't be made from it."""
    for path in folder.glob(f"*{SUFFIX}"):
        with suppress(OSError):
            path.unlink()


def _save(path: Path, key: str, slab: PreparedSlab) -> None:
    facts = {
        "key": key,
        "slabs": [[area.name, area.base_row, area.base_col, area.rows, area.cols] for area in slab.slabs],
        "log": slab.log,
        "warnings": slab.warnings,
    }
    arrays: dict[str, Any] = {"lab16": slab.lab16, "valid": slab.valid}
    if slab.weights is not None:
        arrays["weights"] = slab.weights
    text = np.frombuffer(json.dumps(facts, ensure_ascii=False).encode(), dtype=np.uint8)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, facts=text, **arrays)


def _load(path: Path, key: str, progress: Progress) -> PreparedSlab | None:
    if not path.exists():
        return None
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            facts = json.loads(file["facts"].tobytes())
            if facts["key"] != key:
                return None
            return PreparedSlab(
                lab16=file["lab16"],
                valid=file["valid"],
                slabs=tuple(SlabArea(str(name), *(int(n) for n in place)) for name, *place in facts["slabs"]),
                log=tuple((str(step), str(what)) for step, what in facts["log"]),
                warnings=tuple(str(text) for text in facts["warnings"]),
                weights=file.get("weights"),
            )
    except (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        progress.note(f"{path}: damaged ({error}); the slab is prepared anew")
        return None
