"""A head in a Zarr array, bent block by block, as an array that is larger than memory would be.

python warp_large.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813
import zarr

import supple
import supple.dask
from supple.media import image

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
CHUNK = 16  # small, so that a small head has many


def stored(path: Path, samples: np.ndarray) -> zarr.Array:
    """Write samples as a Zarr array."""
    made = empty(path, samples.shape, samples.dtype)
    made[...] = samples
    return zarr.open_array(path, mode="r")


def empty(path: Path, shape: tuple[int, ...], dtype: np.dtype) -> zarr.Array:
    return zarr.create_array(path, shape=shape, dtype=dtype, chunks=(CHUNK,) * 3, overwrite=True)


def main(folder: Path) -> None:
    head = stored(folder / "head.zarr", sitk.GetArrayFromImage(sitk.ReadImage(str(HEAD))))
    d = supple.Deformation(supple.grid_of(HEAD)).grab((45, 88, 62), to=(45, 76, 58), radius=16, reach=2)

    # Blocks of two chunks along each axis: fewer chunks are read twice. Nothing is sampled yet.
    bent = supple.dask.warp(head, d, chunks=2 * CHUNK)
    print(f"{bent.npartitions} blocks of {bent.chunksize}, of which {bent.nbytes / 1e6:.1f} MB will be written")
    target = empty(folder / "bent.zarr", bent.shape, bent.dtype)
    bent.store(target, lock=False)  # each block has chunks of its own: no two tasks write the same one

    same = np.array_equal(target[...], d.warp(head[...]))
    print("the blocks are equal to the whole, bit for bit" if same else "the blocks differ from the whole")
    changed = np.argwhere(target[...] != head[...])
    print(f"what changed is within {changed.min(axis=0)[::-1]} to {changed.max(axis=0)[::-1]}; the rest is copied")

    # Another grid is sampled once, too, from the source itself.
    coarse = supple.dask.warp(head, d, d.grid.resampled(4.0), 2 * CHUNK)
    print(f"at 4 mm: {coarse.shape} instead of {bent.shape}")
    seen = coarse.compute().repeat(2, 0).repeat(2, 1).repeat(2, 2)[: head.shape[0], : head.shape[1], : head.shape[2]]
    slices = [np.pad(volume[::-1, :, 45], ((0, 1), (0, 1))) for volume in (head[...], target[...])]
    across = np.zeros_like(slices[0])
    across[: seen.shape[0], : seen.shape[1]] = seen[::-1, :, 45]
    image.write(folder / "large.png", np.hstack([*slices, across]).repeat(3, 0).repeat(3, 1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
