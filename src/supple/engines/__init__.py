"""Engines: one protocol (`base`), the native one, wgpu and CUDA, and the choice between them."""
