"""The suffixes of videos and volumes, and which files are volumes."""

from __future__ import annotations

import os
from pathlib import Path

from supple.media.files import PathLike, first_bytes, is_zarr

CLIPS = frozenset(
    {".3gp", ".asf", ".avi", ".flv", ".h264", ".h265", ".hevc", ".ivf", ".m2ts", ".m2v", ".m4v", ".mj2", ".mkv"}
    | {".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts", ".vob", ".webm", ".wmv", ".y4m"}
)
"""The suffixes of files that are always read as videos; other files are if the output is a video."""
CLIPS_OUT = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".gif")
ANIMATED = (".webp", ".apng")
"""The suffixes of animated pictures that a clip is written as; .png is one only if the source is a PNG."""
FORMATS = {
    **dict.fromkeys((".nii", ".nii.gz", ".hdr", ".img"), "NIfTI"),
    **dict.fromkeys((".nrrd", ".nhdr"), "NRRD"),
    **dict.fromkeys((".mha", ".mhd"), "MetaImage"),
    **dict.fromkeys((".mgz", ".mgh"), "MGH"),
    **dict.fromkeys((".dcm", ".dicom", ".ima"), "DICOM"),
    **dict.fromkeys((".dat", ".raw"), "raw"),
}
"""The formats of volumes, by their suffixes."""
VOLUMES = frozenset(FORMATS)
VOLUMES_OUT: tuple[str, ...] = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd", ".mgz", ".mgh", ".tif", ".tiff")


def suffix_of(path: PathLike) -> str:
    """Return the suffix that identifies the format, in lower case: ``.nii.gz``, ``.mha``, ... or nothing."""
    name = Path(path).name.lower()
    return ".nii.gz" if name.endswith(".nii.gz") else Path(name).suffix


def is_animation(target: PathLike, source: PathLike) -> bool:
    """Return whether a clip becomes an animated picture, WebP or PNG, by the names of both."""
    goal = suffix_of(target)
    return goal in ANIMATED or (goal == ".png" and suffix_of(source) in (".png", ".apng") and os.path.isfile(source))


def is_volume(path: PathLike) -> bool:
    """Return whether a file or folder is a volume: by its suffix, or, without one, by its first bytes.

    A folder is one if it holds DICOM files, or a Zarr store, which `supple.media.volume.read` refuses. For TIFFs, see
    `supple.media.volume.has_pages`. A Radiance image, which also has the suffix ``.hdr``, is not one.
    """
    suffix = suffix_of(path)
    if os.path.isdir(path):
        from supple.media.volume import dicom

        return is_zarr(path) or dicom.in_folder(path)
    if suffix == ".hdr":
        return first_bytes(path, 2) != b"#?"
    if suffix in VOLUMES or (suffix and not suffix[1:].isdigit()):
        return suffix in VOLUMES
    from supple.media.volume import dicom

    return dicom.is_slice(path)
