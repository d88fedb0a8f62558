"""The CUDA engine: arrays on an NVIDIA GPU, and host arrays that are sent there slab by slab."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from supple.engines.base import Certificate, EngineError, Space, Steps, Work
from supple.engines.cuda import arrays, job
from supple.engines.cuda import points as moving
from supple.engines.cuda.device import FAILURES, CudaDevice, open_device
from supple.engines.cuda.large import warp_host
from supple.engines.native import NATIVE

# Kernels are compiled, and NVIDIA's packages are imported, only if there is a device.


def open_cuda(number: int = 0) -> Cuda:
    """Return the engine of the CUDA device of a number; SuppleError gives the reason if it cannot be used."""
    return Cuda(open_device(number))


@dataclass(frozen=True, slots=True)
class Cuda:
    """The engine of a CUDA device (`supple.engines.base.Engine`): for all types that a layout has."""

    gpu: CudaDevice

    @property
    def name(self) -> str:
        """The name of the GPU."""
        return self.gpu.name

    def taken(self, value: Any, name: str) -> Any:
        """Return a CUDA array of any library as `DeviceArray`, and a host array as NumPy's."""
        return arrays.taken(value, name) if arrays.is_on_device(value) else NATIVE.taken(value, name)

    def result(self, out: Any, held: Any, shape: tuple[int, ...] | None = None) -> Any:
        """See `Engine.result`; the result is where the source is."""
        if not isinstance(held, arrays.DeviceArray):
            return NATIVE.result(out, held, shape)
        shape = held.shape if shape is None else shape
        if out is not None:
            return arrays.checked_out(out, held, shape)
        return arrays.made_like(held, shape, held.dtype, as_it_lies=shape == held.shape)

    def warp(self, work: Work, frames: Sequence[Any], outs: Sequence[Any]) -> Steps:
        """See `Engine.warp`. Arrays on a device are taken as they are, without an axis for frames or channels."""
        if isinstance(frames[0], arrays.DeviceArray):
            yield len(outs), job.finish(work, frames[0], outs[0])
            return
        try:
            with closing(warp_host(self.gpu, frames[0], outs[0], work)) as made:
                yield from made
        except FAILURES as error:
            raise EngineError(" ".join(str(error).split())[:120] or type(error).__name__) from error

    def forward(self, space: Space, points: Any, *, matrices: bool = False) -> Any:
        """See `Engine.forward`."""
        return moving.forward(space, points, matrices=matrices)

    def inverse(self, space: Space, points: Any) -> tuple[Any, Any, Any, Any]:
        """See `Engine.inverse`."""
        return moving.inverse(space, points)

    def inverse_map(self, space: Space, tolerance: float, like: Any = None) -> tuple[Any, Certificate]:
        """See `Engine.inverse_map`; ``like`` is an array on a CUDA device."""
        return moving.inverse_map(space, like, tolerance)
