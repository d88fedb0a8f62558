"""The CUDA engine: the core's arithmetic, compiled by NVRTC for NVIDIA GPUs."""
