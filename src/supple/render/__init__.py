"""Rendered volumes: scenes, cameras, transfer functions, and image files."""
