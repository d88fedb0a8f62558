"""A surface in a file of each kind, as VTK writes it, and as VTK reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

vtk = pytest.importorskip("vtk")
support = pytest.importorskip("vtk.util.numpy_support")
Floats = npt.NDArray[np.float64]

KINDS = (
    "binary.stl", "text.stl", "in.obj", "binary.ply", "text.ply", "binary.vtk", "text.vtk", "old.vtk",
    *(f"{mode}-{codec}.vtp" for mode in ("Ascii", "Binary", "Appended") for codec in ("None", "ZLib", "LZMA")),
    "raw.vtp", "big.vtp",
)  # fmt: skip


def surface(centre: tuple[float, float, float] = (0, 0, 0), radius: float = 1.0) -> Any:
    """A sphere of triangles with normals, an array of points and one of cells, and a field."""
    source = vtk.vtkSphereSource()
    source.SetThetaResolution(12)
    source.SetPhiResolution(9)
    source.SetCenter(*centre)
    source.SetRadius(radius)
    source.Update()
    made = source.GetOutput()
    for data, count in ((made.GetPointData(), made.GetNumberOfPoints()), (made.GetCellData(), made.GetNumberOfCells())):
        array = support.numpy_to_vtk(np.arange(count, dtype=np.float32) / 7, deep=1)
        array.SetName("thickness")
        data.AddArray(array)
    said = vtk.vtkStringArray()
    said.SetName("SPACE")
    said.InsertNextValue("RAS")
    made.GetFieldData().AddArray(said)
    made.GetPoints().GetData().GetRange(-1)  # which is then noted in the file
    return made


def write(path: Path, mesh: Any) -> Path:
    """Write a surface into a file with a name of `KINDS`."""
    stem, suffix = path.stem, path.suffix
    writer = {
        ".stl": vtk.vtkSTLWriter,
        ".obj": vtk.vtkOBJWriter,
        ".ply": vtk.vtkPLYWriter,
        ".vtk": vtk.vtkPolyDataWriter,
        ".vtp": vtk.vtkXMLPolyDataWriter,
    }[suffix]()
    writer.SetFileName(str(path))
    writer.SetInputData(mesh)
    if suffix == ".stl":
        writer.SetHeader("3D Slicer output. SPACE=RAS")
    if suffix == ".vtk":
        writer.SetHeader("3D Slicer output. SPACE=RAS")
    if suffix == ".ply":
        writer.AddComment("3D Slicer output. SPACE=RAS")
    if stem == "old":
        writer.SetFileVersion(42)
    if suffix == ".vtp":
        mode, _, codec = {"raw": "Appended-ZLib", "big": "Appended-None"}.get(stem, stem).partition("-")
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{codec}")()
        if stem == "raw":
            writer.EncodeAppendedDataOff()
            writer.SetHeaderTypeToUInt64()
            writer.SetBlockSize(96)
        if stem == "big":
            writer.SetByteOrderToBigEndian()
    elif suffix != ".obj":
        writer.SetFileTypeToASCII() if stem == "text" else writer.SetFileTypeToBinary()
    assert writer.Write()
    if suffix == ".obj":
        path.write_text("# 3D Slicer output. SPACE=RAS\n" + path.read_text())
    return path


def read(path: Path) -> Any:
    """Return what VTK reads."""
    reader = {
        ".stl": vtk.vtkSTLReader,
        ".obj": vtk.vtkOBJReader,
        ".ply": vtk.vtkPLYReader,
        ".vtk": vtk.vtkPolyDataReader,
        ".vtp": vtk.vtkXMLPolyDataReader,
    }[path.suffix]()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def points(mesh: Any) -> Floats:
    return np.asarray(support.vtk_to_numpy(mesh.GetPoints().GetData()), np.float64)


def normals(mesh: Any) -> Floats | None:
    found = mesh.GetPointData().GetNormals()
    return None if found is None else np.asarray(support.vtk_to_numpy(found), np.float64)


def faces(mesh: Any) -> list[list[int]]:
    cells = (mesh.GetCell(k) for k in range(mesh.GetNumberOfCells()))
    return [[cell.GetPointId(k) for k in range(cell.GetNumberOfPoints())] for cell in cells]


def arrays(mesh: Any) -> dict[str, list[float]]:
    """All arrays of points and cells but the normals."""
    made = {}
    for kind, data in (("point", mesh.GetPointData()), ("cell", mesh.GetCellData())):
        for k in range(data.GetNumberOfArrays()):
            array = data.GetArray(k)
            if array.GetName() != "Normals":
                made[f"{kind} {array.GetName()}"] = support.vtk_to_numpy(array).ravel().tolist()
    return made
