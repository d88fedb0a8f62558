"""Engines: one protocol (`base`), the native one and CUDA, and the choice between them."""
