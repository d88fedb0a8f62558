"""The engine for NVIDIA GPUs: kernels in Python, compiled by Numba, a thread for each point."""
