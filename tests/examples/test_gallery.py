"""The gallery: a page with pictures that its commands make again."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from inspect import signature
from pathlib import Path

import pytest

from supple import SuppleError
from supple.cli import command
from supple.examples.gallery import SCENES, write_gallery
from supple.examples.scenes import Look, Shot, Take
from supple.media import image, video
from supple.render.scene import Scene
from tests import effort


def small(shot: Shot) -> Shot:
    return replace(shot, size=128, smooth=1, turntable=shot.turntable and 6) if isinstance(shot, Look) else shot


# Of all kinds of shots some, and volumes in small pictures; in `make soak`, all as it ships.
CHOSEN = (
    SCENES if effort.ALL else tuple(replace(SCENES[k], shots=tuple(map(small, SCENES[k].shots))) for k in (1, -2, -1))
)
SHOTS = [shot for scene in CHOSEN for shot in scene.shots]
STILLS = [shot for shot in SHOTS if not isinstance(shot, Take | Look)]
TAKES = [shot for shot in SHOTS if isinstance(shot, Take)]
LOOKS = [shot for shot in SHOTS if isinstance(shot, Look)]


@pytest.fixture(scope="module")
def gallery(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("supple.examples.gallery.SCENES", CHOSEN)
        yield write_gallery(tmp_path_factory.mktemp("gallery") / "new" / "demo").parent


class Links(HTMLParser):
    """Collects what a page refers to, and checks that its elements are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.open: list[str] = []
        self.commands: list[str] = []
        self.videos: list[dict[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value for name, value in attrs if name in ("src", "href", "poster") and value]
        if tag not in ("img", "input", "meta"):
            self.open.append(tag)
        if tag == "pre":
            self.commands.append("")
        if tag == "video":
            self.videos.append(dict(attrs))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "pre":
            self.commands[-1] += data


def read_page(gallery: Path) -> tuple[str, Links]:
    text = (gallery / "index.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(text)
    assert not links.open
    return text, links


def test_the_page_needs_nothing_from_elsewhere(gallery: Path) -> None:
    text, links = read_page(gallery)
    assert "http" not in text
    assert "$" not in text
    there = {path.name for path in gallery.iterdir()}
    assert there == {"index.html", "head.nii.gz", "inside.nii.gz", *links.links}
    assert sum(path.stat().st_size for path in gallery.iterdir()) < 20_000_000


def test_every_picture_has_its_views_and_its_certified_error(gallery: Path) -> None:
    text, links = read_page(gallery)
    for shot in STILLS:
        assert {shot.source, f"{shot.name}.jpg", f"{shot.name}-stretch.png", f"{shot.name}-grid.png"} <= set(
            links.links
        )
        size = [
            image.info(gallery / name)[key] for name in (shot.source, f"{shot.name}.jpg") for key in ("width", "height")
        ]
        assert size[:2] == size[2:]
    errors = [float(found) for found in re.findall(r"Error at most ([\d.]+) px", text)]
    assert len(errors) == len(STILLS) + len(TAKES) == len(SHOTS) - len(LOOKS)
    assert all(0 < error <= 0.01 for error in errors)
    assert text.count("supple: warning: ") == 1 + effort.ALL  # one is damped; another carries a stroke's point away


def test_every_clip_plays_beside_what_became_of_it(gallery: Path) -> None:
    _, links = read_page(gallery)
    assert [element["src"] for element in links.videos[:-1]] == [
        n for take in TAKES for n in (take.source, take.target)
    ]
    for element in links.videos[:-1]:
        assert {"muted", "loop", "controls", "playsinline"} <= element.keys()
        facts = video.info(gallery / str(element["src"]))
        assert (facts["container"].split(",")[0], facts["codec"], facts["pixel_format"]) == ("mov", "h264", "yuv420p")
        size = (int(str(element["width"])), int(str(element["height"])))
        assert size == (facts["width"], facts["height"])
        poster = image.info(gallery / str(element["poster"]))
        assert size == (poster["width"], poster["height"])
        assert facts["frames"] == 64
    for take in TAKES:
        assert f"{take.name}-sheet.png" in links.links
        assert (f"{take.name}-slice.png" in links.links) == (take.row is not None)
        before, after = (image.read(gallery / f"{take.name}-{when}.jpg").pixels for when in ("before", "after"))
        x, y, width, height = take.area
        changed = abs(after.astype(int) - before).mean(axis=2)
        assert changed[y : y + height, x : x + width].max() > 60


def test_the_head_is_seen_outside_and_inside_and_from_all_sides(gallery: Path) -> None:
    text, links = read_page(gallery)
    errors = [float(found) for found in re.findall(r"Source points within ([\d.]+) voxels", text)]
    assert len(errors) == len(LOOKS)
    assert all(0 < error <= signature(Scene).parameters["tolerance"].default for error in errors)
    *stills, turn = LOOKS
    for look in stills:
        assert {f"{look.name}.jpg", f"{look.name}-before.jpg"} <= set(links.links)
        before, after = (image.read(gallery / f"{look.name}{when}.jpg").pixels for when in ("-before", ""))
        assert before.shape == after.shape == (look.size, look.size, 3)
        assert before.std() > 40
        assert abs(after.astype(int) - before).mean() > 5
    facts = video.info(gallery / turn.target)
    assert (facts["frames"], facts["width"], facts["height"]) == (turn.turntable, turn.size, turn.size)
    assert (facts["codec"], facts["pixel_format"]) == ("h264", "yuv420p")
    assert links.videos[-1]["src"] == turn.target


@pytest.mark.parametrize("number", range(len(SHOTS)))
def test_the_commands_make_the_pictures(gallery: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    _, links = read_page(gallery)
    monkeypatch.chdir(gallery)
    name = SHOTS[number].target
    before = Path(name).read_bytes()
    arguments = shlex.split(links.commands[number].partition("\nsupple:")[0].replace("\\\n", ""))
    assert arguments[:2] == ["supple", SHOTS[number].verb]
    assert command([*arguments[1:], "--force", "--quiet"]) == 0
    assert Path(name).read_bytes() == before


def test_a_gallery_is_written_anew_and_nothing_else_is_touched(
    gallery: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("supple.examples.gallery.SCENES", (replace(CHOSEN[0], shots=STILLS[:1]),))
    (gallery / "mine.txt").write_text("precious")
    (gallery / STILLS[0].target).write_bytes(b"broken")
    try:
        assert command(["demo", str(gallery), "--force"]) == 0
        said = f"supple: wrote {gallery / STILLS[0].target}\n"
        assert capsys.readouterr() == (f"{gallery / 'index.html'}: open it in a browser\n", said)
        assert (gallery / "mine.txt").read_text() == "precious"
        assert image.info(gallery / STILLS[0].target)["format"] == "JPEG"
    finally:
        (gallery / "mine.txt").unlink()


def test_another_folder_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "index.html").write_text("<html>mine</html>")
    assert command(["demo", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("supple: ")
    assert err.count("\n") == 1
    assert "--force" in err
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    with pytest.raises(SuppleError, match="no folder"):
        write_gallery(tmp_path / "index.html")
    with pytest.raises(SuppleError):
        write_gallery(tmp_path / "index.html" / "deeper")
