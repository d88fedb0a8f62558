"""The choice of a GPU that draws, what is said where there is none, and the numbers that shaders share with Python."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

import supple
from supple.cli import command
from supple.errors import SuppleError
from supple.gpu import device as devices
from supple.gpu.device import Gpu, gpu_of


def test_drivers_that_fail_are_said_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    class Adapter:
        info: ClassVar = {"device": "Card", "adapter_type": "DiscreteGPU", "backend_type": "Vulkan"}
        limits: ClassVar[dict[str, int]] = {}
        features: ClassVar[set[str]] = set()

        def request_device_sync(self, **rest: object) -> None:
            raise RuntimeError("no\nqueue")

    monkeypatch.setattr(devices, "adapters", lambda: (Adapter(),))
    monkeypatch.setattr(devices, "_opened", {})
    with pytest.raises(SuppleError, match=r"Card cannot be opened \(no queue\)"):
        gpu_of("gpu")
    assert gpu_of("auto") is None


def test_without_an_adapter_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "adapters", lambda: ())
    with pytest.raises(SuppleError, match=r"no GPU was found: .* is needed.*; device='cpu' needs none"):
        gpu_of("gpu")
    assert gpu_of("auto") is None
    assert gpu_of("cpu") is None


def test_auto_never_takes_a_program(gpu: Gpu) -> None:
    found = gpu_of("auto")
    assert found is None if gpu.software else found is gpu


def test_it_draws_and_does_not_warp() -> None:
    d = supple.Deformation((9, 12)).grab((5, 4), by=(1, 0), radius=3)
    picture = np.random.default_rng(0).integers(0, 255, (9, 12), np.uint8)
    for device in ("gpu", "tpu", None):
        with pytest.raises(SuppleError, match=r'^device must be "cpu", "cuda" \(on an NVIDIA GPU\) or "auto", found'):
            d.warp(picture, device=device)  # type: ignore[arg-type]
    np.testing.assert_array_equal(d.warp(picture, device="auto"), d.warp(picture))


def test_the_command_line_lists_it(gpu: Gpu, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["info", "--gpu"]) == 0
    assert gpu.name in capsys.readouterr().out
    assert command(["info"]) == 2
