"""The image, the overlays on it, and the panel beside it."""
