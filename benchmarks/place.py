"""Where arrays are for `cuda_engine.py`: on an NVIDIA GPU, of whatever library; or on one that is played in memory."""

from __future__ import annotations

import gc
import importlib
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from measure import Clock, Work, wall

if TYPE_CHECKING:
    import supple

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Events:
    """Seconds by a GPU's clock, from before some work is handed to a stream until the stream has done it.

    Unless it is ``beside`` the work of others, the GPU is idle before. The stream is CUDA's handle: 0 for the default.
    """

    stream: int = 0
    beside: bool = False

    def __call__(self, work: Work) -> float:
        from supple.cuda.device import call, open_device

        with open_device().current():
            begin, end = (call("cuEventCreate", 0) for _ in range(2))
            if not self.beside:
                call("cuCtxSynchronize")
            call("cuEventRecord", begin, self.stream)
            work()
            call("cuEventRecord", end, self.stream)
            call("cuEventSynchronize", end)
            taken = float(call("cuEventElapsedTime", begin, end)) / 1e3
            for event in (begin, end):
                call("cuEventDestroy", event)
        return taken


def play() -> None:
    """Put a GPU that is played in memory, as the tests have it, in the place of a real one."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from supple.cuda import arrays, device, programs
    from tests.cuda import conftest
    from tests.cuda.driver import Driver

    made: Any = Driver(conftest.compiled())
    replaced: Any = (device, programs, arrays)
    replaced[0].driver = lambda: made
    replaced[1].kept = conftest.coded
    replaced[2]._viewed = lambda value, kind, gpu: conftest.View(value)


def sent(array: Array) -> Any:
    """An array of Supple's own on the GPU."""
    from supple.cuda.arrays import CudaArray
    from supple.cuda.device import Stream, call, open_device

    gpu = open_device()
    with gpu.current():
        made = CudaArray(array.shape, array.dtype, gpu, Stream(0))
        pointer = made.__cuda_array_interface__["data"][0]
        call("cuMemcpyHtoDAsync", pointer, np.ascontiguousarray(array).ctypes.data, array.nbytes, 0)
        call("cuStreamSynchronize", 0)
    return made


@dataclass
class Place:
    """A GPU, or what plays it, and the libraries that there are.

    Parameters
    ----------
    dry : bool
        Whether the GPU is played in memory: arrays are Supple's own, peers work on the CPU (SciPy in CuPy's place), and
        times are the host's.
    missing : dict
        The peers that are not there, and what is to be said of each.
    """

    dry: bool
    missing: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("torch", "cupy", "kornia"):
            try:
                found = importlib.import_module("scipy.ndimage" if self.dry and name == "cupy" else name)
            except ImportError as error:
                absent = isinstance(error, ModuleNotFoundError) and error.name == name
                self.missing[name] = f"{name} is not installed" if absent else f"{name} cannot be imported ({error})"
                continue
            if name == "torch" and not self.dry and not found.cuda.is_available():
                self.missing[name] = f"torch {found.__version__} sees no GPU"
        if "torch" in self.missing and "kornia" not in self.missing:
            self.missing["kornia"] = f"kornia needs torch: {self.missing['torch']}"

    @property
    def clock(self) -> Clock:
        """What tells the time of calls."""
        return wall if self.dry else Events()

    @property
    def kind(self) -> str:
        """The library whose arrays are warped where no peer wants another."""
        return next((name for name in ("torch", "cupy") if not self.dry and name not in self.missing), "own")

    def put(self, array: Array, kind: str = "") -> Any:
        """An array as Supple takes it there."""
        kind = "own" if self.dry else kind or self.kind
        return self.peers(array, kind) if kind != "own" else sent(array)

    def peers(self, array: Array, kind: str) -> Any:
        """An array as a peer takes it: on the GPU, or for its twin on the CPU."""
        if self.dry and kind == "cupy":
            return array
        module: Any = importlib.import_module(kind)
        return module.asarray(array) if kind == "cupy" else module.as_tensor(array, device=self.device)

    @property
    def device(self) -> str:
        """In torch's words."""
        return "cpu" if self.dry else "cuda"

    def freed(self) -> None:
        """Give back what nobody holds any more, and memory pools still do."""
        gc.collect()
        if self.dry:
            return
        if "torch" not in self.missing:
            importlib.import_module("torch").cuda.empty_cache()
        if "cupy" not in self.missing:
            importlib.import_module("cupy").get_default_memory_pool().free_all_blocks()

    def about(self) -> dict[str, str]:
        """What all this is: the GPU, its driver, the CUDA that it knows, and the libraries."""
        from supple.cuda.device import call, open_device

        libraries = (
            "supple", "cuda-bindings", "cuda-core", "nvidia-cuda-nvrtc", "nvidia-cuda-nvrtc-cu12", "torch",
            "cupy-cuda12x", "cupy-cuda13x", "kornia",
        )  # fmt: skip
        told = {"gpu": open_device().name}
        if not self.dry:
            known = int(call("cuDriverGetVersion"))
            told |= {"driver": driver_version(), "CUDA": f"{known // 1000}.{known % 1000 // 10}"}
        return told | {name: found for name in libraries if (found := _version(name))}


def host(array: Any) -> Array:
    """An array of any of the libraries, on the host."""
    from supple.cuda.arrays import CudaArray
    from supple.cuda.device import call, open_device

    if isinstance(array, CudaArray):
        made = np.empty(array.shape, array.dtype)
        with open_device().current():
            call("cuMemcpyDtoHAsync", made.ctypes.data, array.__cuda_array_interface__["data"][0], made.nbytes, 0)
            call("cuStreamSynchronize", 0)
        return made
    if hasattr(array, "get"):  # CuPy's
        return np.asarray(array.get())
    return np.asarray(array.cpu() if hasattr(array, "cpu") else array)


def driver_version() -> str:
    """Of NVIDIA's driver, as nvidia-smi tells it."""
    if shutil.which("nvidia-smi") is None:
        return "not told: nvidia-smi is not there"
    words = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    said = subprocess.run(words, capture_output=True, text=True, check=False).stdout.split()
    return said[0] if said else "not told"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@dataclass(frozen=True)
class Bench:
    """Where, how large and how often."""

    place: Place
    runs: int
    side: int  # of a volume
    clip: tuple[int, int, int]
    batch: tuple[int, int]

    @property
    def volume(self) -> str:
        return f"{self.side}³ float32"


def waves(*shape: int, phase: float = 0.0) -> Array:
    """Smooth samples from 0 to 1, no two planes of which are alike."""
    total = np.zeros(shape, np.float32)
    for k, n in enumerate(shape):
        wave = np.sin((0.05 + 0.02 * k) * np.arange(n) + phase + k).astype(np.float32)
        total += wave.reshape([-1 if axis == k else 1 for axis in range(len(shape))])
    return np.asarray(0.5 + 0.5 / len(shape) * total, np.float32)


def stroke(*shape: int) -> supple.Deformation:
    """One, in the middle, a fifth of the shortest side wide."""
    import supple

    middle = [(n - 1) / 2 for n in shape[::-1]]
    by = [min(shape) / 16, *(0.0,) * (len(shape) - 1)]
    return supple.Deformation(shape, border=None).grab(middle, by=by, radius=min(shape) / 5)
