"""What ParaView itself finds in a series of fields: a program for pvbatch.

``pvbatch paraview_reads.py FOLDER STEP ANSWER.json PICTURE.png``
"""

import json
import sys
from pathlib import Path

from paraview import servermanager
from paraview.simple import (
    ADIOS2VTXReader,
    ColorBy,
    CreateView,
    Render,
    SaveScreenshot,
    Show,
    Transform,
    WarpByVector,
)

IGNORED = ("vtkOriginalPointIds", "vtkGhostType")


def describe(reader, step):
    reader.UpdatePipeline(reader.TimestepValues[step])
    information, data = reader.GetDataInformation(), servermanager.Fetch(reader)
    blocks = data.NewIterator()
    blocks.InitTraversal()
    grid = blocks.GetCurrentDataObject()
    return {
        "times": list(reader.TimestepValues),
        "n_points": information.GetNumberOfPoints(),
        "n_cells": information.GetNumberOfCells(),
        "cell_type": grid.GetCellType(0),
        "nodes_per_cell": grid.GetCell(0).GetNumberOfPoints(),
        "ranges": {
            name: [array.GetRange(i) for i in range(array.GetNumberOfComponents())]
            for name, array in reader.PointData.items()
            if name not in IGNORED
        },
    }


def draw(reader, png):
    warp = WarpByVector(Input=reader)
    warp.Vectors = ["POINTS", "displacement_m"]
    warp.ScaleFactor = 20.0
    squeezed = Transform(Input=warp)
    squeezed.Transform.Scale = [1.0, 1.0, 0.2]
    view = CreateView("RenderView")
    view.ViewSize = [400, 400]
    view.CameraPosition, view.CameraFocalPoint = [0.02, -0.02, 0.01], [0.0, 0.0, 0.002]
    view.CameraViewUp = [0.0, 0.0, 1.0]
    shown = Show(squeezed, view)
    ColorBy(shown, ("POINTS", "von_mises_Pa"))
    shown.RescaleTransferFunctionToDataRange(False)
    view.ResetCamera()
    Render(view)
    SaveScreenshot(png, view)


folder, step, answer, png = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
readers = {n: ADIOS2VTXReader(FileName=str(folder / n)) for n in ("solid.bp", "tip.bp")}
found = {name: describe(reader, step) for name, reader in readers.items()}
draw(readers["solid.bp"], png)
Path(answer).write_text(json.dumps(found))
