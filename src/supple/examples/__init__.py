"""Scenes of pictures, clips and volumes, with the data that they are made of: what ``supple demo`` shows."""
