"""Shaders: sources, pipelines, and arrays to and from the device."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.gpu.device import Gpu, forget

Array = npt.NDArray[Any]
T = TypeVar("T")

UNIFORM, READ, WRITE, TEXTURE, PICTURE = "uniform", "read-only-storage", "storage", "texture", "picture"
SOLID, WHOLE_SOLID, SIGNED_SOLID, FILLED = "solid", "solid of whole numbers", "solid of signed numbers", "filled solid"
_TEXTURES: dict[str, Any] = {
    TEXTURE: {"storage_texture": {"access": "write-only", "format": "rgba8unorm", "view_dimension": "2d"}},
    PICTURE: {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d"}},
    SOLID: {"texture": {"sample_type": "unfilterable-float", "view_dimension": "3d"}},
    WHOLE_SOLID: {"texture": {"sample_type": "uint", "view_dimension": "3d"}},
    SIGNED_SOLID: {"texture": {"sample_type": "sint", "view_dimension": "3d"}},
    FILLED: {"storage_texture": {"access": "write-only", "format": "r32float", "view_dimension": "3d"}},
}
MOST_GROUPS = 65535
PART = 0.25  # seconds
TURNS = 4  # iterations of a loop that tests whether loops run to their end (turns.wgsl)
CUT = 1 << 20  # added to a count of unsolved points if they do not
LEAST = 256  # bytes of the smallest buffer: one item must fit, even of an empty array
_LOST = re.compile(r"\blost\b|\bdevice\b.*\bdestroyed\b", re.IGNORECASE)  # a texture or a buffer may be destroyed, too


class InterruptionError(Exception):
    """An exception of a user's callback, kept apart from errors of the GPU; its cause is the original exception."""


def passing(call: Callable[..., T]) -> Callable[..., T]:
    """Wrap a user's callback so that its errors pass the handlers of GPU errors; see `let_through`."""

    def called(*arguments: Any) -> T:
        try:
            return call(*arguments)
        except Exception as error:
            raise InterruptionError from error

    return called


@contextlib.contextmanager
def let_through() -> Iterator[None]:
    """Raise the original exception of a user's callback."""
    try:
        yield
    except InterruptionError as stopped:
        raise stopped.__cause__ or stopped from None


def trouble(gpu: Gpu, error: Exception) -> str:
    """Return a failure in one short line; a lost device is opened again at the next use."""
    from wgpu import GPUValidationError

    text = " ".join(str(error).split())
    # A validation error is a bug, unless the device is lost, which gives one too.
    mistaken = isinstance(error, GPUValidationError) and not _LOST.search(text)
    if not (mistaken or isinstance(error, MemoryError | ArithmeticError)):
        forget(gpu)
    return text[:120] or "the work does not fit"


def unsolved(lost: int) -> str:
    """Return a message on points that may not meet the tolerance, if there are any."""
    if lost >= CUT:
        return "its driver ends loops of many turns"
    return f"{lost} points could not be solved to the tolerance in its numbers" if lost else ""


def failures() -> tuple[type[Exception], ...]:
    """Return the exception types of a device that is lost or full, or of a driver that fails to compile a shader."""
    from wgpu import GPUError

    return (GPUError, MemoryError, RuntimeError, ArithmeticError)


def source(*names: str) -> str:
    """Return the source of some shaders, concatenated, with the core's constants; WGSL allows any order."""
    folder = resources.files("supple.gpu") / "shaders"
    constants = [f"const {name} = {float(np.float32(value))!r};" for name, value in _core.constants.items()]
    return "\n".join([*constants, *((folder / f"{name}.wgsl").read_text(encoding="utf-8") for name in names)])


def pipeline(
    gpu: Gpu,
    names: Sequence[str],
    entry: str,
    kinds: Sequence[str | None],
    constants: Mapping[str, float] | None = None,
) -> Any:
    """Return the compiled entry point of a compute shader, cached on the device.

    ``kinds`` are those of its bindings: UNIFORM, READ, WRITE, TEXTURE (rgba8unorm, written to), a picture or a solid
    that is read, as in `_TEXTURES`; None for a number without a binding.
    """
    chosen = tuple(sorted((constants or {}).items()))
    key = (tuple(names), entry, tuple(kinds), chosen)
    if key not in gpu.pipelines:
        module_key = tuple(names)
        if module_key not in gpu.pipelines:
            gpu.pipelines[module_key] = gpu.device.create_shader_module(label=names[0], code=source(*names))
        entries = [
            {"binding": k, "visibility": "COMPUTE"} | _TEXTURES.get(kind, {"buffer": {"type": kind}})
            for k, kind in enumerate(kinds)
            if kind is not None
        ]
        layout = gpu.device.create_bind_group_layout(entries=entries)
        gpu.pipelines[key] = (
            gpu.device.create_compute_pipeline(
                layout=gpu.device.create_pipeline_layout(bind_group_layouts=[layout]),
                compute={"module": gpu.pipelines[module_key], "entry_point": entry, "constants": dict(chosen)},
            ),
            layout,
        )
    return gpu.pipelines[key]


def upload(gpu: Gpu, array: Array, kind: str = READ) -> Any:
    """Return a buffer with an array's bytes, padded to whole words."""
    usage = "UNIFORM" if kind == UNIFORM else "STORAGE|COPY_SRC"
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    if data.size == 0:
        data = np.zeros(4, np.uint8)
    size = -(-data.size // 4) * 4
    buffer = gpu.device.create_buffer(size=max(size, LEAST), usage=f"{usage}|COPY_DST")
    whole = data.size // 4 * 4
    if whole:
        gpu.device.queue.write_buffer(buffer, 0, data[:whole])
    if whole < data.size:
        gpu.device.queue.write_buffer(buffer, whole, np.pad(data[whole:], (0, 4 - data.size + whole)))
    return buffer


def room(gpu: Gpu, size: int) -> Any:
    """Return a buffer of ``size`` bytes, all 0."""
    return gpu.device.create_buffer(size=max(-(-size // 4) * 4, LEAST), usage="STORAGE|COPY_SRC|COPY_DST")


def owned(stack: contextlib.ExitStack, *buffers: Any) -> tuple[Any, ...]:
    """Return buffers that are destroyed when the stack is left."""
    for buffer in buffers:
        stack.callback(buffer.destroy)
    return buffers


def bound(gpu: Gpu, layout: Any, buffers: Sequence[Any]) -> Any:
    """Return the bind group of buffers and texture views; None for a number without a binding."""
    entries = [
        {"binding": k, "resource": buffer if hasattr(buffer, "texture") else {"buffer": buffer}}
        for k, buffer in enumerate(buffers)
        if buffer is not None
    ]
    return gpu.device.create_bind_group(layout=layout, entries=entries)


def run(gpu: Gpu, passes: Sequence[tuple[Any, Sequence[Any], tuple[int, ...]]]) -> None:
    """Run pipelines in order, each with its buffers and its workgroups."""
    encoder = gpu.device.create_command_encoder()
    for (made, layout), buffers, groups in passes:
        step = encoder.begin_compute_pass()
        step.set_pipeline(made)
        step.set_bind_group(0, bound(gpu, layout, buffers))
        step.dispatch_workgroups(*groups)
        step.end()
    gpu.device.queue.submit([encoder.finish()])


def wait(gpu: Gpu) -> None:
    """Wait until all submitted work is done."""
    try:
        gpu.device._poll_wait()
    except AttributeError:  # wgpu's own poll: its public alternative (0.32) fails, or takes a buffer each time
        download(gpu, room(gpu, LEAST), np.uint32, 1)


def download(gpu: Gpu, buffer: Any, dtype: Any, count: int) -> Array:
    """Return the first ``count`` numbers of a buffer; waits for the work that fills it."""
    size = -(-count * np.dtype(dtype).itemsize // 4) * 4
    return np.frombuffer(gpu.device.queue.read_buffer(buffer, 0, size), dtype, count)


def settle(gpu: Gpu) -> None:
    """Wait for uploads, which keep a copy in memory until they are done."""
    gpu.device.queue.submit([])
    wait(gpu)


class Pace:
    """The size of the parts of some work, from measured times: systems end work that takes seconds.

    Parameters
    ----------
    count : int
        The initial size of a part.
    most : int
        The largest size of a part.
    """

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


def spread(count: int, size: int) -> tuple[int, int]:
    """Return workgroups of ``size`` threads for ``count`` items, in rows."""
    groups = max(1, -(-count // size))
    rows = -(-groups // MOST_GROUPS)
    return -(-groups // rows), rows
