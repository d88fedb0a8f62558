"""The field of a registration inverted: where it folds, how exact the inverse is, and a head warped there and back."""

import sys
import warnings
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813

import supple
from supple.fields import OK
from supple.files.fields import check_file
from supple.media import image

HEAD = Path(supple.__file__).parent / "examples" / "data" / "head.nii.gz"


def registered(fixed: sitk.Image, moving: sitk.Image) -> sitk.Image:
    """Return the field of SimpleITK's Demons, from points of the fixed head to the moving one, at 4 mm."""
    method = sitk.FastSymmetricForcesDemonsRegistrationFilter()
    method.SetNumberOfIterations(60)
    method.SetStandardDeviations(0.6)  # voxels: so little smoothing that the field folds
    small = [sitk.Shrink(sitk.SmoothingRecursiveGaussian(head, 2), [2] * 3) for head in (fixed, moving)]
    return method.Execute(*small)


def main(folder: Path) -> None:
    warp, inverse = folder / "warp.nii.gz", folder / "inverse.nii.gz"
    fixed = sitk.ReadImage(str(HEAD), sitk.sitkFloat32)
    moving = sitk.GetImageFromArray(sitk.GetArrayViewFromImage(fixed)[:, :, ::-1])  # its mirror image
    moving.CopyInformation(fixed)
    sitk.WriteImage(registered(fixed, moving), str(warp))

    field = supple.Field.read(warp)  # ITK's, as its intent code says
    found = field.invert()
    print("inverse:", ", ".join(f"{count} {status}" for status, count in found.counts.items()))
    print(f"where it is ok, it is exact to {found.error[found.status == OK].max():.0e} mm")
    found.field.write(inverse, "itk", force=True)

    # As `supple check warp.nii.gz inverse.nii.gz --picture check.png`.
    report = check_file(warp, inverse, picture=folder / "check.png", force=True).report
    print(f"{report.folded} of {report.cells} cells fold, the least determinant is {report.determinant:.2f}")

    # To the fixed head, and back again: each is one map, and the head is sampled once.
    head = sitk.GetArrayFromImage(moving).astype(np.uint8)
    there = supple.Deformation(supple.grid_of(HEAD), border=None).field(field)
    back = there.field(found.field)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        ways = [d.warp(head, filter="linear") for d in (there, back)]
    print("\n".join(f"warning: {each.message}" for each in said))
    off = np.abs(ways[1].astype(int) - head).mean()
    print(f"there and back, grey values differ by {off:.2f} of 255 on average")
    shown = np.hstack([volume[45, ::-1] for volume in (head, *ways)])
    image.write(folder / "there_and_back.png", shown.repeat(3, axis=0).repeat(3, axis=1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
