"""NRRD and MetaImage files, by SimpleITK."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from supple.errors import SuppleError
from supple.geometry import Geometry
from supple.media.files import check_output, replacing, shown
from supple.media.volume_data import (
    DTYPES,
    Array,
    PathLike,
    Volume,
    head_of,
    located,
    native,
    too_large,
    unreadable,
)

_LOADERS = {"NRRD": "NrrdImageIO", "MetaImage": "MetaImageIO"}
_DETACHED = {".nhdr", ".mhd"}
# what ITK notes for itself, and what it writes anyway
_OWN = re.compile(r"ITK_|NRRD_space$|NRRD_kinds|NRRD_sizes|NRRD_thicknesses")
_SILENCE = threading.Lock()


def library() -> Any:
    """SimpleITK, which is loaded here: whoever reads no such file need not wait for it."""
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)  # type: ignore[no-untyped-call]
    return SimpleITK


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep standard error clean: ITK's readers print there what they also raise."""
    with _SILENCE, contextlib.ExitStack() as stack:
        try:
            kept = os.dup(2)
        except OSError:  # it is closed, and nothing can be seen there
            yield
            return
        stack.callback(os.close, kept)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, nowhere)
        stack.callback(os.dup2, kept, 2)
        os.dup2(nowhere, 2)
        yield


def read(path: PathLike, form: str) -> Volume:
    """Read a NRRD or a MetaImage file, with its data beside it or in it.

    Parameters
    ----------
    path : str or os.PathLike
        The file with the header.
    form : str
        ``"NRRD"`` or ``"MetaImage"``.

    Raises
    ------
    SuppleError
        The file is missing, of another kind, damaged or cut short; its voxels are no real numbers; it has more axes
        than x, y, z and time.
    """
    sitk = library()
    head = head_of(path, 4)
    if form == "NRRD" and head != b"NRRD":
        raise unreadable(path, "it is no NRRD file", "check its name")
    reader = sitk.ImageFileReader()
    reader.SetFileName(os.fspath(path))
    reader.SetImageIO(_LOADERS[form])
    with failing(path, form):
        reader.ReadImageInformation()
    check_voxels(path, sitk, reader)
    sizes, ndim = tuple(reader.GetSize()), reader.GetDimension()
    series, components = ndim == 4, reader.GetNumberOfComponents()
    if ndim > 4 or (series and components > 1):
        held = " x ".join(map(str, (*sizes, components)))
        raise unreadable(path, f"it holds {held} values", "give x, y, z and either time or components")
    geometry = geometry_of(path, reader)
    if form == "NRRD":
        _check_spacings(path, ndim)
    told = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys() if not _OWN.match(key)}
    # SimpleITK has no words for matrices, such as NRRD's measurement frame
    header = {key: text for key, text in told.items() if not text.startswith("[UNKNOWN")}
    with failing(path, form, sizes):
        samples = sitk.GetArrayFromImage(reader.Execute())
    interval = abs(reader.GetSpacing()[3]) if series else 1.0
    samples = samples if ndim > 2 else samples[np.newaxis]
    return Volume(samples, geometry, shown(path), form, series, header, interval=interval)


def check_voxels(path: PathLike, sitk: Any, reader: Any) -> None:
    """Refuse voxels that are no real numbers."""
    kind = sitk.GetPixelIDValueAsString(reader.GetPixelID())
    if "integer" not in kind and (kind.startswith("complex") or "float" not in kind):
        raise unreadable(path, f"its voxels are {kind}", f"convert them to one of {', '.join(DTYPES)}")


def _check_spacings(path: PathLike, ndim: int) -> None:
    """Refuse a spacing that is no number, which ITK takes for 1; an axis that is not in space has none."""
    line = re.search(rb"(?mi)^spacings: *([^\r\n]*)", head_of(path, 1 << 16).split(b"\n\n")[0])
    steps = line[1].decode("latin-1").split() if line else []
    if steps and sum("nan" in step.lower() for step in steps) > len(steps) - ndim:
        raise unreadable(
            path, f"its spacing is {' x '.join(steps)}, and not three numbers above 0", "correct its header"
        )


def geometry_of(path: PathLike, reader: Any) -> Geometry:
    """Where ITK says that the voxels lie; what is flat gets a third axis of spacing 1."""
    ndim = reader.GetDimension()
    flat, direction = min(ndim, 3), np.eye(3)
    known = np.array(reader.GetDirection()).reshape(ndim, ndim)
    if ndim == 4 and (known[:3, 3].any() or known[3, :3].any()):
        raise unreadable(path, "its axis of time leans into space", "correct its header")
    direction[:flat, :flat] = known[:flat, :flat]
    spacing = [*reader.GetSpacing()[:flat], 1.0][:3]
    origin = [*reader.GetOrigin()[:flat], 0.0][:3]
    return located(path, spacing, origin, direction, "LPS")


@contextlib.contextmanager
def failing(path: PathLike, form: str, sizes: tuple[int, ...] = ()) -> Iterator[None]:
    """Make one sentence of ITK's long accounts of failure, and keep its prints off the terminal."""
    try:
        with silence():
            yield
    except MemoryError as error:
        raise too_large(path, sizes) from error
    except (RuntimeError, UnicodeError, ValueError) as error:
        text = str(error)
        if "allocate memory" in text:
            raise too_large(path, sizes) from error
        told = _reason(text)
        what = "it is cut short or damaged" if sizes else f"it is no {form} file, or damaged"
        raise unreadable(path, f"{what}{f' ({told})' if told else ''}") from error


def _reason(text: str) -> str:
    """The telling line of ITK's text, if there is one: the last, without who says it."""
    line = next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")
    line = re.sub(r"^.*ERROR: (\w+\(0x\w+\): )?", "", line)
    if line.startswith(("Reason: ", "Cannot read requested", "Unable to determine", "Exception thrown")):
        return ""  # the reason is what happened to fail last, somewhere
    return re.sub(r"^(\[\w+\] )?(\w+: )?", "", line).rstrip(".")


def write(path: PathLike, samples: Array, like: Volume, *, force: bool = False) -> None:
    """Write a NRRD file, compressed, or a MetaImage file, not compressed; .mhd has its data in a .raw beside it.

    Raises
    ------
    SuppleError
        The file cannot be written.
    """
    sitk = library()
    target = check_output(path, force=force)
    suffix = target.suffix.lower()
    with contextlib.ExitStack() as stack:
        made = [(stack.enter_context(replacing(path, force=force)), suffix)]
        if suffix == ".mhd":
            made.append((stack.enter_context(replacing(target.with_suffix(".raw"), force=force)), ".raw"))
        # ITK writes into a folder of its own, under the name that the header will tell
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=".", dir=target.parent)))
        file = folder / f"{target.stem}{suffix}"
        image = _image(sitk, samples, like, "NRRD" if suffix == ".nrrd" else "MetaImage")
        try:
            with silence():
                sitk.WriteImage(image, os.fspath(file), useCompression=suffix == ".nrrd")
        except (RuntimeError, UnicodeError) as error:
            found = re.search("Reason: (.+)", str(error))
            what = (found[1] if found else _reason(str(error))) or "ITK cannot write it"
            raise SuppleError(f"cannot write {shown(path)}: {what}: make room or choose another place") from error
        if not _whole(file.with_suffix(made[-1][1]), samples.nbytes, packed=suffix == ".nrrd"):
            raise OSError(errno.EIO, "a part of it was not written")  # ITK overlooks it at the end of a file
        for temporary, ending in made:
            os.replace(file.with_suffix(ending), temporary)


def _image(sitk: Any, samples: Array, like: Volume, form: str) -> Any:
    vector = samples.ndim == 4 and not like.series
    image = sitk.GetImageFromArray(native(samples), isVector=vector)
    geometry, direction = like.geometry, np.eye(image.GetDimension())
    direction[:3, :3] = geometry.direction
    image.SetSpacing((*geometry.spacing, like.interval) if like.series else geometry.spacing)
    image.SetOrigin((*geometry.origin, 0.0) if like.series else geometry.origin)
    image.SetDirection(direction.ravel().tolist())
    if like.format == form:
        for key, text in (like.header or {}).items():
            image.SetMetaData(key, text)
    return image


def _whole(file: Path, nbytes: int, *, packed: bool) -> bool:
    """Tell whether all voxels are in a file: gzip notes their count, modulo 2^32, at the end."""
    if not packed:
        return file.stat().st_size >= nbytes
    with open(file, "rb") as data:
        data.seek(-4, os.SEEK_END)
        return int.from_bytes(data.read(4), "little") == nbytes % (1 << 32)
