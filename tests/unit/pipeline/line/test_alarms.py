"""The catalogue of alarms against the code that raises them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import tilefab
from tilefab.pipeline.line.alarms import ALARMS, FROM_INSPECTION, GENERAL, alarm_table, alarm_text

ROOT = Path(tilefab.__file__).parent
SOURCES = [*sorted((ROOT / "pipeline" / "line").glob("*.py")), *sorted((ROOT / "control").glob("line_*.py"))]
RAISERS = {"doubt", "fault", "warn", "Doubt", "Fault", "Warn", "_hold_with", "_raise"}
DEVICES = ("plc", "printer", "kiln", "gauge")
CODE = re.compile(r"[a-z]+(_[a-z]+)*")


def _codes_in(tree: ast.AST) -> Iterator[str]:
    """Codes of alarms raised in a module; where a variable is given, all that it may be in that function."""
    for place in ast.walk(tree):
        if isinstance(place, ast.keyword) and place.arg == "code" and isinstance(place.value, ast.Constant):
            yield str(place.value.value)
        elif isinstance(place, ast.AnnAssign) and ast.unparse(place.target) == "code" and place.value is not None:
            yield str(ast.literal_eval(place.value))
        elif isinstance(place, ast.FunctionDef | ast.AsyncFunctionDef):
            for call in ast.walk(place):
                if isinstance(call, ast.Call):
                    yield from _codes_of(call, place)


def _codes_of(call: ast.Call, function: ast.AST) -> Iterator[str]:
    name = _name(call.func)
    # Also where it is handed on to be called: call_soon(self.doubt, "code", ...).
    handed = next((n for n, argument in enumerate(call.args) if _name(argument) in RAISERS), None)
    if name in RAISERS:
        code = call.args[1 if name.startswith("_") else 0]
    elif handed is not None and handed + 1 < len(call.args):
        code = call.args[handed + 1]
    else:
        return
    if isinstance(code, ast.Constant):
        yield str(code.value)
    elif isinstance(code, ast.JoinedStr):
        assert ast.unparse(code) in ("f'{event.name}_lost'", "f'{name}_lost'")
        yield from (f"{device}_lost" for device in DEVICES)
    elif isinstance(code, ast.Name):
        for place in ast.walk(function):
            items = place.elts if isinstance(place, ast.Tuple) else place.keys if isinstance(place, ast.Dict) else []
            for item in items:
                if isinstance(item, ast.Constant) and isinstance(item.value, str) and CODE.fullmatch(item.value):
                    yield item.value


def _name(expression: ast.AST) -> str:
    return expression.attr if isinstance(expression, ast.Attribute) else getattr(expression, "id", "")


def test_every_alarm_that_the_code_raises_is_explained() -> None:
    raised = {code for source in SOURCES for code in _codes_in(ast.parse(source.read_text(encoding="utf-8")))}
    assert len(raised) > 30, "the search finds what it should"
    assert {"jam", "e_stop", "plc_lost", "faces_in_doubt", "underrun", "journal"} <= raised
    assert raised - set(ALARMS) == set(), "say in alarms.py what these mean"
    assert set(ALARMS) - raised == FROM_INSPECTION, "nothing raises these"


@pytest.mark.parametrize("code", ALARMS)
def test_each_says_what_it_means_and_what_to_do(code: str) -> None:
    text = ALARMS[code]
    assert CODE.fullmatch(code)
    assert len(text.title) <= 50
    for sentence in (text.meaning, text.what_to_do):
        assert sentence[0].isupper() or sentence[0] == "`"
        assert sentence.endswith(".")
        assert "  " not in sentence
        assert "|" not in sentence


def test_an_unknown_alarm_gets_a_general_text() -> None:
    assert alarm_text("never_heard_of") is GENERAL
    assert alarm_text("jam") is ALARMS["jam"]


def test_the_operators_page_has_the_table_of_the_code() -> None:
    page = (ROOT.parent / "docs" / "line_operator.md").read_text(encoding="utf-8")
    assert alarm_table() in page, (
        "copy it there: python -c 'from tilefab.pipeline.line.alarms import *; print(alarm_table())'"
    )
