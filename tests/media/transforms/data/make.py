"""Write the files of this folder, by OpenImageIO and ngff-zarr; see README.md."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import itkwasm
import ngff_zarr
import numpy as np
import OpenImageIO as oiio  # noqa: N813
import SimpleITK as sitk  # noqa: N813
from ngff_zarr.v06.zarr_metadata import Affine, Bijection, CoordinateSystemIdentifier, TransformSequence

HERE = Path(__file__).parent
SIZES, SPACING, ORIGIN = (6, 5, 4), (0.8, 1.1, 1.7), (-3.0, 5.0, 11.0)


def stmaps() -> None:
    """Write STMaps of a picture 24 wide, 18 high of a source 32 wide, 20 high, and what st_warp makes of them."""
    width, height, wide, high = 24, 18, 32, 20
    y, x = np.mgrid[0:height, 0:width]
    places = np.stack([x * wide / width + 2 * np.sin(y / 4) + 0.3, y * high / height + np.cos(x / 5) - 0.4], -1)
    places = np.clip(places, 2, [wide - 3, high - 3])
    st = np.dstack([(places[..., 0] + 0.5) / wide, 1 - (places[..., 1] + 0.5) / high, np.zeros((height, width))])
    v, u = np.mgrid[0:high, 0:wide]
    source = np.stack([u, v, 10 * np.sin(u / 5) * np.cos(v / 4)], -1)
    made = {"places": places, "source": source.astype(np.float32)}
    for kind, suffix in (("float", "exr"), ("half", "exr"), ("uint16", "tif")):
        path = HERE / f"stmap-{kind}.{suffix}"
        spec = oiio.ImageSpec(width, height, 3, kind)
        file = oiio.ImageOutput.create(str(path))
        file.open(str(path), spec)
        file.write_image(st.astype(np.float32))
        file.close()
        picture = oiio.ImageBuf(oiio.ImageSpec(wide, high, 3, "float"))
        picture.set_pixels(oiio.ROI(), made["source"])
        warped = oiio.ImageBufAlgo.st_warp(picture, oiio.ImageBuf(str(path)), "triangle", flip_t=True)
        made[path.stem] = warped.get_pixels(oiio.FLOAT)[:height, :width]
    np.savez_compressed(HERE / "st_warp.npz", **made)


def stores() -> None:
    """Write OME-Zarr stores of a field, in micrometers, and points that ITK moves by the same."""
    rng = np.random.default_rng(1)
    told = {}
    for n in (2, 3):
        sizes, spacing, origin, dims = SIZES[:n], SPACING[:n], ORIGIN[:n], list("zyx"[-n:])
        vectors = rng.normal(0, 0.5, (*sizes[::-1], n))
        kind = itkwasm.ImageType(n, "float64", "VariableLengthVector", n)
        image = itkwasm.Image(kind, "", list(origin), list(spacing), np.eye(n), list(sizes), {}, vectors)
        path = "coordinateTransformations/field"
        moved, field = ngff_zarr.itk_displacement_field_to_ngff_transform(image, dims, path=path)
        field.axes_units = dict.fromkeys(dims, "micrometer")
        scales = ngff_zarr.to_multiscales(field, scale_factors=[])

        own = sitk.GetImageFromArray(vectors, isVector=True)
        own.SetSpacing(spacing)
        own.SetOrigin(origin)
        first = sitk.DisplacementFieldTransform(own)
        second = sitk.AffineTransform(n)
        linear, shift = np.eye(n) + rng.normal(0, 0.1, (n, n)), rng.normal(0, 1, n)
        second.SetMatrix(linear.ravel().tolist())
        second.SetTranslation(shift.tolist())
        points = np.array(origin) + rng.uniform(0.5, 1, (20, n)) * (np.array(sizes) - 1.5) * spacing
        after = [first.TransformPoint(p.tolist()) for p in points]
        told[str(n)] = {"points": points.tolist(), "field": after, "both": [second.TransformPoint(p) for p in after]}

        alone = HERE / f"declared-{n}d.zarr"
        shutil.rmtree(alone, ignore_errors=True)
        ngff_zarr.to_ome_zarr(str(alone), ngff_zarr.declare_field_transform(scales), version="0.6")

        rows = np.column_stack([linear[::-1, ::-1], shift[::-1]])
        back = np.linalg.inv(np.vstack([rows, np.eye(n + 1)[-1]]))[:-1]
        steps = [moved, Affine(affine=rows.tolist())]
        inverse = TransformSequence(transformations=[Affine(affine=back.tolist()), moved])  # of no use, but allowed
        images = {}
        for name in ("fixed", "moving"):
            pixels = np.zeros(sizes[::-1], np.uint8)
            units = dict.fromkeys(dims, "micrometer")
            picture = ngff_zarr.to_ngff_image(pixels, dims, dict(zip(dims, spacing[::-1])), axes_units=units)  # noqa: B905
            images[name] = ngff_zarr.to_multiscales(picture, scale_factors=[])
        system = images["fixed"].metadata.coordinateSystems[0].name
        ends = [CoordinateSystemIdentifier(name=system, path=name) for name in images]
        whole = Bijection(
            input=ends[0], output=ends[1], forward=TransformSequence(transformations=steps), inverse=inverse
        )
        scene = HERE / f"scene-{n}d.zarr"
        shutil.rmtree(scene, ignore_errors=True)
        ngff_zarr.to_ome_zarr(f"{scene}/{path}", scales, version="0.6")
        described = ngff_zarr.NgffScene(images=images, coordinateTransformations=[whole])
        ngff_zarr.to_ome_zarr(str(scene), described, version="0.6", overwrite=False)
    (HERE / "points.json").write_text(json.dumps(told))


if __name__ == "__main__":
    stmaps()
    stores()
