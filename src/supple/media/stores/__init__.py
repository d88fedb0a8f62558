"""Zarr arrays and OME-Zarr images: opened, and created like another for blocks that many processes write."""
