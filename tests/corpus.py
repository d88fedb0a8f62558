"""Outputs of every kind, as hashes: pictures, clips, volumes, renders, points, JSON and errors.

A change of the inner structure leaves all of them as they are, bit for bit: `python tests/corpus.py` says which differ
from those in `corpus.json`, and `--write` puts these in their place. Decoded samples are hashed, not files, whose
bytes depend on their writers.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import pyvips
import SimpleITK as sitk  # noqa: N813
import zarr

import supple
from supple.cli import command

Array = npt.NDArray[Any]
KNOWN = Path(__file__).with_suffix(".json")
DATA = Path(str(files("supple.examples") / "data"))
BEYOND = ("edge", "constant", "reflect")
DRAG = ("--grab", "200,120:214,131", "--radius", "40")


def noise(*shape: int, dtype: str = "uint8") -> Array:
    """Return smooth noise over most of a type's range."""
    x = np.random.default_rng(shape[0]).random(shape)
    for axis in range(2):
        x = 0.5 * x + 0.25 * (np.roll(x, 1, axis) + np.roll(x, -1, axis))
    if dtype == "bool":
        return x > 0.5
    return ((x - 0.5) * 2).astype(dtype) if dtype[0] == "f" else (x * np.iinfo(dtype).max).astype(dtype)


def bent(*shape: int, **how: Any) -> supple.Deformation:
    """Return a deformation of a few strokes, some beside the edge."""
    d = supple.Deformation(shape, **how)
    n, size = len(shape), np.array(shape[::-1], float)
    for at, by, radius in (((0.4, 0.5, 0.5), (0.2, 0.1, 0.1), 0.2), ((0.05, 0.9, 0.3), (0.05, -0.2, 0.1), 0.3)):
        d = d.grab(at[:n] * size, by=by[:n] * size, radius=radius * size[0])
    return d


def arrays() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield what `Deformation` gives of arrays and points."""
    kinds = {"uint8": 3, "uint16": 4, "int16": 1, "uint32": 2, "float32": 3, "float64": 1, "float16": 4, "bool": 1}
    for dtype, channels in kinds.items():
        source = noise(60, 83, channels, dtype=dtype)
        for name in ("auto", "cubic", "linear", "nearest"):
            if name != "nearest" or channels != 2:
                yield f"image {dtype} {name}", lambda s=source, f=name: bent(60, 83).warp(s, filter=f)  # type: ignore[misc]
    photo = noise(60, 83, 4)
    for outside in ("edge", "constant", "reflect"):
        yield (
            f"image {outside}",
            lambda o=outside: bent(60, 83, border=None).warp(photo, outside=o, fill=(9, 8, 7, 6)),  # type: ignore[misc]
        )
    yield "image linear light", lambda: bent(60, 83).warp(photo, linear_light=True)
    yield "image without alpha", lambda: bent(60, 83).warp(photo, alpha=False)
    yield "image clamp", lambda: bent(60, 83).warp(noise(60, 83, dtype="float32"), clamp=True)
    yield "image sine", lambda: bent(60, 83, border=12, border_profile="sine", on_fold="damp").warp(photo)
    yield "batch", lambda: np.stack(supple.warp_batch([photo, photo[::-1]], [bent(60, 83), bent(60, 83, border=9)]))
    clip = noise(7, 40, 50, 3)
    for between in ("linear", "cubic", "nearest"):
        how: dict[str, Any] = {"between": between, "filter": "nearest" if between == "nearest" else "auto"}
        yield f"frames {between}", lambda h=how: bent(7, 40, 50, time=True).warp(clip, **h)  # type: ignore[misc]
    yield "frames time filter", lambda: bent(7, 40, 50).warp(clip, time_filter=True)
    for dtype, name, outside in itertools.product(("u1", "u2", "f4", "f8"), ("auto", "linear"), BEYOND):
        free, source = bent(40, 53, border=None), noise(40, 53, 3, dtype=dtype)
        yield f"free image {dtype} {name} {outside}", partial(free.warp, source, filter=name, outside=outside)
    for between, outside in itertools.product(("linear", "cubic"), BEYOND):
        free = bent(7, 40, 50, border=None, time=True)
        yield f"free frames {between} {outside}", partial(free.warp, clip, between=between, outside=outside)
    for words in ("u1 nearest edge", "i2 linear reflect", "f4 auto constant", "f4 linear edge", "f8 cubic reflect"):
        dtype, name, outside = words.split()
        options = {"between": "nearest" if name == "nearest" else "linear", "filter": name, "outside": outside}
        free, source = bent(12, 30, 40, border=None), noise(12, 30, 40, dtype=dtype)
        yield f"free volume {words}", partial(free.warp, source, **options)
    plain, mask = supple.Deformation((60, 83)), np.zeros((60, 83), bool)
    mask[:, 50:] = True
    frozen = supple.Deformation((60, 83), freeze=mask)
    brushes = {
        "twist": plain.twist((40, 30), angle=40, radius=12),
        "scale": plain.scale((40, 30), factor=1.6, radius=12),
        "pinch": plain.pinch((40, 30), factor=0.6, radius=12),
        "pull": plain.pull([(20, 20), (50, 30)], to=[(26, 22), (47, 35)], pins=[(35, 25)], radius=15),
        "path": plain.grab((20, 20), path=[(30, 22), (35, 30)], to=(50, 34), radius=10),
        "freeze": frozen.grab((40, 30), by=(8, 3), radius=20),
        "scales": plain.grab((40, 30), by=(8, 3), radius=20, scales=3, reach=None),
        "shrink": plain.scale((40, 30), factor=0.3, radius=20),
        "affine": bent(60, 83).affine([[0.9, 0.2, 3], [-0.2, 0.9, 9], [0, 0, 1]]),
        "keystone": bent(60, 83).straighten(keystone=[(9, 5), (70, 11), (78, 52), (3, 55)], rotate=-4, fit="keep"),
    }
    for name, made in brushes.items():
        yield f"image {name}", lambda d=made: d.warp(photo)  # type: ignore[misc]
    waves = np.moveaxis(np.indices((30, 42))[::-1], 0, -1)
    grid = supple.Grid((30, 42), spacing=(2, 2))
    linear, cubic = (supple.Field(3 * np.sin(waves / 4), grid, order) for order in ("linear", "cubic"))
    for name, field in (("linear", linear), ("cubic", cubic)):
        yield f"field {name} inverted", lambda f=field: [(i := f.invert()).field.values, i.error]  # type: ignore[misc]
        yield f"field {name} checked", lambda f=field: repr(f.check())  # type: ignore[misc]
        yield f"field {name} warp", lambda f=field: bent(60, 83).field(f).warp(photo)  # type: ignore[misc]
        yield f"field {name} back", lambda f=field: plain.field(f, inverse=True).warp(photo, filter="linear")  # type: ignore[misc]
    yield "fields composed", lambda: linear.compose(cubic).values
    volume = noise(20, 30, 40, dtype="int16")
    yield "volume", lambda: bent(20, 30, 40, spacing=(1, 1, 2.5)).warp(volume, between="cubic", time_filter=True)
    points = np.random.default_rng(1).uniform(-5, 70, (200, 2))
    for name in ("forward", "jacobian"):
        yield name, lambda n=name: getattr(bent(60, 83), n)(points)  # type: ignore[misc]
    yield "inverse", lambda: np.column_stack([(f := bent(60, 83).inverse(points)).points, f.converged])
    yield "inverse map", lambda: bent(60, 83).inverse_map()
    yield "recipe", lambda: bent(60, 83).recipe.to_json()
    yield "report", lambda: repr(bent(60, 83).report())
    yield "arrivals", lambda: repr(bent(60, 83, on_fold="damp").arrivals)


PICTURES: dict[str, tuple[str, ...]] = {
    "astronaut.png": (),
    "linear.jpg": ("--filter", "linear", "--quality", "91"),
    "fill.png": ("--outside", "constant", "--fill", "9", "--border", "none"),
    "flow.webp": ("--lossless", "--reach", "none"),
    "light.tif": ("--linear-light",),
}
CLIPS: dict[str, tuple[str, ...]] = {
    "space.mkv": DRAG,
    "time.mkv": ("--grab", "320,180,20:320,180,26", "--radius", "90", "--time-scale", "4", "--between", "linear"),
    "moving.mkv": (*DRAG, "--track", "track.csv"),
    "frames%03d.png": ("--grab", "320,180,20:330,180,26", "--radius", "60", "--between", "linear"),
    "small.gif": DRAG,
}
VOLUMES: dict[str, tuple[str, ...]] = {
    "voxels.nii.gz": ("--grab", "60,60,60:66,60,63", "--radius", "30"),
    "world.nrrd": ("--grab", "0,0,0:8,0,6", "--radius", "40", "--world"),
    "labels.nii.gz": ("--grab", "60,60,60:66,60,63", "--radius", "30", "--labels"),
}
RENDERS: dict[str, tuple[str, ...]] = {
    "": (),
    "bent": VOLUMES["voxels.nii.gz"],
    "exact": (*VOLUMES["voxels.nii.gz"], "--mode", "exact"),
    "brain": ("--transfer", "mr-brain"),
    "buffered": (*VOLUMES["voxels.nii.gz"], "--mode", "buffered"),
    "projection": ("--projection", "maximum"),
}
ERRORS: dict[str, tuple[str, ...]] = {
    "no file": ("warp", "missing.png", "out.png", *DRAG),
    "no stroke": ("warp", "in.jpg", "out.png"),
    "no radius": ("warp", "in.jpg", "out.png", "--grab", "1,2:3,4"),
    "bad option": ("warp", "in.jpg", "out.png", *DRAG, "--fliter", "auto"),
    "bad value": ("warp", "in.jpg", "out.png", *DRAG, "--tolerance", "-1"),
    "bad format": ("warp", "in.jpg", "out.xyz", *DRAG),
    "outside": ("warp", "in.jpg", "out.png", "--grab", "2000,20:2010,20", "--radius", "20"),
    "folds": ("warp", "in.jpg", "out.png", "--grab", "200,200:400,200", "--radius", "40", "--on-fold", "error"),
    "old filter": ("warp", "in.jpg", "out.png", *DRAG, "--filter", "ewa"),
    "exists": ("warp", "in.jpg", "in.jpg", *DRAG),
    "fill": ("warp", "in.jpg", "out.png", *DRAG, "--fill", "3"),
    "world": ("warp", "in.jpg", "out.png", *DRAG, "--world"),
    "no command": ("bend", "in.jpg"),
    "empty recipe": ("warp", "in.jpg", "out.png", "--recipe", "empty.json"),
    "GPU": ("warp", "in.jpg", "out.png", *DRAG, "--device", "gpu"),
    "two numbers": ("warp", "in.jpg", "out.png", "--grab", "1,2:3", "--radius", "9"),
    "radius 0": ("warp", "in.jpg", "out.png", "--grab", "1,2:3,4", "--radius", "0"),
    "poisson": ("warp", "in.jpg", "out.png", *DRAG, "--poisson", "0.6"),
    "freeze": ("warp", "in.jpg", "out.png", "--freeze", "mask.png", *DRAG),
    "render": ("render", "in.jpg", "out.png"),
    "plot": ("plot", "in.jpg", "out.png", *DRAG, "--what", "nothing"),
    "points": ("points", "points.csv", "moved.csv", *DRAG),
    "info": ("info", "missing.mp4"),
    "invert": ("invert", "in.jpg", "out.nii.gz"),
    "convert": ("convert", "in.jpg", "out.xyz", "--from", "itk", "--to", "nothing"),
    "plan": ("plan", "in.jpg"),
    "one name": ("warp", "in.jpg"),
}
TOLD: dict[str, tuple[str, ...]] = {
    "info picture": ("info", "in.jpg", "--json"),
    "info volume": ("info", "head.nii.gz", "--json"),
    "info clip": ("info", "bunny.mp4"),
    "json": ("warp", "in.jpg", "told.png", *DRAG, "--json"),
    "damped": ("warp", "in.jpg", "damped.png", "--grab", "200,200:400,200", "--radius", "40", "--on-fold", "damp"),
    "help": ("warp", "--help"),
    "commands": ("--help",),
    "info recipe": ("info", "recipe.json"),
    "info field": ("info", "field.nii.gz", "--json"),
    "json clip": ("warp", "bunny.mp4", "told.mkv", *DRAG, "--codec", "ffv1", "--json"),
    "json volume": ("warp", "head.nii.gz", "told.nii.gz", *VOLUMES["voxels.nii.gz"], "--json"),
    "json render": ("render", "head.nii.gz", "told.png", "--size", "60x50", "--json", "--force"),
    "check": ("check", "field.nii.gz"),
    "invert json": ("invert", "field.nii.gz", "back.nii.gz", "--json"),
    "compose": ("compose", "field.nii.gz", "back.nii.gz", "--out", "both.nii.gz"),
    "convert json": ("convert", "field.nii.gz", "field.h5", "--json"),
}


def decoded(path: Path) -> list[Array]:
    """Return what a file holds, by its library."""
    name = path.name
    if name.endswith((".nii.gz", ".nrrd")):
        image = sitk.ReadImage(str(path))
        geometry = [*image.GetOrigin(), *image.GetSpacing(), *image.GetDirection()]
        return [np.round(geometry, 9), sitk.GetArrayFromImage(image)]
    if name.endswith((".mkv", ".gif")):
        with av.open(str(path)) as container:
            return [frame.to_ndarray() for frame in container.decode(video=0)]
    return [pyvips.Image.new_from_file(str(path), revalidate=True).numpy()]  # files of one name follow one another


def stores(name: str) -> list[Array]:
    """Return all levels of an OME-Zarr image."""
    group = zarr.open_group(name, mode="r")
    return [np.asarray(group[key]) for key in sorted(group.array_keys())]


def hashed(value: Any) -> str:
    """Return a short hash of an array, with its type and shape, or a text, or a list of these."""
    made = hashlib.sha256()
    for part in value if isinstance(value, list) else [value]:
        if isinstance(part, np.ndarray):
            made.update(f"{part.dtype.str} {part.shape}".encode())
            made.update(np.ascontiguousarray(part).tobytes())
        else:
            made.update(str(part).encode())
    return made.hexdigest()[:16]


def said(arguments: tuple[str, ...]) -> str:
    """Return a command's status and what it says, without times and versions."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = command(arguments)
    text = f"{status}\n{out.getvalue()}\n{err.getvalue()}"
    return re.sub(r'("seconds": |took )[\d.e-]+', r"\1…", text)


def commands() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield what the command makes and says, in a folder with the files that it takes."""

    def made(source: str, target: str, *options: str) -> Any:
        text = said(("warp", source, target, *options))
        assert text.startswith("0\n"), text
        paths = sorted(Path().glob(target.replace("%03d", "*")))
        return [text, *(part for path in paths for part in decoded(path))]

    for target, options in PICTURES.items():
        yield f"warp {target}", lambda t=target, o=options: made("in.jpg", t, *DRAG, *o)  # type: ignore[misc]
    for target, options in CLIPS.items():
        codec = ("--codec", "ffv1") if target.endswith(".mkv") else ()
        yield f"warp {target}", lambda t=target, o=options + codec: made("bunny.mp4", t, *o)  # type: ignore[misc]
    for target, options in VOLUMES.items():
        source = "few.nii.gz" if "--labels" in options else "head.nii.gz"
        yield f"warp {target}", lambda s=source, t=target, o=options: made(s, t, *o)  # type: ignore[misc]
    render = ("render", "head.nii.gz", "head.png", "--size", "120x100", "--azimuth", "30", "--force")
    for name, options in RENDERS.items():
        yield f"render {name}".strip(), lambda o=options: [said((*render, *o)), *decoded(Path("head.png"))]  # type: ignore[misc]
    stored = ("warp", "head.nii.gz", "head.zarr", *VOLUMES["voxels.nii.gz"])
    yield "store", lambda: [said(stored), *stores("head.zarr")]
    again = ("warp", "head.zarr", "again.zarr", *VOLUMES["world.nrrd"], "--filter", "linear")
    yield "store of a store", lambda: [said(again), *stores("again.zarr")]
    field = ("--grab", "60,60,60:66,60,63", "--radius", "30", "--save-field", "field.nii.gz")
    yield "field", lambda: [said(("warp", "head.nii.gz", "t.nii.gz", *field)), *decoded(Path("field.nii.gz"))]
    points = ("points", "points.csv", "moved.csv", "--on", "in.jpg", *DRAG)
    yield "points", lambda: [said(points), Path("moved.csv").read_text()]
    recipe = ("warp", "in.jpg", "with.png", *DRAG, "--save-recipe", "recipe.json")
    yield "recipe file", lambda: [said(recipe), Path("recipe.json").read_text()]
    for name, arguments in {**ERRORS, **TOLD}.items():
        yield f"says {name}", lambda a=arguments: said(a)  # type: ignore[misc]


def found(only: str = "") -> dict[str, str]:
    """Return the hash of every output whose name contains a text."""
    made = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shutil.copy(DATA / "astronaut.jpg", "in.jpg")
        for name in ("bunny.mp4", "head.nii.gz"):
            shutil.copy(DATA / name, name)
        head = sitk.ReadImage("head.nii.gz")
        sitk.WriteImage(sitk.Cast(sitk.Cast(head, sitk.sitkInt32) / 60, sitk.sitkUInt8), "few.nii.gz")
        Path("points.csv").write_text("x,y\n200,120\n20.5,300\n")
        Path("track.csv").write_text("frame,x,y\n0,200,120\n20,230,120\n63,330,160\n")
        Path("empty.json").write_text("{}")
        for name, make in (*arrays(), *commands()):
            if only in name:
                made[name] = hashed(make())
    return made


if __name__ == "__main__":
    now = found()
    if "--write" in sys.argv:
        KNOWN.write_text(json.dumps(now, indent=1) + "\n")
    known = json.loads(KNOWN.read_text())
    wrong = sorted(name for name in now.keys() | known.keys() if now.get(name) != known.get(name))
    print(f"{len(now)} outputs, {len(wrong)} of them differ from those known")
    sys.exit("\n".join(wrong) or 0)
