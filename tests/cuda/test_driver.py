"""What the engine asks of the driver: memory, streams, events, launches, and what happens when it fails."""

from __future__ import annotations

import gc
import threading
from typing import Any

import numpy as np
import pytest

import supple
import supple.cuda
from supple.cuda import device, programs, warp
from supple.cuda.device import CudaDevice, CudaError, Memory
from supple.cuda.programs import CHECKS, JOB, SOME, record
from supple.errors import SuppleError
from tests.cuda.driver import Driver, on_host, sent

SHAPE, STACK = (40, 52), (9, 20, 24)
OPTIONS: dict[str, Any] = {"filter": "linear", "tolerance": 1e-3}


def bent(shape: tuple[int, ...]) -> supple.Deformation:
    middle = (np.array(shape[::-1]) - 1) / 2
    return supple.Deformation(shape).grab(middle, by=[2.0, 1.0, 1.5][: len(shape)], radius=5.0)


def names(played: Driver) -> list[str]:
    return [name for name, _ in played.calls]


def test_records_have_the_layout_of_the_kernels() -> None:
    assert (JOB.itemsize, SOME.itemsize, CHECKS.itemsize) == (264, 88, 20)
    for whole in (JOB, SOME, CHECKS):  # as a C++ compiler lays them out: no gaps, and eights first
        assert whole.itemsize == sum(whole[k].itemsize for k in range(len(whole.fields or ())))
        for name, (kind, at, *_) in (whole.fields or {}).items():
            assert at % min(kind.base.itemsize, 8) == 0, name


def test_a_record_has_no_other_fields() -> None:
    assert record(SOME, count=3).contents.count == 3
    with pytest.raises(TypeError, match="no field of the record: counts, told"):
        record(SOME, counts=3, told=0, back=True)


def test_a_warp_is_four_kernels_on_the_stream_of_the_array(played: Driver) -> None:
    d = bent(SHAPE)
    source = sent(np.random.default_rng(0).random(SHAPE).astype(np.float32))
    played.calls.clear()
    d.warp(source, **OPTIONS)
    launched = [arguments for name, arguments in played.calls if name == "cuLaunchKernel"]
    assert [program["unit"] for program, *_ in launched] == ["nodes", "cells", "fill", "rough"]
    assert {arguments[8] for arguments in launched} == {0}
    assert {arguments[4] for arguments in launched} == {programs.THREADS}
    # What is written is waited for, and scratch memory is freed after the kernels, in their order.
    after = names(played)[::-1].index("cuLaunchKernel")
    assert names(played)[-after:].count("cuMemFreeAsync") >= 3


def test_maps_and_programs_are_kept(played: Driver) -> None:
    d = bent(SHAPE)
    source = sent(np.zeros(SHAPE, np.uint8))
    d.warp(source, **OPTIONS)
    played.calls.clear()
    d.warp(source, **OPTIONS)
    assert "cuModuleLoadData" not in names(played)
    assert "cuMemcpyHtoDAsync" not in names(played)
    for k in range(warp._KEPT + 3):
        bent((20, 21 + k)).warp(sent(np.zeros((20, 21 + k), np.uint8)), **OPTIONS)
    assert len(warp._lattices) == warp._KEPT


def test_a_warp_of_its_own_stream_waits_for_both_sides(played: Driver) -> None:
    d = bent(STACK)
    source = sent(np.random.default_rng(1).random(STACK).astype(np.float32))
    played.calls.clear()
    warping = supple.cuda.start(source, d, slab=2, **OPTIONS)
    assert warping.stream.handle != 0
    waits = [arguments for name, arguments in played.calls if name == "cuStreamWaitEvent"]
    assert {arguments[0] for arguments in waits} == {warping.stream.handle}
    launched = [arguments for name, arguments in played.calls if name == "cuLaunchKernel"]
    assert len(launched) == 4 * 5  # nine planes, two at a time
    assert {arguments[8] for arguments in launched} == {warping.stream.handle}
    other = device.open_device().stream()
    warping.join(other)
    assert [arguments[0] for name, arguments in played.calls if name == "cuStreamWaitEvent"][-1] == other.handle
    assert warping.wait() is warping.array
    assert warping.done()
    assert 0 < warping.error <= 1e-3
    assert "done" in repr(warping)


def test_page_locked_memory_of_checks_is_reused_once(played: Driver) -> None:
    source = sent(np.zeros(STACK, np.float32))
    warping = supple.cuda.start(source, bent(STACK), **OPTIONS)
    assert warping._known() == warping._known()  # as of two threads that wait
    assert len(warp._spare) == len({id(held) for held in warp._spare}) == 1


def test_what_is_under_way_lives_until_its_event(played: Driver) -> None:
    d = bent(STACK)
    source = np.random.default_rng(2).random(STACK).astype(np.float32)
    warping = supple.cuda.start(sent(source), d, **OPTIONS)
    made = warping.array
    del warping
    gc.collect()
    np.testing.assert_allclose(on_host(made), d.warp(source, **OPTIONS), atol=4e-3)


@pytest.mark.parametrize("function", ["cuMemAllocAsync", "cuLaunchKernel", "cuModuleLoadData", "cuMemcpyHtoDAsync"])
def test_a_failing_gpu_is_one_sentence(played: Driver, function: str) -> None:
    d, source = bent(STACK), np.random.default_rng(3).random(STACK).astype(np.float32)
    out = np.empty_like(source)
    played.fails = function
    with pytest.raises(SuppleError, match=f"{function}: CUDA_ERROR_OUT_OF_MEMORY.*: device='cpu' does without it"):
        d.warp(source, device="cuda", out=out, **OPTIONS)
    again = d.warp(source, device="cuda", out=out, **OPTIONS)  # it may be better the next time
    np.testing.assert_allclose(again, d.warp(source, **OPTIONS), atol=4e-3)


def test_a_failure_with_an_array_of_the_gpu_is_an_error(played: Driver) -> None:
    source = sent(np.zeros(SHAPE, np.float32))
    played.fails = "cuLaunchKernel"
    with pytest.raises(CudaError, match="cuLaunchKernel: CUDA_ERROR_OUT_OF_MEMORY"):
        bent(SHAPE).warp(source, **OPTIONS)


def test_memory_is_of_its_stream(gpu: CudaDevice, played: Driver) -> None:
    with gpu.current():
        stream = gpu.stream()
        memory = Memory(100, stream)
        given = np.arange(100, dtype=np.uint8)
        memory.upload(given)
        back = np.zeros(40, np.uint8)
        memory.download(back, 60)
        np.testing.assert_array_equal(back, given[60:])
        pointer = memory.pointer
        del memory
        gc.collect()
        assert names(played).count("cuMemFreeAsync") == 1
        with pytest.raises(AssertionError, match="not of the device"):
            device.call("cuMemcpyHtoDAsync", pointer, given.ctypes.data, given.nbytes, stream.handle)


def test_every_thread_has_the_context(played: Driver) -> None:
    d, source = bent(SHAPE), np.random.default_rng(4).random(SHAPE).astype(np.float32)
    wanted = d.warp(source, **OPTIONS)
    made: list[np.ndarray] = []
    threads = [threading.Thread(target=lambda: made.append(on_host(d.warp(sent(source), **OPTIONS)))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 4
    for one in made:
        np.testing.assert_allclose(one, wanted, atol=4e-3)
    assert not played._contexts()
