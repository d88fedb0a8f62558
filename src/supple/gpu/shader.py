"""Shaders: WGSL files with includes, constants of the host and resources by name; how they are compiled and run."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.gpu.device import Gpu
from supple.gpu.memory import blank, owned, upload

Array = npt.NDArray[Any]

CELL = 16  # pixels of the window from node to node
BLOCK = 16  # voxels along the side of a block of a buffer
ROW = 2048  # entries of a transfer function in a layer of its texture
PLAIN, EXACT = 0, 1  # how rays find source points
FAR = 3e38  # in place of a depth, where there is none
_NAMES = ("CELL", "BLOCK", "ROW", "PLAIN", "EXACT", "FAR")
_SHARED: dict[str, float] = _core.constants | {"BRICK": _core.BRICK} | {name: globals()[name] for name in _NAMES}

MOST_GROUPS = 65535
PART = 0.25  # seconds that a part of some work takes
TURNS = 4  # iterations of a loop that tests whether loops run to their end (turns.wgsl)

_USE = re.compile(r"^#use (.+)\n", re.MULTILINE)
_RESOURCE = re.compile(r"^(?:@group.*\) )?var(?:<(uniform|storage, \w+)>)? (\w+): ([^;]+);", re.MULTILINE)
_FIELD = re.compile(r"(\w+): (\w+),")
_TYPES: dict[str, tuple[Any, int]] = {  # with the alignment
    "f32": ("f4", 4),
    "u32": ("u4", 4),
    "vec2f": (("f4", 2), 8),
    "vec2u": (("u4", 2), 8),
    "vec3f": (("f4", 3), 16),
    "vec3u": (("u4", 3), 16),
    "vec4f": (("f4", 4), 16),
    "mat3x3f": (("f4", (3, 4)), 16),
}


@cache
def source(name: str, voxel: str = "f32") -> str:
    """Return the source of a shader file, with its includes and the constants that it shares with the host.

    ``voxel`` is the type of a volume's samples: f32, i32 or u32.
    """
    return template(_text(name), voxel)


def _text(name: str) -> str:
    return (resources.files("supple.gpu") / "shaders" / f"{name}.wgsl").read_text(encoding="utf-8")


def template(text: str, voxel: str = "f32") -> str:
    """Return a shader's text with its includes, with bindings for its resources, and with the host's constants."""
    texts = {"": text}
    waiting = [text]
    while waiting:
        for name in " ".join(_USE.findall(waiting.pop())).split():
            if name not in texts:
                texts[name] = _text(name)
                waiting.append(texts[name])
    constants = [
        f"const {name} = {value}u;" if isinstance(value, int) else f"const {name} = {float(np.float32(value))!r};"
        for name, value in _SHARED.items()
    ]
    count = itertools.count()
    whole = _USE.sub("", "\n".join([*constants, *texts.values()])).replace("VOXEL", voxel)
    return _RESOURCE.sub(lambda found: f"@group(0) @binding({next(count)}) {found[0]}", whole)


def structure(text: str, name: str) -> np.dtype[np.void]:
    """Return the memory layout of a struct in a shader's text, as a dtype."""
    found = re.search(rf"struct {name} \{{(.*?)\n\}}", text, re.DOTALL)
    assert found, name
    offsets, formats, names, end, widest = [], [], [], 0, 4
    for field, kind in _FIELD.findall(re.sub("//.*", "", found[1])):
        made, aligned = _TYPES[kind]
        offsets.append(-(-end // aligned) * aligned)
        formats.append(made)
        names.append(field)
        end, widest = offsets[-1] + np.dtype(made).itemsize, max(widest, aligned)
    size = -(-end // widest) * widest
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


@dataclass(frozen=True, slots=True, eq=False)
class Module:
    """A shader on a device, with the layout of its resources."""

    gpu: Gpu
    code: Any
    layout: Any
    kinds: dict[str, str]  # the kind of each resource, by its name, in the order of their numbers
    settings: np.dtype[np.void]  # the layout of its ``Settings``

    def values(self, settings: Mapping[str, Any]) -> npt.NDArray[np.void]:
        """Return settings as the shader reads them; those that are not given are 0."""
        values = np.zeros(1, self.settings)
        for name, value in settings.items():
            values[name] = value
        return values

    def group(self, given: Mapping[str, Any]) -> Any:
        """Return the bind group of buffers, texture views and samplers by name; None stands for an empty resource."""
        entries = []
        for k, (name, kind) in enumerate(self.kinds.items()):
            resource = given[name] if given[name] is not None else blank(self.gpu, kind)
            buffer = kind == "uniform" or kind.startswith("storage")
            entries.append({"binding": k, "resource": {"buffer": resource} if buffer else resource})
        return self.gpu.device.create_bind_group(layout=self.layout, entries=entries)


def module(gpu: Gpu, text: str) -> Module:
    """Return the shader of some text, compiled once on a device."""
    if text not in gpu.pipelines:
        kinds = {name: space or kind for space, name, kind in _RESOURCE.findall(text)}
        stage, filtered = "FRAGMENT" if "@fragment" in text else "COMPUTE", "sampler" in kinds.values()
        layout = gpu.device.create_bind_group_layout(
            entries=[
                {"binding": k, "visibility": stage} | _entry(kind, filtered) for k, kind in enumerate(kinds.values())
            ]
        )
        code = gpu.device.create_shader_module(code=text)
        gpu.pipelines[text] = Module(gpu, code, layout, kinds, structure(text, "Settings"))
    made: Module = gpu.pipelines[text]
    return made


def _entry(kind: str, filtered: bool) -> dict[str, Any]:
    """Return the entry of a resource in the layout of a bind group."""
    if kind == "uniform":
        return {"buffer": {"type": "uniform"}}
    if kind.startswith("storage"):
        return {"buffer": {"type": "read-only-storage" if kind.endswith("read") else "storage"}}
    if kind == "sampler":
        return {"sampler": {}}
    dimension, texel = re.findall(r"(\dd)<(\w+)", kind)[0]
    if kind.startswith("texture_storage"):
        return {"storage_texture": {"access": "write-only", "format": texel, "view_dimension": dimension}}
    sampled = {"f32": "float" if filtered else "unfilterable-float", "u32": "uint", "i32": "sint"}[texel]
    return {"texture": {"sample_type": sampled, "view_dimension": dimension}}


@dataclass(frozen=True, slots=True, eq=False)
class Shader:
    """An entry point of a compute shader, compiled with some constants."""

    module: Module
    pipeline: Any

    def run(self, groups: tuple[int, ...], settings: dict[str, Any], given: Mapping[str, Any]) -> None:
        """Run some workgroups, with settings and the other resources, by their names."""
        gpu = self.module.gpu
        turns = {"turns": TURNS} if "turns" in (self.module.settings.names or ()) else {}
        with owned(upload(gpu, self.module.values(turns | settings))) as (held,):
            encoder = gpu.device.create_command_encoder()
            step = encoder.begin_compute_pass()
            step.set_pipeline(self.pipeline)
            step.set_bind_group(0, self.module.group({"settings": held, **given}))
            step.dispatch_workgroups(*groups)
            step.end()
            gpu.device.queue.submit([encoder.finish()])


def shader(gpu: Gpu, text: str, entry: str, constants: Mapping[str, float] | None = None) -> Shader:
    """Return an entry point of a shader's text (`source`), compiled once on a device for some constants."""
    chosen = constants or {}
    key = (text, entry, *sorted(chosen.items()))
    if key not in gpu.pipelines:
        made = module(gpu, text)
        pipeline = gpu.device.create_compute_pipeline(
            layout=gpu.device.create_pipeline_layout(bind_group_layouts=[made.layout]),
            compute={"module": made.code, "entry_point": entry, "constants": dict(chosen)},
        )
        gpu.pipelines[key] = Shader(made, pipeline)
    found: Shader = gpu.pipelines[key]
    return found


class Pace:
    """The number of items in each part of some work, from measured times: systems abort work that takes seconds."""

    def __init__(self, count: int, most: int = 1 << 30) -> None:
        self._most, self.count = most, min(count, most)
        self._each = 0.0  # seconds for one item, in the last part

    def parts(self, total: int, seconds: float = PART, limit: float = math.inf) -> Iterator[tuple[int, int]]:
        """Yield the start and the size of each part; the caller waits for a part before it asks for the next.

        Parts take about ``seconds`` each. They end after ``limit`` seconds, by estimate, but there is at least one.
        """
        begun, done = time.perf_counter(), 0
        while done < total:
            start = time.perf_counter()
            left = limit - (start - begun)
            part = min(self.count, total - done)
            if self._each > 0.0 and left < math.inf:
                part = min(part, int(max(left, 0.0) / self._each))
            if done and part < 1:
                return
            part = max(part, 1)
            yield done, part
            done += part
            self._each = max(time.perf_counter() - start, 1e-9) / part
            if part == self.count or self._each * self.count > seconds:
                self.count = max(1, min(int(seconds / self._each), 4 * self.count, self._most))
