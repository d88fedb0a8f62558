"""The picture as it is painted, the overlays on it, and the panel beside it."""
