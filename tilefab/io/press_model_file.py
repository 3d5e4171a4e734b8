"""A fitted press model kept in a run's folder: fitting takes longer than all that is made of it."""

from __future__ import annotations

import io
import json
import zipfile
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tilefab.colour.press_model import ModelErrors, PressArrays, PressModel
from tilefab.io.atomic import atomic_write_bytes

SUFFIX = ".tfpress"
_VERSION = 1
_NUMBERS = ("factor", "growth")
_ARRAYS = tuple(name for name in PressArrays._fields if name not in _NUMBERS)
_OF_ERRORS = "errors_"
_MOST_BYTES = 64 << 20


def save_press_model(path: Path, model: PressModel, key: str, notes: dict[str, Any]) -> None:
    """Keep a model, in one piece.

    Parameters
    ----------
    path
        File to write.
    model
        The model.
    key
        Hash of all that it depends on.
    notes
        What else is to be kept with it, as JSON holds it.

    Raises
    ------
    OutputError
        If it can't be written.
    """
    errors = {one.name: getattr(model.errors, one.name) for one in fields(ModelErrors)}
    long = {name: value for name, value in errors.items() if isinstance(value, np.ndarray)}
    head = {
        "version": _VERSION,
        "key": key,
        "notes": notes,
        "max_total": model.max_total,
        "numbers": {name: float(getattr(model.arrays, name)) for name in _NUMBERS},
        "errors": {name: value for name, value in errors.items() if name not in long},
    }
    arrays = {name: np.asarray(getattr(model.arrays, name)) for name in _ARRAYS}
    arrays |= {_OF_ERRORS + name: value for name, value in long.items()}
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.save(member, array, allow_pickle=False)
    atomic_write_bytes(path, stream.getvalue())


def load_press_model(path: Path, key: str) -> tuple[PressModel, dict[str, Any]] | None:
    """A model kept under a key, with its notes; None where there is none, or it is damaged or of another key."""
    with suppress(OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, RecursionError):
        if path.stat().st_size > _MOST_BYTES:
            return None
        # From memory: where the file is no archive, NumPy leaves it open.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            head = json.loads(file["head"].tobytes())
            if head["version"] != _VERSION or head["key"] != key:
                return None
            found = {name: np.ascontiguousarray(file[name], dtype=np.float64) for name in _ARRAYS}
            long = {name.removeprefix(_OF_ERRORS): file[name] for name in file.files if name.startswith(_OF_ERRORS)}
        parts: dict[str, Any] = {**found, **{name: float(head["numbers"][name]) for name in _NUMBERS}}
        arrays = PressArrays(**parts)
        errors = ModelErrors(**head["errors"], **long)
        if _fit_together(arrays):
            return PressModel(arrays, float(head["max_total"]), errors), dict(head["notes"])
    return None


def _fit_together(arrays: PressArrays) -> bool:
    """Whether shapes are those that kernels take on trust."""
    inks = len(arrays.reach) if arrays.reach.ndim == 1 else 0
    patches = arrays.centres.shape[-1] if arrays.centres.ndim == 2 else 0
    shapes = {
        "curves": (inks, 3, 3),
        "primaries": (2**inks, 3),
        "centres": (inks, patches),
        "strengths": (3, patches),
        "reach": (inks,),
        "weight": (inks,),
        "gain": (inks,),
        "bend": (inks,),
    }
    return 1 <= inks <= 8 and all(
        getattr(arrays, name).shape == shape and bool(np.isfinite(getattr(arrays, name)).all())
        for name, shape in shapes.items()
    )
