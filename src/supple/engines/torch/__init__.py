"""The engine for PyTorch's tensors: T, its gradients and samples as differentiable operations."""
