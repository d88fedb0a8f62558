"""Volumes for the window: on their own grid, or on that of a fixed one, with labels and landmarks."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from supple.arrays import warp_array
from supple.deformation import Deformation
from supple.engine.sampling import Sampling
from supple.errors import SuppleError, argument, shown
from supple.files.grids import warn_of_place
from supple.files.landmarks import read_landmarks
from supple.files.options import GridOptions, PathLike
from supple.files.renders import default_transfer
from supple.files.volumes import background_of, is_of_labels, moved, open_volume
from supple.gpu.device import Gpu
from supple.media.files import replacing
from supple.media.volume import Volume
from supple.render.labels import LabelColours
from supple.render.transfer import transfer_of
from supple.space.geometry import check_boxes, check_upright
from supple.viewer.document.editing import Document
from supple.viewer.document.landmarks import Landmarks
from supple.viewer.panels.layers import Registration, segmentation_of
from supple.viewer.panels.slices import first_window
from supple.viewer.panels.stages import VolumeStage
from supple.viewer.tools.comparing import Comparison
from supple.viewer.window.options import ViewOptions

OPTIONS = ("fixed", "fixed_points", "segmentation", "label_colours")
"""The options of the window that are for volumes alone."""


def volume_stage(gpu: Gpu, source: str | os.PathLike[str], options: ViewOptions) -> VolumeStage:
    """Open the stage of a volume: through fields and affine maps, and on the grid of a fixed volume if there is one."""
    volume = open_volume(source, options.volume)
    fixed = None if options.fixed is None else open_volume(options.fixed)
    for each in (volume, fixed):
        if each is not None and each.components > 1:
            raise SuppleError(f"{each.name} has {each.components} components, and pictures are of one")
    where = volume if fixed is None else fixed
    check_upright(where.geometry, where.name, "the window")
    known: Registration | None = None
    if fixed is not None or options.maps:
        for each in (volume, fixed):
            if each is not None:
                warn_of_place(each.geometry, each.name)
        known = Registration(volume, Deformation(where.grid, border=None), options.maps, fixed)
        volume = placed(known, options)
    table = None if options.label_colours is None else _table(options.label_colours)
    own = table if options.segmentation is None else None  # the colours of the volume itself, a label map
    samples = volume.rescaled()
    transfer = default_transfer(volume) if own is None else own
    stage = VolumeStage(gpu, volume, transfer, samples[0] if volume.series else samples)
    stage.registration = known
    if options.segmentation is not None:
        over, own_grid = open_volume(options.segmentation), (volume if known is None else known.moving).grid
        check_boxes(over.grid.box, over.name, own_grid.box, f"{shown(source)}, whose labels they are,")
        stage.segmentation = segmentation_of(over, table)
    return stage


def placed(known: Registration, options: ViewOptions) -> Volume:
    """Return a volume resampled on the grid of the window, before strokes; of a series, its first volume."""
    volume, grid = known.moving, known.plain.grid
    labels = options.volume.labels or volume.is_segmentation or is_of_labels(volume)
    fill = volume.stored(background_of(volume, labels=labels))
    first = volume.samples[0] if volume.series else volume.samples
    space = known.plain.behind(known.maps).space_on(grid, volume.grid)
    sampling = Sampling("nearest" if labels else "linear", outside="constant", fill=fill)
    made = warp_array(first, space, sampling, alpha=False)[0]
    if known.fixed is not None and made.min() == made.max() and first.min() != first.max():
        raise SuppleError(
            f"nothing of {volume.name} lies within {known.fixed.name}: give the affine map of their registration, and "
            "its field, if there is one"
        )
    if volume.series:
        made = made[None]
    if known.fixed is None:
        return replace(volume, samples=made)
    return replace(moved(volume, grid, GridOptions(options.fixed)), samples=made)


def _table(path: str | os.PathLike[str]) -> LabelColours:
    """Return the colours and names of a table of labels."""
    colours = transfer_of(path)
    if not isinstance(colours, LabelColours):
        raise SuppleError(f"{argument('label_colours')} is a colour table (.ctbl, .txt), and {shown(path)} is none")
    return colours


def comparison_of(stage: VolumeStage) -> Comparison | None:
    """Return the initial comparison of a volume with the fixed one; None if there is no fixed one."""
    fixed = None if stage.registration is None else stage.registration.fixed
    if fixed is None:
        return None
    transfer = default_transfer(fixed)
    hounsfield = isinstance(transfer, str) and transfer.startswith("ct-")
    return Comparison(first_window(fixed, "HU" if hounsfield else ""))


def write_landmarks(stage: VolumeStage, document: Document, path: PathLike, force: bool) -> None:
    """Write the landmarks of a volume to a table in LPS, and those of the fixed one to another, NAME-fixed.csv."""
    marks, known, geometry = document.state.marks, stage.registration, stage.volume.geometry
    assert marks is not None
    assert known is not None
    first = Path(path)
    if first.suffix.lower() != ".csv":
        raise SuppleError(f"{shown(path)}: landmarks are saved in tables: choose a name that ends in .csv")
    through = known.plain.behind(known.maps)
    for place, points in ((first, marks.points), (first.with_stem(f"{first.stem}-fixed"), marks.fixed)):
        there = np.isfinite(points).all(axis=1)
        own = through.inverse(points[there]).points if points is marks.points else points[there]
        rows = zip(np.array(marks.names)[there].tolist(), geometry.to_lps(own).tolist(), strict=True)
        with replacing(place, force=force) as made, open(made, "w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([("name", "l", "p", "s"), *((name, *at) for name, at in rows)])


def landmarks_of(stage: VolumeStage, options: ViewOptions) -> Landmarks | None:
    """Return the landmarks of files; with a fixed volume, there may be none yet; None where none can be set."""
    known, geometry = stage.registration, stage.volume.geometry
    names: tuple[str, ...] = ()
    points = np.zeros((0, 3))
    if options.points is not None:
        own = geometry if known is None else known.moving.geometry
        names, points = read_landmarks(options.points, own, convention=options.convention)
        if known is not None:
            points = known.plain.behind(known.maps).forward(geometry.from_lps(own.to_lps(points)))
    if known is None or known.fixed is None:
        return Landmarks(names, points) if options.points is not None else None
    if options.fixed_points is None:
        return Landmarks(names, points)
    others, fixed = read_landmarks(options.fixed_points, known.fixed.geometry, convention=options.convention)
    return (
        Landmarks.paired(names, points, others, fixed)
        if names
        else Landmarks(others, np.full_like(fixed, np.nan), fixed)
    )
