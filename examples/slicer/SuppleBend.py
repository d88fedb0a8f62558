"""A module of 3D Slicer: draw lines on a volume, and pull each first point to the second.

Settings, Modules, Additional module paths: this folder; then restart. Slicer's Python needs Supple:
slicer.util.pip_install("supple[volume]"). docs/volumes.md has a manual test.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import ctk
import numpy as np
import qt
import slicer
import vtk
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleWidget,
)

LINE, MARK = "vtkMRMLMarkupsLineNode", "Supple.pull"


class SuppleBend(ScriptedLoadableModule):
    def __init__(self, parent: Any) -> None:
        ScriptedLoadableModule.__init__(self, parent)
        parent.title = "Supple Bend"
        parent.categories = ["Registration"]
        parent.contributors = ["The Supple developers"]
        parent.helpText = "Pull points of a volume, see it bent, and keep the grid transform. Not for diagnosis."


class SuppleBendWidget(ScriptedLoadableModuleWidget):
    def setup(self) -> None:
        ScriptedLoadableModuleWidget.setup(self)
        self.logic = SuppleBendLogic()
        form = qt.QFormLayout()
        self.layout.addLayout(form)
        self.volume = slicer.qMRMLNodeComboBox()
        self.volume.nodeTypes = ["vtkMRMLScalarVolumeNode"]
        self.volume.addEnabled = self.volume.removeEnabled = False
        self.volume.setMRMLScene(slicer.mrmlScene)
        self.radius = ctk.ctkSliderWidget()
        self.radius.minimum, self.radius.maximum, self.radius.value = 2, 200, 40
        self.radius.suffix = " mm"
        form.addRow("Volume", self.volume)
        form.addRow("Radius", self.radius)
        for text, action in (("Draw a pull", self.draw), ("Bend", self.bend), ("Show the original", self.restore)):
            button = qt.QPushButton(text)
            button.connect("clicked()", action)
            form.addRow(button)
        self.layout.addStretch(1)

    def draw(self) -> None:
        self.logic.restore(self.volume.currentNode())  # pulls start where things were
        self.logic.draw()

    def bend(self) -> None:
        try:
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                self.logic.bend(self.volume.currentNode(), self.radius.value)
        except ModuleNotFoundError as error:
            advice = 'in the Python console, slicer.util.pip_install("supple[volume]")'
            slicer.util.errorDisplay(f"Supple needs {error.name}, which is not installed: {advice}")
        except ValueError as error:  # as all that a person can mend
            slicer.util.errorDisplay(str(error))
        else:
            for text in dict.fromkeys(str(one.message) for one in told):  # such as a pull that does not arrive
                slicer.util.warningDisplay(text)

    def restore(self) -> None:
        self.logic.restore(self.volume.currentNode())


class SuppleBendLogic(ScriptedLoadableModuleLogic):
    def draw(self) -> Any:
        """Let the next two clicks in a slice make a line."""
        line = slicer.mrmlScene.AddNewNodeByClass(LINE, "Pull")
        line.SetAttribute(MARK, "1")
        selection, interaction = (
            slicer.mrmlScene.GetNodeByID(f"vtkMRML{name}NodeSingleton") for name in ("Selection", "Interaction")
        )
        selection.SetReferenceActivePlaceNodeClassName(LINE)
        selection.SetActivePlaceNodeID(line.GetID())
        interaction.SetCurrentInteractionMode(interaction.Place)
        return line

    def pulls(self) -> list[tuple[list[float], list[float]]]:
        """Return the two points of each line that was drawn, in RAS."""
        found = []
        for line in slicer.util.getNodesByClass(LINE):
            if line.GetAttribute(MARK) and line.GetNumberOfControlPoints() == 2:
                start, end = [0.0] * 3, [0.0] * 3
                line.GetNthControlPointPositionWorld(0, start)
                line.GetNthControlPointPositionWorld(1, end)
                found.append((start, end))
        return found

    def bend(self, volume: Any, radius: float) -> Any:
        """Bend a volume by all pulls; return the grid transform under which it then lies."""
        if volume is None:
            raise ValueError("there is no volume: load one, and choose it")
        self.restore(volume)
        if volume.GetParentTransformNode() is not None:
            raise ValueError(f"{volume.GetName()} lies under a transform of its own: harden that first")
        pulls = self.pulls()
        if not pulls:
            raise ValueError("there are no pulls: draw one, from a point to its new place")
        from supple import Deformation
        from supple.media.transforms.itk import write_field
        from supple.space.geometry import Geometry

        held = vtk.vtkMatrix4x4()
        volume.GetIJKToRASMatrix(held)
        matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ slicer.util.arrayFromVTKMatrix(held)
        spacing = np.linalg.norm(matrix[:3, :3], axis=0)
        geometry = Geometry(tuple(spacing), tuple(matrix[:3, 3]), matrix[:3, :3] / spacing, "RAS")
        shape = slicer.util.arrayFromVolume(volume).shape[:3]
        deformation = Deformation(shape, spacing=geometry.spacing)
        for start, end in pulls:
            deformation = deformation.grab(geometry.from_world(start), to=geometry.from_world(end), radius=radius)
        source = deformation.inverse_map()  # of each voxel of the result, x first
        axes = np.meshgrid(*map(np.arange, shape), indexing="ij")[::-1]
        moved = ((source - np.stack(axes, axis=-1)) * geometry.spacing) @ geometry.direction.T
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "field.h5"
            write_field(path, moved.astype(np.float32), geometry)
            transform = slicer.util.loadTransform(str(path))
        slicer.mrmlScene.RemoveNode(transform.GetStorageNode())  # it was of that folder: Save asks for a place
        transform.SetName(f"{volume.GetName()} bent")
        transform.SetAttribute(MARK, "1")
        volume.SetAndObserveTransformNodeID(transform.GetID())
        return transform

    def restore(self, volume: Any) -> None:
        """Show a volume as it was; transforms stay in the scene."""
        above = None if volume is None else volume.GetParentTransformNode()
        if above is not None and above.GetAttribute(MARK):
            volume.SetAndObserveTransformNodeID(None)
