"""Images in stores, written from the specification, and what tests do with outputs like them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zarr

from supple.media.stores.image import StoredImage, open_image
from supple.media.stores.levels import reduced
from supple.media.stores.target import Target
from tests.children import SOURCE

Array = npt.NDArray[Any]
Json = dict[str, Any]
RNG = np.random.default_rng(0)
KINDS = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
VERSIONS = [(2, "0.4"), (3, "0.5"), (3, "0.6")]


def described_axes(names: str, unit: str | None = "micrometer") -> list[Json]:
    told = {"time": {"unit": "second"}, "channel": {}, "space": {"unit": unit} if unit else {}}
    return [{"name": name, "type": KINDS[name], **told[KINDS[name]]} for name in names]


def metadata(version: str, axes: list[Json], levels: list[tuple[list[float], list[float]]], **more: Any) -> Json:
    """Return the attributes of an image of one of the versions, written from the specification."""
    steps = [
        [{"type": "scale", "scale": scale}, {"type": "translation", "translation": offset}] for scale, offset in levels
    ]
    if version == "0.6":
        image: Json = {
            "name": "cells",
            "coordinateSystems": [{"name": "physical", "axes": axes}],
            "datasets": [
                {
                    "path": str(k),
                    "coordinateTransformations": [
                        {
                            "type": "sequence",
                            "transformations": one,
                            "input": {"path": str(k)},
                            "output": {"name": "physical"},
                        }
                    ],
                }
                for k, one in enumerate(steps)
            ],
        }
    else:
        image = {
            "name": "cells",
            "axes": axes,
            "datasets": [{"path": str(k), "coordinateTransformations": one} for k, one in enumerate(steps)],
        }
    if version == "0.4":
        return {"multiscales": [{"version": "0.4", **image}], **more}
    return {"ome": {"version": version, "multiscales": [image], **more}}


def image(
    address: str | Path,
    form: int,
    version: str,
    *,
    names: str = "tczyx",
    shape: tuple[int, ...] = (2, 2, 6, 19, 30),
    chunks: tuple[int, ...] = (1, 2, 4, 8, 16),
    shards: tuple[int, ...] | None = None,
    count: int = 3,
    centred: bool = True,
    dtype: str = "uint16",
    unit: str | None = "micrometer",
    scale: float | None = None,
) -> list[Array]:
    """Write an image whose levels are half as large in the plane, and return them."""
    steps = [scale or {"t": 0.5, "c": 1.0, "z": 2.0, "y": 0.5, "x": 0.25}[name] for name in names]
    levels, arrays = [], []
    values = RNG.integers(0, 2**16, shape).astype(dtype)
    for k in range(count):
        factor = [2**k if name in "yx" else 1 for name in names]
        offset = [(f - 1) / 2 * s if centred else 0.0 for f, s in zip(factor, steps, strict=True)]
        levels.append(([f * s for f, s in zip(factor, steps, strict=True)], offset))
        arrays.append(values if k == 0 else reduced(arrays[-1], [2 if name in "yx" else 1 for name in names], "mean"))
    attributes = metadata(version, described_axes(names, unit), levels, omero={"channels": [{"color": "FFFFFF"}]})
    group = zarr.create_group(str(address), zarr_format=form, attributes=attributes)
    for k, one in enumerate(arrays):
        made = group.create_array(
            str(k),
            shape=one.shape,
            dtype=one.dtype,
            chunks=chunks,
            shards=shards,
            fill_value=7,
            **(
                {"dimension_names": list(names)}
                if form == 3
                else {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
            ),
        )
        made[...] = one
    return arrays


def small(path: str | Path) -> tuple[Array, StoredImage]:
    (values,) = image(path, 3, "0.5", names="zyx", shape=(4, 9, 9), chunks=(2, 4, 4), count=1)
    return values, open_image(path)


def boxes(target: Target, level: int) -> list[list[tuple[int, int]]]:
    """Return all blocks of a level."""
    shape = target.arrays[level].shape
    axes = [
        [(a, min(a + n, size)) for a in range(0, size, n)] for size, n in zip(shape, target.blocks[level], strict=True)
    ]
    return [list(box) for box in product(*axes)]


def whole(target: Target, level: int = 0) -> list[tuple[int, int]]:
    return [(0, size) for size in target.arrays[level].shape]


def part(array: Any, box: list[tuple[int, int]]) -> Array:
    return np.asarray(array[tuple(slice(a, b) for a, b in box)])


def fill(target: Target, values: Array) -> None:
    """Write all levels, block by block."""
    for level in range(len(target.arrays)):
        for box in boxes(target, level):
            if level == 0:
                target.write(0, box, part(values, box))
            else:
                target.reduce(level, box)


def files(path: Path) -> dict[str, bytes]:
    return {str(one.relative_to(path)): one.read_bytes() for one in sorted(path.rglob("*")) if one.is_file()}


def plain_json(value: Any) -> Any:
    return json.loads(json.dumps(value))


def exact(values: Array, factors: list[int]) -> Array:
    """Means by whole numbers of Python, or in float64, one after the other."""
    shape = [-(-n // f) for n, f in zip(values.shape, factors, strict=True)]
    made = np.empty(shape, values.dtype)
    for place in np.ndindex(*shape):
        group = values[tuple(slice(i * f, (i + 1) * f) for i, f in zip(place, factors, strict=True))]
        if values.dtype.kind == "f":
            made[place] = group.astype(np.float64).mean()
        else:
            total, n = sum(int(x) for x in group.ravel()), group.size
            low, rest = divmod(total, n)
            made[place] = low + (2 * rest > n or (2 * rest == n and low % 2 == 1))
    return made


def child(code: str, *arguments: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": SOURCE}
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(command, env=environment, text=True, **pipes)
