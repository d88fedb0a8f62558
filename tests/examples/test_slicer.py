"""The module for 3D Slicer, on a stub of what it calls of Slicer; matrices are VTK's own."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

import supple
from supple.space.geometry import Geometry
from tests.children import ROOT

pytest.importorskip("vtk")  # of which Slicer's matrices are

SHAPE, SPACING = (18, 26, 22), (1.5, 2.0, 2.5)


class Node:
    """A node of a scene: its attributes, and for lines their points."""

    def __init__(self, name: str, **known: Any) -> None:
        self.name, self.attributes, self.above = name, {}, None
        self.__dict__.update(known)

    def GetName(self) -> str:  # noqa: N802
        return self.name

    def SetName(self, name: str) -> None:  # noqa: N802
        self.name = name

    def GetID(self) -> Node:  # noqa: N802
        return self

    def GetAttribute(self, name: str) -> str | None:  # noqa: N802
        return self.attributes.get(name)

    def SetAttribute(self, name: str, value: str) -> None:  # noqa: N802
        self.attributes[name] = value

    def GetParentTransformNode(self) -> Any:  # noqa: N802
        return self.above

    def SetAndObserveTransformNodeID(self, above: Any) -> None:  # noqa: N802
        self.above = above

    def GetNumberOfControlPoints(self) -> int:  # noqa: N802
        return len(self.points)

    def GetNthControlPointPositionWorld(self, k: int, into: list[float]) -> None:  # noqa: N802
        into[:] = self.points[k]

    def GetIJKToRASMatrix(self, into: Any) -> None:  # noqa: N802
        into.DeepCopy(self.matrix.ravel().tolist())

    def GetStorageNode(self) -> str:  # noqa: N802
        return "storage"


class Slicer(ModuleType):
    """What the module calls of ``slicer``."""

    def __init__(self) -> None:
        super().__init__("slicer")
        self.lines: list[Node] = []
        self.removed: list[Any] = []
        self.shown: list[str] = []
        self.selection: dict[str, Any] = {}
        single = SimpleNamespace(
            Place=1,
            SetReferenceActivePlaceNodeClassName=lambda name: self.selection.update(kind=name),
            SetActivePlaceNodeID=lambda node: self.selection.update(node=node),
            SetCurrentInteractionMode=lambda mode: self.selection.update(mode=mode),
        )
        self.mrmlScene = SimpleNamespace(
            AddNewNodeByClass=self.add, GetNodeByID=lambda name: single, RemoveNode=self.removed.append
        )
        self.util = SimpleNamespace(
            getNodesByClass=lambda name: self.lines,
            arrayFromVTKMatrix=lambda m: np.array([[m.GetElement(i, j) for j in range(4)] for i in range(4)]),
            arrayFromVolume=lambda node: node.samples,
            loadTransform=lambda path: Node(Path(path).stem, transform=sitk.ReadTransform(path)),
            errorDisplay=self.shown.append,
            warningDisplay=self.shown.append,
        )

    def add(self, kind: str, name: str) -> Node:
        self.lines.append(Node(name, kind=kind, points=[]))
        return self.lines[-1]


def base(name: str) -> type:
    return type(name, (), {"__init__": lambda self, parent=None: None, "setup": lambda self: None})


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Slicer]:
    fake, scripted = Slicer(), ModuleType("slicer.ScriptedLoadableModule")
    for name in ("", "Widget", "Logic"):
        setattr(scripted, f"ScriptedLoadableModule{name}", base(f"Module{name}"))
    for name, module in (("slicer", fake), ("slicer.ScriptedLoadableModule", scripted)):
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("qt", "ctk"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    spec = importlib.util.spec_from_file_location("SuppleBend", ROOT / "examples" / "slicer" / "SuppleBend.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made, fake


def place() -> Geometry:
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    return Geometry(SPACING, (-11.0, 7.0, 30.0), turn * (1, -1, 1), "RAS")


def volume() -> Node:
    matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ place().matrix
    return Node("2: head/neck", samples=np.zeros(SHAPE), matrix=matrix)


def test_a_pull_becomes_a_transform_that_itk_applies(scene: tuple[Any, Slicer]) -> None:
    module, fake = scene
    logic, head = module.SuppleBendLogic(), volume()
    line = logic.draw()
    assert fake.selection == {"kind": "vtkMRMLMarkupsLineNode", "node": line, "mode": 1}
    start, end = (place().to_world(p, "RAS").tolist() for p in ((11, 12, 9), (12.5, 13, 10)))
    line.points = [start, end]
    fake.lines.append(Node("ruler", points=[end, start]))  # drawn for something else
    made = logic.bend(head, 12.0)
    assert head.above is made
    assert made.name == "2: head/neck bent"
    assert fake.removed == ["storage"]
    d = supple.Deformation(SHAPE, spacing=SPACING).grab((11, 12, 9), to=(12.5, 13, 10), radius=12)
    for point in ((12.0, 13.0, 10.0), (6.0, 9.0, 8.0), (11.0, 12.0, 9.0)):
        wanted = place().to_lps(d.inverse(point).points)
        found = made.transform.TransformPoint(place().to_lps(point).tolist())
        np.testing.assert_allclose(found, wanted, atol=0.03)
    assert np.linalg.norm(place().to_lps(d.inverse((12.5, 13, 10)).points) - place().to_lps((12.5, 13, 10))) > 3
    again = logic.bend(head, 12.0)  # from the original, not from what is bent already
    assert head.above is again is not made
    logic.restore(head)
    assert head.above is None


def test_what_cannot_be_done_is_told(scene: tuple[Any, Slicer]) -> None:
    module, fake = scene
    widget = module.SuppleBendWidget()
    widget.logic, head = module.SuppleBendLogic(), volume()
    widget.radius = SimpleNamespace(value=12.0)

    def told(node: Node | None) -> str:
        widget.volume = SimpleNamespace(currentNode=lambda: node)
        widget.bend()
        return fake.shown.pop()

    assert told(None) == "there is no volume: load one, and choose it"
    assert told(head) == "there are no pulls: draw one, from a point to its new place"
    head.above = Node("registration")
    assert told(head) == "2: head/neck lies under a transform of its own: harden that first"
    assert head.above.name == "registration"
    head.above = None
    line = widget.logic.draw()
    line.points = [place().to_world(p, "RAS").tolist() for p in ((-3, 12, 9), (-2, 12, 9))]
    assert "outside" in told(head)  # a warning: it is bent all the same
    assert head.above is not None
    widget.radius.value = -1.0
    assert told(head).startswith("radius must be")
    assert head.above is None
