"""Zarr arrays and OME-Zarr images: opening them, and creating outputs that many processes write block by block."""
