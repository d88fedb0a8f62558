"""The head as OME-Zarr, bent block by block, as an array that is larger than memory would be.

python warp_large.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
import zarr

import supple
import supple.dask
from supple.media import image

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"
STROKE = supple.Stroke.grab((45, 88, 62), to=(45, 76, 58), radius=16, reach=2)  # voxels, and a radius in millimetres


def main(folder: Path) -> None:
    # A volume becomes an OME-Zarr image, with its axes, units and position; without strokes, it is as it was.
    made = supple.warp_file(HEAD, folder / "head.zarr", supple.Recipe(strokes=[]), force=True)
    print(f"{made.shape} voxels in {made.blocks} blocks")

    # A store becomes another one; the map is written beside it, in both directions.
    recipe = supple.Recipe(strokes=[STROKE])
    made = supple.warp_file(
        folder / "head.zarr", folder / "bent.zarr", recipe, save_field=folder / "map.zarr", force=True
    )
    print(f"source points are known within {made.field.forward:.2g} voxels; the way back is explicit")
    head, bent = (zarr.open_group(folder / name, mode="r")["0"] for name in ("head.zarr", "bent.zarr"))

    # The same by Dask: nothing is sampled before it is asked for. Along depth, volumes are filtered as across.
    volume = {"between": "cubic", "time_filter": True}
    lazy = supple.dask.warp(head, made.deformation, chunks=32, **volume)
    print(f"{lazy.npartitions} blocks of {lazy.chunksize}")
    same = np.array_equal(lazy.compute(), bent[...])
    same &= np.array_equal(bent[...], made.deformation.warp(head[...], **volume))
    print("both are equal to the whole, bit for bit" if same else "they differ from the whole")
    changed = np.argwhere(bent[...] != head[...])
    print(f"what changed is within {changed.min(axis=0)[::-1]} to {changed.max(axis=0)[::-1]}; the rest is copied")

    # Another grid is sampled once, too, from the source itself.
    coarse = supple.dask.warp(head, made.deformation, made.deformation.grid.resampled(4.0), 32, **volume)
    print(f"at 4 mm: {coarse.shape} instead of {bent.shape}")
    seen = coarse.compute().repeat(2, 0).repeat(2, 1).repeat(2, 2)[tuple(map(slice, head.shape))]
    slices = [np.pad(each[::-1, :, 45], ((0, 1), (0, 1))) for each in (head[...], bent[...])]
    across = np.zeros_like(slices[0])
    across[: seen.shape[0], : seen.shape[1]] = seen[::-1, :, 45]
    image.write(folder / "large.png", np.hstack([*slices, across]).repeat(3, 0).repeat(3, 1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
