"""Deformations of PyTorch tensors, differentiable with respect to the image and the strokes."""

try:
    import torch as _torch  # noqa: F401
except ModuleNotFoundError as error:
    if error.name != "torch":
        raise
    raise ImportError("supple.torch needs PyTorch, which is not installed: pip install torch") from None

from supple.torch.warping import forward, warp

__all__ = ["forward", "warp"]
