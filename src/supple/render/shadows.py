"""Shadows in a volume: the part of the light that arrives at the nodes of a coarse grid.

The opacity of a node is the mean of its voxels'. Light from one direction goes through the grid layer by layer, and
spreads a little in each, so that shadows are soft. The lamp's light is computed for each camera; the sky's, from
fourteen directions, once. Every surface hides half of the sky from its own points: this does not count as shadow, so
only hollows are darkened, and surfaces behind others.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from supple import _core
from supple.engine.work import Array
from supple.render.appearance import Seen
from supple.render.box import Box

Floats = npt.NDArray[np.floating[Any]]
Singles = npt.NDArray[np.float32]

LONGEST = 128  # nodes along the longest side, in millimetres
PAD = 2  # empty nodes on each side of the volume, from which its faces take their light
REACH = 2  # each node takes the most light within so many nodes, so that no surface is in its own shadow
SHADE = 0.3  # the part of the light that comes from the sky, and remains where the lamp's does not arrive
DEEP = 2.0  # the exponent of the sky's light: larger ones darken hollows more
NEAR = 1.0  # voxels: the tolerance of a warp for shadows alone
SKY = [np.array(way) / np.linalg.norm(way) for way in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, way)) % 2]


@dataclass(frozen=True, slots=True, eq=False)
class Shade:
    """The opacity of a scene, and the light of the sky, at the nodes of a coarse grid."""

    # (nz, ny, nx): the opacity of ``length`` millimetres at nodes of the deformed volume, without parts cut away
    nodes: Singles
    length: float
    wide: tuple[int, ...]  # voxels from node to node, x first
    spacing: tuple[float, ...]  # millimetres from node to node, x first
    # (nz, ny, nx): the factor of all light at nodes, from 0 to 1, by how much of the sky is seen: 1 from half of it on
    sky: Singles


def shade_of(
    samples: Array, seen: Seen, step: float, clip: Box, plane: Sequence[float], spacing: tuple[float, ...]
) -> Shade:
    """Return the shade of samples in a box and before a plane; ``seen`` has the opacities of ``step`` millimetres."""
    sides = [n * s for n, s in zip(samples.shape[::-1], spacing, strict=True)]
    length = max(max(sides) / LONGEST, min(spacing))
    wide = tuple(max(1, round(length / s)) for s in spacing)
    nodes = _opacities(samples, seen, length / step, wide)
    nodes = np.pad(nodes * _kept(nodes.shape, wide, clip, plane, spacing), PAD)
    apart = tuple(w * s for w, s in zip(wide, spacing, strict=True))
    sky = sum((light_from(way, nodes, length, apart) for way in SKY), np.zeros_like(nodes))
    return Shade(nodes, length, wide, apart, np.minimum(sky / np.float32(len(SKY) / 2), 1) ** DEEP)


def arriving(shade: Shade | None, lamp: Singles, strength: float) -> tuple[Singles, Singles]:
    """Return the part of the light at nodes (nz, ny, nx), and their places (2, 3): the node at voxel 0, nodes a voxel.

    ``lamp`` is the direction to the lamp, in millimetres along the volume's axes. At a strength of 0, all light
    arrives. Without shade, there are no nodes.
    """
    if shade is None:
        return np.empty((0, 0, 0), np.float32), np.zeros((2, 3), np.float32)
    light = (SHADE + (1 - SHADE) * light_from(lamp, shade.nodes, shade.length, shade.spacing)) * shade.sky
    wide = np.array(shade.wide)
    placed = np.array([PAD - (wide - 1) / (2 * wide), 1 / wide], np.float32)
    return _reached(np.asarray(1 - strength * (1 - light), np.float32)), placed


def light_from(way: npt.ArrayLike, nodes: Singles, length: float, spacing: Sequence[float]) -> Singles:
    """Return the part of the light from a direction, x first, that arrives at each node (nz, ny, nx).

    ``nodes`` are opacities of ``length`` millimetres; ``spacing`` is in millimetres from node to node, x first.
    """
    steps = (np.asarray(way, np.float64) / spacing)[::-1]  # in nodes, z first as the array's axes
    axis = int(np.abs(steps).argmax())
    steps /= abs(steps[axis])  # from a layer to the next one towards the light
    across = float(np.linalg.norm(steps * spacing[::-1])) / length
    layers = np.moveaxis(nodes, axis, 0)
    through = np.maximum(1 - layers, 0) ** np.float32(0.5 * across)  # the transmission of half of a layer
    made, light = np.empty_like(layers), np.ones(layers.shape[1:], np.float32)
    order = range(len(layers))
    for k in reversed(order) if steps[axis] > 0 else order:
        made[k] = _shifted(light, np.delete(steps, axis)) * through[k]
        light = made[k] * through[k]
    return np.moveaxis(made, 0, axis)


def _shifted(layer: Singles, by: Floats) -> Singles:
    """Return a layer sampled at an offset of ``by`` nodes, at most one along each axis; beyond its ends it is 1.

    Quadratic B-splines spread light equally for every fraction of a node.
    """
    whole = np.rint(by)
    for first, part in zip(whole.astype(int) + 1, by - whole, strict=True):
        n = len(layer)
        padded = np.pad(layer, [(2, 2), (0, 0)], constant_values=1)
        weights = np.array([(0.5 - part) ** 2 / 2, 0.75 - part**2, (0.5 + part) ** 2 / 2], np.float32)
        layer = sum(w * padded[first + j : first + j + n] for j, w in enumerate(weights)).T
    return layer


def _reached(nodes: Singles) -> Singles:
    for axis in range(3):
        whole = np.moveaxis(np.pad(nodes, [(REACH * (axis == k),) * 2 for k in range(3)]), axis, 0)
        most = np.maximum.reduce([whole[j : j + nodes.shape[axis]] for j in range(2 * REACH + 1)])
        nodes = np.moveaxis(most, 0, axis)
    return np.ascontiguousarray(nodes)


def _opacities(samples: Array, seen: Seen, steps: float, wide: tuple[int, ...]) -> Singles:
    values = seen.low + np.arange(len(seen.table)) / (seen.scale or 1.0)
    opacities = 1 - (1 - seen.table[:, 3].astype(np.float64)) ** steps
    opacities[(values < seen.window[0]) | (values > seen.window[1])] = 0
    made = np.empty([-(-n // w) for n, w in zip(samples.shape, wide[::-1], strict=True)], np.float32)
    _core.block_means(samples, wide, opacities.astype(np.float32), seen.low, seen.scale, made)
    return made


def _kept(
    shape: tuple[int, ...], wide: tuple[int, ...], clip: Box, plane: Sequence[float], spacing: Sequence[float]
) -> Singles:
    kept, away = np.ones(shape, np.float32), np.full(shape, -plane[3], np.float32)
    for axis, (n, w) in enumerate(zip(shape[::-1], wide, strict=True)):
        at = np.arange(n) * w + (w - 1) / 2  # the centres of blocks
        (first, last), along = clip[axis], [-1 if k == 2 - axis else 1 for k in range(3)]
        inside = np.minimum(at + w / 2, last + 0.5) - np.maximum(at - w / 2, first - 0.5)
        kept *= np.clip(inside / w, 0, 1).astype(np.float32).reshape(along)
        away += (plane[axis] * spacing[axis] * at).astype(np.float32).reshape(along)
    if any(plane[:3]):
        kept *= np.clip(0.5 - away / np.mean(np.multiply(wide, spacing)), 0, 1)
    return kept
