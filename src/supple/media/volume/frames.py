"""Multi-frame DICOM files, by pydicom: the positions of their frames, which GDCM assumes to be evenly stacked.

The attributes are those of DICOM PS3.3, C.7.6.16 (functional groups) and C.8.8.3 (doses).
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from supple.errors import needed
from supple.media.files import PathLike, unreadable
from supple.media.volume.data import Array

_ALIKE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The frames of a file; positions and directions are in LPS, in millimetres."""

    head: Any  # a pydicom.Dataset without pixels
    places: Array | None  # positions of the first pixel of each frame, shape (N, 3); None if not in the file
    direction: Array  # the columns are the directions of the rows, of the columns, and of the normal
    spacing: tuple[float, float]  # from a pixel to the next along a row, and along a column
    scales: Array  # the rescale slope and intercept of each frame, or of all: shape (N or 1, 2)

    @property
    def scale(self) -> tuple[float, float] | None:
        """The rescale slope and intercept, if all frames have the same."""
        slope, intercept = self.scales[0].tolist()
        return (slope, intercept) if (self.scales == self.scales[0]).all() else None

    def rescaled(self, samples: Array) -> Array:
        """Return values with each frame rescaled by its own scale; GDCM has applied that of the first frame to all."""
        if self.scale is not None:
            return samples
        slope, intercept = self.scales[0]
        made = np.empty(samples.shape, np.float32)
        for one, frame, (own, offset) in zip(made, samples, self.scales, strict=True):
            one[...] = np.rint((frame - intercept) / slope) * own + offset  # stored values are integers
        return made


def imported() -> Any:
    """Return pydicom, imported at the first use."""
    return needed("volume", "DICOM files", "pydicom")


def dataset(**values: Any) -> Any:
    """Return a dataset of pydicom with these attributes."""
    made = imported().Dataset()
    for name, value in values.items():
        setattr(made, name, value)
    return made


def head_of(path: PathLike) -> Any:
    """Return a file's pydicom.Dataset without pixels."""
    with quiet():
        return imported().dcmread(path, stop_before_pixels=True)


def without(made: Any, names: Iterable[str]) -> None:
    """Remove attributes from a dataset."""
    for name in names:
        if name in made:
            delattr(made, name)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress pydicom's warnings on odd values, which are not of use here, or are copied as they are."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="pydicom")
        yield


def item_of(head: Any, k: int, name: str) -> Any | None:
    """Return the item of a functional group for frame ``k``, its own or the shared one; None if there is none."""
    own, shared = head.PerFrameFunctionalGroupsSequence[k], head.get("SharedFunctionalGroupsSequence") or ()
    return next((group.get(name)[0] for group in (own, *shared[:1]) if group.get(name)), None)


def frames_of(path: PathLike) -> Frames:
    """Return the frames of a file; SuppleError if they differ in direction or spacing, or it is damaged."""
    try:
        head = head_of(path)
        with quiet():
            if head.get("PerFrameFunctionalGroupsSequence"):
                told = _grouped(head)
            elif head.get("GridFrameOffsetVector"):
                told = _dosed(head)
            else:
                scale = float(head.get("RescaleSlope") or 1), float(head.get("RescaleIntercept") or 0)
                return Frames(head, None, np.eye(3), (1.0, 1.0), np.array([scale]))
            places, directions, spacings, scales = (np.array(each, np.float64) for each in told)
            count = int(head.NumberOfFrames)
    except Exception as error:  # pydicom raises many types
        raise unreadable(path, "what it says of its frames is damaged") from error
    if places.shape != (count, 3) or not np.isfinite(places).all():
        if head.get("PerFrameFunctionalGroupsSequence") and places.size == 0:
            return Frames(head, None, np.eye(3), (1.0, 1.0), np.array([[1.0, 0.0]]))
        raise unreadable(path, f"it has {count} frames, and tells where {len(places)} of them lie")
    for what, each in (("directions", directions), ("spacings", spacings)):
        far = np.abs(each - each[0]).max(axis=1)
        if (odd := int(far.argmax())) and far[odd] > _ALIKE * max(1.0, float(np.abs(each[0]).max())):
            told_of = f"its frames have several {what} (frames 1 and {odd + 1})"
            raise unreadable(path, told_of, "convert it to slices, and take the odd ones out")
    across, down = directions[0].reshape(2, 3)
    normal = np.cross(across, down)
    y, x = spacings[0].tolist()
    if not (np.isfinite(scales).all() and scales[:, 0].all()):
        raise unreadable(path, "a rescale slope of its frames is 0, or no number", "correct its header")
    return Frames(head, places, np.stack([across, down, normal], axis=1), (x, y), scales)


def _grouped(head: Any) -> tuple[list[Any], ...]:
    """Return the positions, directions, spacings and scales of frames in functional groups; empty if missing."""
    rows: list[tuple[Any, ...]] = []
    for k in range(len(head.PerFrameFunctionalGroupsSequence)):
        place, turned, pixels, values = (
            item_of(head, k, f"{name}Sequence")
            for name in ("PlanePosition", "PlaneOrientation", "PixelMeasures", "PixelValueTransformation")
        )
        if place is None or turned is None or pixels is None:
            return [], [], [], []
        scale = [1, 0] if values is None else [values.RescaleSlope, values.RescaleIntercept]
        rows.append((place.ImagePositionPatient, turned.ImageOrientationPatient, pixels.PixelSpacing, scale))
    return tuple(map(list, zip(*rows, strict=True)))


def _dosed(head: Any) -> tuple[list[Any], ...]:
    """Return the same for a dose; its frames have offsets from the first one, or coordinates along the third axis."""
    across, down = np.reshape(np.array(head.ImageOrientationPatient, np.float64), (2, 3))
    offsets = np.array(head.GridFrameOffsetVector, np.float64)
    places = np.array(head.ImagePositionPatient, np.float64) + np.outer(offsets - offsets[0], np.cross(across, down))
    alike = [list(head.ImageOrientationPatient)], [list(head.PixelSpacing)], [[1, 0]]
    return list(places), *alike
