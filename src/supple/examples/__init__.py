"""Scenes of images, clips and volumes, with their data: the examples of ``supple demo``."""
