"""Deformations of PyTorch tensors, and inverses of displacement fields, with gradients."""

try:
    import torch as _torch  # noqa: F401
except ModuleNotFoundError as error:
    if error.name != "torch":
        raise
    raise ImportError("supple.torch needs PyTorch, which is not installed: pip install torch") from None

from supple.torch.inverse import Inverted, invert
from supple.torch.warping import forward, warp

__all__ = ["Inverted", "forward", "invert", "warp"]
