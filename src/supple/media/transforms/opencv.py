"""Maps of OpenCV's remap: the absolute source position of each pixel."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from supple.media.files import PathLike, check_suffix, head_of, replacing, unreadable, unwritable
from supple.media.transforms.base import Array, Content, Grids
from supple.media.transforms.positions import of_positions, to_positions

SUFFIXES = (".npy", ".npz", ".xml", ".yml", ".yaml")
_WANTED = "give an array (H, W, 2) of source positions, or two of (H, W), named map1 and map2"
_PAIRS = (("map1", "map2"), ("mapx", "mapy"), ("xmap", "ymap"), ("x", "y"))
_STEPS = 32  # a pixel, in OpenCV's fixed point
_TYPES = {"u": np.uint8, "c": np.int8, "w": np.uint16, "s": np.int16, "i": np.int32, "f": np.float32, "d": np.float64}
_YAML = re.compile(
    r"^(\w+)\s*:\s*!!opencv-matrix\s+rows:\s*(\d+)\s+cols:\s*(\d+)\s+dt:\s*\"?(\w+)\"?\s+data:\s*\[([^\]]*)(\]?)",
    re.MULTILINE,
)
_LONGEST = 32_767  # pixels on a side, of cv2.remap


def read(path: PathLike, grids: Grids) -> tuple[Content, ...]:
    """Read a map for ``cv2.remap``; beyond its edges, it goes on as at the edge.

    ``.npy``: an array (H, W, 2), or (2, H, W), of float32 or float64, or of int16. ``.npz``: that, or two arrays (H, W)
    of names that tell x from y (map1 and map2, map_x and map_y, mapx and mapy, x and y). ``.xml``, ``.yml`` and
    ``.yaml``, as ``cv2.FileStorage`` writes them: matrices of these names. A map1 of int16 (H, W, 2) with a map2 of
    uint16 (H, W) is the fixed-point form of ``cv2.convertMaps``, to a thirty-second of a pixel.
    """
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, SUFFIXES, "is of no map of OpenCV's", f"use {', '.join(SUFFIXES)}", "read")
    if suffix == ".npy":
        maps: tuple[Array, Array | None] = (_loaded(path), None)
    else:
        maps = _chosen(path, {".npz": _archive, ".xml": _xml}.get(suffix, _yaml)(path))
    return (of_positions(path, *_planes(path, *maps)),)


def write(path: PathLike, contents: Sequence[Content], grids: Grids, *, force: bool = False) -> None:
    """Write a map for ``cv2.remap``, in float32: as one array (H, W, 2) in ``.npy``, else as map1 and map2, x and y."""
    suffix = Path(path).suffix.lower()
    check_suffix(path, suffix, SUFFIXES, "is of no map of OpenCV's", f"use {', '.join(SUFFIXES)}")
    places = to_positions(path, contents, "a map of OpenCV's").astype(np.float32)
    if max(places.shape) > _LONGEST:
        what = f"OpenCV's maps end at {_LONGEST} pixels on a side, and the field has {places.shape[1]} x {len(places)}"
        raise unwritable(path, what, "write an STMap")
    x, y = (np.ascontiguousarray(places[..., i]) for i in range(2))
    with replacing(path, force=force) as temporary, open(temporary, "wb") as file:
        if suffix == ".npy":
            np.save(file, places)
        elif suffix == ".npz":
            np.savez(file, map1=x, map2=y)
        elif suffix == ".xml":
            matrices = "".join(_in_xml(name, plane) for name, plane in (("map1", x), ("map2", y)))
            file.write(f'<?xml version="1.0"?>\n<opencv_storage>\n{matrices}</opencv_storage>\n'.encode())
        else:
            matrices = "".join(_in_yaml(name, plane) for name, plane in (("map1", x), ("map2", y)))
            file.write(f"%YAML:1.0\n---\n{matrices}".encode())


def _loaded(path: PathLike) -> Array:
    head_of(path, 1)
    try:
        with open(path, "rb") as file:
            return np.asarray(np.load(file, allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise unreadable(path, "it is no array of NumPy's, or cut short") from error


def _archive(path: PathLike) -> dict[str, Array]:
    head_of(path, 1)
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:  # NumPy's own stays open
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, AttributeError, TypeError, zipfile.BadZipFile) as error:
        raise unreadable(path, "it is no archive of NumPy's arrays, or cut short") from error


def _xml(path: PathLike) -> dict[str, Array]:
    try:
        root = ElementTree.fromstring(head_of(path, -1))
    except (ElementTree.ParseError, ValueError) as error:
        raise unreadable(path, f"it is no XML, or cut short ({error})") from error
    if root.tag != "opencv_storage":
        raise unreadable(path, f"its XML begins with <{root.tag}>, not <opencv_storage>", "write it by cv2.FileStorage")
    found = {}
    for item in root:
        if item.get("type_id") == "opencv-matrix":
            rows, cols, dt, data = ((item.findtext(key) or "").strip() for key in ("rows", "cols", "dt", "data"))
            found[item.tag] = _matrix(path, item.tag, rows, cols, dt.strip('"'), data.split())
    return found


def _yaml(path: PathLike) -> dict[str, Array]:
    text = head_of(path, -1).decode("utf-8", "replace")
    if not text.startswith("%YAML"):
        raise unreadable(path, "it does not begin with %YAML", "write it by cv2.FileStorage")
    found = {}
    for name, rows, cols, dt, data, end in _YAML.findall(text):
        if not end:
            raise unreadable(path, f"its matrix {name} is cut short")
        found[name] = _matrix(path, name, rows, cols, dt, data.replace(",", " ").split())
    return found


def _matrix(path: PathLike, name: str, rows: str, cols: str, dt: str, words: list[str]) -> Array:
    kind = re.fullmatch(r"([1-4]?)([ucwsifd])", dt)
    if kind is None or not rows.isdigit() or not cols.isdigit():
        raise unreadable(path, f"its matrix {name} has {rows} rows, {cols} columns and the type {dt!r}", _WANTED)
    shape = (int(rows), int(cols), int(kind[1])) if kind[1] not in ("", "1") else (int(rows), int(cols))
    try:
        numbers = np.array([float(word.replace(".Inf", "inf").replace(".Nan", "nan")) for word in words])
    except ValueError as error:
        raise unreadable(path, f"the data of its matrix {name} are no plain numbers", "write it as text") from error
    if numbers.size != np.prod(shape):
        what = f"its matrix {name} holds {numbers.size} numbers in place of {np.prod(shape)}"
        raise unreadable(path, what)
    return numbers.astype(_TYPES[kind[2]]).reshape(shape)


def _chosen(path: PathLike, named: dict[str, Array]) -> tuple[Array, Array | None]:
    """Return the arrays of x and of y by their names; or the only one."""
    filled = {name: array for name, array in named.items() if array.size}  # remap takes an empty map2
    if len(filled) == 1:
        return next(iter(filled.values())), None
    plain = {name.lower().replace("_", ""): array for name, array in filled.items()}
    pairs = [pair for pair in _PAIRS if set(pair) <= set(plain)]
    if len(pairs) != 1 or len(plain) != len(filled):
        names = ", ".join(named) or "nothing"
        raise unreadable(path, f"it holds {names}, which do not tell the map of x from that of y", _WANTED)
    (pair,) = pairs
    return plain[pair[0]], plain[pair[1]]


def _planes(path: PathLike, first: Array, second: Array | None) -> tuple[Array, Array]:
    """Return the source positions, x and y, of the maps in any of OpenCV's forms."""
    arrays = [first] if second is None else [first, second]
    shown = " and ".join(f"{array.dtype} of shape {array.shape}" for array in arrays)
    if any(array.dtype.kind not in "iuf" or array.dtype.itemsize > 8 for array in arrays):
        raise unreadable(path, f"it holds {shown}", "give real numbers: " + _WANTED)
    if second is None and first.ndim == 3 and 2 in (len(first), first.shape[-1]):
        if len(first) == first.shape[-1]:
            raise unreadable(path, f"{shown} may be of two rows or of two planes", "give two arrays, map1 and map2")
        x, y = (first[..., 0], first[..., 1]) if first.shape[-1] == 2 else (first[0], first[1])
    elif second is not None and first.ndim == 2 and first.shape == second.shape:
        x, y = first, second
    elif (
        second is not None
        and first.dtype == np.int16
        and second.dtype in (np.uint16, np.int16)
        and first.shape == (*second.shape, 2)
    ):
        x = first[..., 0] + (second & (_STEPS - 1)) / np.float32(_STEPS)
        y = first[..., 1] + (second // _STEPS & (_STEPS - 1)) / np.float32(_STEPS)
    else:
        raise unreadable(path, f"it holds {shown}", _WANTED)
    if 0 in x.shape:
        raise unreadable(path, f"it holds {shown}", _WANTED)
    return x, y


def _spelled(plane: Array) -> list[str]:
    return [" ".join(str(v) for v in row) for row in plane]


def _in_xml(name: str, plane: Array) -> str:
    head = f"<rows>{plane.shape[0]}</rows>\n<cols>{plane.shape[1]}</cols>\n<dt>f</dt>"
    data = "\n".join(_spelled(plane))
    return f'<{name} type_id="opencv-matrix">\n{head}\n<data>\n{data}</data></{name}>\n'


def _in_yaml(name: str, plane: Array) -> str:
    data = ",\n       ".join(row.replace(" ", ", ") for row in _spelled(plane))
    head = f"   rows: {plane.shape[0]}\n   cols: {plane.shape[1]}\n   dt: f\n"
    return f"{name}: !!opencv-matrix\n{head}   data: [ {data} ]\n"
