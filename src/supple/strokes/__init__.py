"""Strokes and recipes: immutable values, their JSON, their scaling to other sizes, and the packed table of the core."""

from supple.strokes.recipe import CoordinateSpace, FoldPolicy, Recipe, fit_recipe
from supple.strokes.scaling import Fit, scaling_of, spoken
from supple.strokes.stroke import (
    LARGEST_ANGLE,
    LARGEST_FACTOR,
    LEAST,
    MOST,
    MOST_HANDLES,
    PAINTINGS,
    REACH,
    Stroke,
    last_freeze,
)
from supple.strokes.table import POISSON, legs, matrix_of, pack, poisson_of, stretch_of, time_radius_of

__all__ = [
    "LARGEST_ANGLE",
    "LARGEST_FACTOR",
    "LEAST",
    "MOST",
    "MOST_HANDLES",
    "PAINTINGS",
    "POISSON",
    "REACH",
    "CoordinateSpace",
    "Fit",
    "FoldPolicy",
    "Recipe",
    "Stroke",
    "fit_recipe",
    "last_freeze",
    "legs",
    "matrix_of",
    "pack",
    "poisson_of",
    "scaling_of",
    "spoken",
    "stretch_of",
    "time_radius_of",
]
