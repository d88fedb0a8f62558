"""Maps of pictures as absolute source positions: maps of OpenCV's remap in pixels, and STMaps of compositors.

An STMap is an image whose red and green are the normalised source position of each pixel: red, s, goes from 0 at the
left edge of the source to 1 at its right edge; green, t, from 0 at the bottom to 1 at the top, as in Nuke. The identity
is ((x + 0.5) / W, 1 - (y + 0.5) / H), with y down. OpenImageIO's ``st_warp`` reads it with ``flip_t``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from supple.engine.work import Array
from supple.errors import OutsideWarning, needed, shown, warn
from supple.media import image
from supple.media.files import PathLike, check_suffix, head_of, refusing, replacing, unreadable, unwritable
from supple.media.image import exr
from supple.media.transforms.base import Content, Displacements, Grids, Matrix, only_field
from supple.space.geometry import Grid

REMAP = (".npy", ".npz", ".xml", ".yml", ".yaml")
STMAP = (".exr", ".tif", ".tiff", ".png")
STMAP_OUT = (".exr", ".tif", ".tiff")
_ADVICE = "give an array (H, W, 2) of source positions, or two of (H, W), named map1 and map2"
_STMAP_ADVICE = "an STMap needs red and green of 16 or 32 bits"
_MAPS = (("map1", "map2"), ("mapx", "mapy"), ("xmap", "ymap"), ("x", "y"))
_CHANNELS = (("R", "G"), ("S", "T"), ("U", "V"), ("X", "Y"))
_STEPS = 32  # a pixel in OpenCV's fixed-point maps
_LONGEST = 32_767  # pixels on a side, the limit of cv2.remap
_WHITE = 65_535
_Planes = tuple[Array, Array, Array | None, tuple[int, int], tuple[int, int]]


def displacements(path: PathLike, x: Array, y: Array, first: tuple[int, int] = (0, 0)) -> Displacements:
    """Return displacements for a map, from the source positions x and y (H, W) of pixels, the first at ``first``."""
    height, width = x.shape
    values = np.empty((height, width, 2), np.float64 if max(x.itemsize, y.itemsize) == 8 else np.float32)
    np.subtract(x, np.arange(first[0], first[0] + width, dtype=np.float64), out=values[..., 0], casting="same_kind")
    rows = np.arange(first[1], first[1] + height, dtype=np.float64)[:, None]
    np.subtract(y, rows, out=values[..., 1], casting="same_kind")
    if bad := np.count_nonzero(~np.isfinite(values).all(axis=-1)):
        be = "is" if bad == 1 else "are"
        raise unreadable(path, f"{bad} of its {height * width} positions {be} NaN or infinite", "fill them first")
    return Displacements(values, Grid((height, width), origin=first), beyond="edge")


def _positions(path: PathLike, contents: Sequence[Content], form: str) -> Matrix:
    """Return the source positions (H, W, 2) of a picture's pixels; SuppleError if there is not exactly one such map."""
    field = only_field(path, contents, form, 2)
    grid = field.grid
    if not np.array_equal(grid.matrix, np.eye(3)):
        where = f"a spacing of {grid.spacing}, an origin of {grid.origin} and a direction of {grid.direction}"
        what = f"{form} has a sample at each pixel, and the field has {where}"
        raise unwritable(path, what, "sample the map on the pixels of the picture first")
    return np.asarray(field.values + np.moveaxis(np.indices(grid.shape, np.float64), 0, -1)[..., ::-1])


def read_remap(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read a map for ``cv2.remap``; beyond its edges, displacements are those of the edge.

    ``.npy``: an array (H, W, 2) or (2, H, W) of float32, float64 or int16. ``.npz``: the same, or two arrays (H, W)
    named map1 and map2, map_x and map_y, mapx and mapy, or x and y. ``.xml``, ``.yml`` and ``.yaml``, as written by
    ``cv2.FileStorage``: matrices with these names. A map1 of int16 (H, W, 2) with a map2 of uint16 (H, W) is the
    fixed-point form of ``cv2.convertMaps``, with a resolution of 1/32 pixel.
    """
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, REMAP, "is of no map of OpenCV's", f"use {', '.join(REMAP)}", "read")
    arrays = (_arrays if suffix in (".npy", ".npz") else _matrices)(path)
    return (displacements(path, *_planes(path, _chosen(path, arrays))),)


def write_remap(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a map for ``cv2.remap``, in float32: as one array (H, W, 2) in ``.npy``, else as map1 and map2, x and y."""
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, REMAP, "is of no map of OpenCV's", f"use {', '.join(REMAP)}")
    places = np.ascontiguousarray(_positions(path, contents, "a map of OpenCV's"), np.float32)
    if max(places.shape) > _LONGEST:
        what = f"OpenCV's maps end at {_LONGEST} pixels on a side, and the field has {places.shape[1]} x {len(places)}"
        raise unwritable(path, what, "write an STMap")
    maps = {f"map{i + 1}": np.ascontiguousarray(places[..., i]) for i in range(2)}
    with replacing(path, force=force) as temporary, open(temporary, "wb") as file:
        if suffix == ".npy":
            # np.save closes a duplicate of the file, and misses errors of its last bytes, such as a full disk.
            np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(places))
            file.write(places.data)
        elif suffix == ".npz":
            np.savez(file, map1=maps["map1"], map2=maps["map2"])
        else:
            cv2 = _opencv()
            storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
            for name, plane in maps.items():
                storage.write(name, plane)
            file.write(storage.releaseAndGetString().encode())


def _arrays(path: PathLike) -> dict[str, Array]:
    head_of(path, 1)
    kind = "array" if Path(path).suffix.lower() == ".npy" else "archive"
    try:
        with open(path, "rb") as file:
            found = np.load(file, allow_pickle=False)
            if kind == "array":
                return {"": np.asarray(found)}
            with found:
                return {name: found[name] for name in found.files}
    except (OSError, ValueError, EOFError, AttributeError, TypeError, zipfile.BadZipFile) as error:
        raise unreadable(path, f"it is no {kind} of NumPy's, or cut short") from error


def _matrices(path: PathLike) -> dict[str, Array]:
    """Return the matrices of a file of ``cv2.FileStorage``."""
    cv2, text = _opencv(), head_of(path, -1).decode("utf-8", "replace")
    what = "it is no whole file of matrices, as cv2.FileStorage writes them"
    with refusing(lambda _: unreadable(path, what, _ADVICE), Exception):  # OpenCV raises several types
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        nodes = {name: storage.getNode(name) for name in storage.root().keys()}  # noqa: SIM118, not a dict
        return {name: np.asarray(node.mat()) for name, node in nodes.items() if node.isMap()}


def _opencv() -> Any:
    return needed("flow", "maps of OpenCV in XML and YAML", "cv2")


def _chosen(path: PathLike, named: dict[str, Array]) -> list[Array]:
    filled = {name: array for name, array in named.items() if array.size or not name}  # map2 may be empty for remap
    if len(filled) == 1:
        return list(filled.values())
    plain = {name.lower().replace("_", ""): array for name, array in filled.items()}
    pairs = [pair for pair in _MAPS if set(pair) <= set(plain)]
    if len(pairs) != 1 or len(plain) != len(filled):
        names = ", ".join(named) or "nothing"
        raise unreadable(path, f"it holds {names}, which do not tell the map of x from that of y", _ADVICE)
    return [plain[name] for name in pairs[0]]


def _planes(path: PathLike, arrays: list[Array]) -> tuple[Array, Array]:
    """Return the source positions, x and y, of the maps in any of OpenCV's forms."""
    first, second = arrays[0], arrays[-1]
    what = " and ".join(f"{array.dtype} of shape {array.shape}" for array in arrays)
    if any(array.dtype.kind not in "iuf" or array.dtype.itemsize > 8 or 0 in array.shape for array in arrays):
        raise unreadable(path, f"it holds {what}", "give real numbers: " + _ADVICE)
    if len(arrays) == 1 and first.ndim == 3 and 2 in (len(first), first.shape[-1]):
        if len(first) == first.shape[-1]:
            raise unreadable(path, f"{what} may be of two rows or of two planes", "give two arrays, map1 and map2")
        return (first[..., 0], first[..., 1]) if first.shape[-1] == 2 else (first[0], first[1])
    if len(arrays) == 2 and first.ndim == 2 and first.shape == second.shape:
        return first, second
    fixed = first.dtype == np.int16 and second.dtype in (np.uint16, np.int16) and first.shape == (*second.shape, 2)
    if len(arrays) == 2 and fixed:
        parts = (second & (_STEPS - 1), second // _STEPS & (_STEPS - 1))
        x, y = (first[..., k] + part / np.float32(_STEPS) for k, part in enumerate(parts))
        return x, y
    raise unreadable(path, f"it holds {what}", _ADVICE)


def read_stmap(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read an STMap, in pixels; beyond its edges, displacements are those of the edge.

    It is an ``.exr`` of 16 or 32 bits (half floats are exact to about 1/4000 of the source's size); a ``.tif``,
    ``.tiff`` or ``.png`` of 16 bits (exact to half of 1/65535); or a ``.tif`` of 32 bits. Blue is ignored, and so is
    constant opacity. Opacity that varies is an error, as a map is undefined where it is transparent.

    1 stands for the width and the height of the source, by default those of the map, for an EXR those of its display
    window; pixels beyond that window (overscan) are kept.
    """
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, STMAP, "is of no STMap", f"use {', '.join(STMAP)}", "read")
    s, t, opacity, first, own = (_of_exr if suffix == ".exr" else _of_picture)(path)
    if opacity is not None and (thin := np.count_nonzero(opacity != opacity.flat[0])):
        what = f"its opacity changes, at {thin} pixels, and where it is transparent an STMap is not defined"
        raise unreadable(path, what, "fill these parts, or write it without alpha")
    (height, width), (x0, y0) = s.shape, first
    if x0 > 0 or y0 > 0 or x0 + width < own[0] or y0 + height < own[1]:
        text = f"{shown(path)} holds {width} x {height} pixels of its {own[0]} x {own[1]}: beyond, its edge goes on"
        warn(text, OutsideWarning)
    width, height = _size(path, grids, own, unreadable)
    x, y = (s.astype(np.float64) * width - 0.5, (1 - t.astype(np.float64)) * height - 0.5)
    found = displacements(path, x, y, first)
    return (found._replace(values=found.values.astype(np.float32)),)


def write_stmap(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write an STMap, with blue at 0; 1 stands for the width and the height of the source, by default the field's.

    An ``.exr`` has 32-bit floats; ``.tif`` and ``.tiff`` have 16-bit integers, with an error of up to half of 1/65535
    of the source's size (0.03 pixels for 4096), and cannot hold positions outside the source.
    """
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, STMAP_OUT, "is of no STMap", f"use {', '.join(STMAP_OUT)}")
    places = _positions(path, contents, "an STMap")
    height, width = places.shape[:2]
    st = (places + 0.5) / _size(path, grids, (width, height), unwritable)
    st[..., 1] = 1 - st[..., 1]
    if suffix != ".exr" and (outside := np.count_nonzero(((st < 0) | (st > 1)).any(axis=-1))):
        raise unwritable(path, f"{outside} positions are outside the source, and a TIFF ends there", "write an EXR")
    pixels = np.zeros((height, width, 3), np.float32 if suffix == ".exr" else np.uint16)
    pixels[..., :2] = st if suffix == ".exr" else np.rint(st * _WHITE)
    image.write(path, pixels, force=force)


def _size(
    path: PathLike, grids: Grids, own: tuple[int, int], refused: Callable[[PathLike, str, str], Exception]
) -> tuple[int, ...]:
    """Return the width and height for which 1 stands: those of the source, or the map's own."""
    if grids.source is not None and grids.source.ndim != 2:
        raise refused(path, "an STMap is of a picture, and the source is a volume", "give the grid of a picture")
    return own if grids.source is None else grids.source.sizes


def _of_picture(path: PathLike) -> _Planes:
    found = image.read(path)
    pixels = found.pixels
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.dtype not in (np.uint16, np.float32, np.float64) or channels - found.alpha < 2:
        raise unreadable(path, f"it has {channels} channels of {pixels.dtype}", _STMAP_ADVICE)
    scaled = pixels if pixels.dtype.kind == "f" else pixels / np.float64(_WHITE)
    opacity = pixels[..., -1] if found.alpha else None
    return scaled[..., 0], scaled[..., 1], opacity, (0, 0), (pixels.shape[1], pixels.shape[0])


def _of_exr(path: PathLike) -> _Planes:
    with exr.opened(path) as file:
        names, header = dict(file.channels()), file.header()
        windows = [np.array(header[key], np.int64) for key in ("dataWindow", "displayWindow")]
    pairs = _pairs(names)
    if len(pairs) != 1:
        which = "more than one pair" if pairs else "no pair"
        raise unreadable(path, f"its channels {', '.join(names)} hold {which} of s and t", _STMAP_ADVICE)
    ((red, green),) = pairs
    s, t = names[red].pixels, names[green].pixels
    if s.dtype.kind != "f" or t.dtype.kind != "f":
        raise unreadable(path, f"its channels {red} and {green} are of {s.dtype}", "write floats of 16 or 32 bits")
    alpha = names.get(red.rpartition(".")[0] + "." * ("." in red) + "A")
    (low, _), (least, most) = windows
    first, own = (low - least).tolist(), (most - least + 1).tolist()
    return s, t, None if alpha is None else alpha.pixels, (first[0], first[1]), (own[0], own[1])


def _pairs(names: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the candidate pairs of channels for s and t: R and G, else other pairs without a layer, else all pairs."""
    found = []
    for name in names:
        layer, dot, channel = name.rpartition(".")
        other = dict(_CHANNELS).get(channel.upper())
        found += [(name, mate) for mate in names if other and mate.upper() == f"{layer}{dot}{other}".upper()]
    plain = [pair for pair in found if "." not in pair[0]]
    return [pair for pair in plain if pair[0] == "R"] or plain or found
