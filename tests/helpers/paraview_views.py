"""What a result's script shows in ParaView at some times. A program for pvbatch.

``pvbatch paraview_views.py open_in_paraview.py ANSWER.json TIME…`` draws ANSWER-0.png and so on,
and writes for each time the tip's places and the corners of the ground as ParaView has them.
"""

import json
import sys
from pathlib import Path

from paraview import servermanager
from paraview.simple import FindSource, GetAnimationScene, SaveScreenshot
from vtkmodules.util.numpy_support import vtk_to_numpy


def places(name, time_s):
    source = FindSource(name)
    source.UpdatePipeline(time_s)
    data = servermanager.Fetch(source)
    if data.IsA("vtkCompositeDataSet"):
        data = data.NewIterator().GetCurrentDataObject()
    return vtk_to_numpy(data.GetPoints().GetData()).tolist()


script, answer, *times = sys.argv[1:]
sys.argv = [script, str(Path(answer).with_suffix(".png"))]
opened = {"__file__": script, "__name__": "opened"}
exec(Path(script).read_text(), opened)
found = []
for number, time in enumerate(map(float, times)):
    GetAnimationScene().AnimationTime = time
    layout = opened["made"]
    png = Path(answer).with_name(f"{Path(answer).stem}-{number}.png")
    SaveScreenshot(str(png), layout, ImageResolution=[1400, 900], FontScaling="Do not scale fonts")
    found.append({"tip": places("tip, warped", time), "ground": places("plane", time)})
Path(answer).write_text(json.dumps(found))
