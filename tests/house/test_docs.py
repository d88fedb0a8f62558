"""The documentation is true: its Python runs, its links lead somewhere, and its commands exist."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.media import image
from supple.render.transfer import PRESETS, TransferFunction
from tests.children import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
DATA = Path(supple.__file__).parent / "examples" / "data"
OPTION = r"(?<![\w-])--[a-z][a-z-]*"


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def copy_inputs(folder: Path) -> None:
    """Copy files of the kinds that the pages name."""
    names = {
        "photo.jpg": "coffee.jpg",
        "wall.png": "coffee.jpg",
        "portrait.jpg": "astronaut.jpg",
        "clip.mp4": "bunny.mp4",
    }
    names |= dict.fromkeys(("brain.nii.gz", "atlas.nii.gz", "labels.nii.gz"), "brain.nii.gz")
    for name, source in {**names, "head.nii.gz": "head.nii.gz"}.items():
        shutil.copy(DATA / source, folder / name)
    face = np.hypot((np.arange(512) - 225) / 75, (np.arange(512)[:, None] - 115) / 95) < 1
    image.write(folder / "mask.png", np.where(face, 255, 0).astype(np.uint8))
    (folder / "before.csv").write_text("label,x,y\nleft,186,148\nright,265,148\nnose,225,120\n")
    (folder / "after.csv").write_text("label,x,y\nnose,225,120\nleft,190,147\nright,261,147\n")
    (folder / "bow.csv").write_text("x,y\n102,100\n95,200\n93.5,300\n")
    (folder / "line.csv").write_text("x,y\n110,100\n106,200\n102,300\n")
    (folder / "nose.csv").write_text("frame,x,y\n10,330,160\n30,342,153\n")
    for place in ("portraits", "landmarks"):
        (folder / place).mkdir()
    shutil.copy(DATA / "astronaut.jpg", folder / "portraits" / "1.jpg")
    for place in ("landmarks/1.pts", "portrait.pts"):
        shutil.copy(DATA / "astronaut.pts", folder / place)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda page: page.stem)
def test_the_python_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "import supple.torch" in page.read_text(encoding="utf-8") and os.environ.get("SUPPLE_TEST_TORCH") != "1":
        pytest.importorskip("torch")
    copy_inputs(tmp_path)
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), names)


def test_the_commands_of_the_how_to_page_run_without_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    copy_inputs(tmp_path)
    page = (ROOT / "docs" / "how-to.md").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [shlex.split(line) for line in re.findall(r"^supple (.*)$", page, re.MULTILINE)]
    assert len(lines) == 13
    for line in lines:
        assert (command(line), capsys.readouterr().err) == (0, ""), line
        assert Path(line[2]).exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_pictures_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if not target.startswith(("http://", "https://", "#")):
            assert (page.parent / target.partition("#")[0]).exists(), target


def test_the_recipe_that_is_shown_is_one() -> None:
    (text,) = blocks(ROOT / "docs" / "recipes.md", "json")
    recipe = supple.Recipe.from_json(text)
    assert [stroke.scales for stroke in recipe.strokes] == [2, 1]


def test_the_transfer_function_that_is_shown_is_one() -> None:
    (text,) = blocks(ROOT / "docs" / "rendering.md", "json")
    assert TransferFunction.from_json(text) == PRESETS["ct-bone"]


def test_pictures_are_small() -> None:
    sizes = {path: path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()}
    assert sum(size for path, size in sizes.items() if path.suffix != ".webp") < 600_000
    moving = {path for path in sizes if path.name.startswith("window-")}
    assert all(sizes[path] < 1_000_000 for path in moving)
    assert all(size < 60_000 for path, size in sizes.items() if path.suffix == ".webp" and path not in moving)


def test_every_option_that_is_named_exists_and_every_one_that_exists_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    helps = {}
    verbs = (
        "warp",
        "face",
        "track",
        "render",
        "points",
        "plot",
        "info",
        "demo",
        "view",
        "invert",
        "check",
        "compose",
        "convert",
    )
    for verb in ("", *verbs):
        assert command([*verb.split(), "--help"]) == 0
        helps[verb] = set(re.findall(OPTION, capsys.readouterr().out))
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(OPTION, re.sub(r"^(pip|make|git|python) .*$", "", text, flags=re.MULTILINE)))
    known = set().union(*helps.values())
    assert named <= known
    reference = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    assert known - {"--version"} <= set(re.findall(OPTION, reference))
    for line in re.findall(rf"^supple (?:{'|'.join(verbs)}) .*$", text, re.MULTILINE):
        assert set(re.findall(OPTION, line)) <= helps[line.split()[1]], line
