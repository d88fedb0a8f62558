"""Bend images, videos and volumes: elastic strokes, exactly inverted."""

__version__ = "0.1.0"
