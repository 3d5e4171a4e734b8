"""The documents tell the truth about the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from tilefab.cli import main
from tilefab.cli.main import app
from tilefab.config.reference import reference
from tilefab.errors import TilefabError

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md")])


def test_the_reference_of_job_files_is_made_from_the_models():
    assert (ROOT / "docs/job_files.md").read_text() == reference()


def commands() -> set[str]:
    top = typer.main.get_command(app)
    names = set()
    for name, command in top.commands.items():
        inner = getattr(command, "commands", None)
        names |= {f"tilefab {name} {sub}" for sub in inner} if inner else {f"tilefab {name}"}
    return names


def test_every_command_is_documented_and_every_documented_command_exists():
    text = (ROOT / "docs/commands.md").read_text()
    documented = {" ".join(row.split()) for row in re.findall(r"^\| `(tilefab [a-z ]+)", text, re.MULTILINE)}
    assert documented == commands()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_modules_and_functions_named_in_the_docs_exist(page):
    """`room.module.name` and `room/module.py` in code style name something that is there."""
    for path in re.findall(r"`((?:tilefab|sampling|sim)/[a-z_/]+\.py)`", page.read_text()):
        assert (ROOT / path).exists() or (ROOT / "tilefab" / path).exists(), f"{page.name} names {path}"
    rooms = "|".join(p.name for p in (ROOT / "tilefab").iterdir() if p.is_dir() and p.name != "__pycache__")
    for dotted in re.findall(rf"`((?:{rooms})(?:\.[A-Za-z_]+)+)`", page.read_text()):
        assert dotted.endswith((".pdf", ".py")) or exists(dotted), f"{page.name} names {dotted}"


def exists(dotted: str) -> bool:
    import importlib

    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(["tilefab", *parts[:n]]))
        except ModuleNotFoundError:
            continue
        for name in parts[n:]:
            if not hasattr(found, name):
                return False
            found = getattr(found, name)
        return True
    return False


def test_exit_codes_of_the_errors_are_documented():
    text = (ROOT / "docs/conventions.md").read_text()
    codes = {kind.exit_code for kind in TilefabError.__subclasses__()}
    assert len(codes) == len(TilefabError.__subclasses__())
    codes |= {main.REFUSED, main.UNEXPECTED, main.INTERRUPTED}
    for code in codes:
        assert re.search(rf"^\| {code} \|", text, re.MULTILINE)


def test_the_job_in_the_tutorial_is_valid(tmp_path):
    from tilefab.config import load_job
    from tilefab.pipeline import plan_job

    text = re.search(r"```toml\n(.*?)```", (ROOT / "docs/tutorial.md").read_text(), re.DOTALL)
    assert text is not None
    path = tmp_path / "first.toml"
    path.write_text(text.group(1))
    assert plan_job(load_job(path)).tile_px.cols == 354
