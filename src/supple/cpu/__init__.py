"""The engine that runs everywhere: Numba kernels over packed strokes, domains and arrays."""
