"""Points and files of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from supple.media.meshes import PointFile
from supple.media.points import read_points, write_points

Floats = npt.NDArray[np.float64]


def fcsv(points: Floats, system: str = "LPS") -> str:
    head = f"# Markups fiducial file version = 5.6\n# CoordinateSystem = {system}\n"
    head += "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    rows = [f'{k},{x!r},{y!r},{z!r},0,0,0,1,1,1,0,F-{k},"a, b",,2,0\n' for k, (x, y, z) in enumerate(points.tolist())]
    return head + "".join(rows)


def markup(points: Floats, system: str = "LPS") -> dict[str, Any]:
    controls = [
        {
            "id": str(k),
            "label": f"F-{k}",
            "position": point,
            "orientation": [-1.0, -0.0, -0.0, -0.0, -1.0, -0.0, 0.0, 0.0, 1.0],
            "selected": True,
            "positionStatus": "defined",
        }
        for k, point in enumerate(points.tolist())
    ]
    return {
        "type": "Fiducial",
        "coordinateSystem": system,
        "coordinateUnits": "mm",
        "controlPoints": controls,
        "measurements": [],
        "display": {"visibility": True, "color": [0.4, 1.0, 1.0]},
    }


def markups(*made: dict[str, Any]) -> str:
    return json.dumps({"@schema": "markups-schema-v1.0.3.json#", "markups": made}, indent=4)


def read(tmp_path: Path, text: str, name: str = "in.csv") -> PointFile:
    (tmp_path / name).write_bytes(text.encode())
    return read_points(tmp_path / name)


def rewritten(tmp_path: Path, file: PointFile, points: npt.ArrayLike, **options: Any) -> str:
    out = tmp_path / f"out{Path(file.name).suffix}"
    write_points(out, points, file, force=True, **options)
    return out.read_bytes().decode()
