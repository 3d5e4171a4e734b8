"""What was found out about a tile, as JSON and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tilefab.inspection.records import (
    ColourFigures,
    Defect,
    DefectKind,
    Grade,
    ImageProblem,
    Recognition,
    TileDimensions,
    TileInspection,
)


def inspection_json(inspection: TileInspection) -> dict[str, Any]:
    """As what `json.dumps` takes; see `inspection_from_json`."""
    return asdict(inspection)


def inspection_text(inspection: TileInspection) -> str:
    """As JSON in one line."""
    return json.dumps(inspection_json(inspection), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def inspection_from_json(text: str) -> TileInspection:
    """What `inspection_text` wrote, anew.

    Raises
    ------
    ValueError
        If it is none.
    """
    try:
        facts = json.loads(text)
        colour, dimensions = facts["colour"], facts["dimensions"]
        return TileInspection(
            recognition=_recognition(facts["recognition"]),
            colour=None if colour is None else ColourFigures(**_with_tuples(colour)),
            dimensions=None if dimensions is None else TileDimensions(**_with_tuples(dimensions)),
            defects=tuple(_defect(entry) for entry in facts["defects"]),
            grade=Grade(facts["grade"]),
            reasons=tuple(facts["reasons"]),
            shift_mm=(facts["shift_mm"][0], facts["shift_mm"][1]),
            turn_deg=facts["turn_deg"],
        )
    except (KeyError, TypeError, IndexError, RecursionError) as error:
        raise ValueError(f"no inspection of a tile: {error!r}") from error


def _recognition(facts: Mapping[str, Any]) -> Recognition:
    corners = tuple((float(x), float(y)) for x, y in facts["corners_px"])
    problem = None if facts["problem"] is None else ImageProblem(facts["problem"])
    return Recognition(**{**facts, "corners_px": corners, "problem": problem})


def _defect(facts: Mapping[str, Any]) -> Defect:
    return Defect(**{**facts, "kind": DefectKind(facts["kind"]), "grade": Grade(facts["grade"])})


def _with_tuples(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in facts.items()}
