"""How does a result open in ParaView in one step, with the right view?

``open_in_paraview.py`` is written beside the result. It finds the fields in its own folder, so a
result may be moved, and runs in ParaView's own Python, where nothing of this program is needed.
"""

from __future__ import annotations

import pprint
from pathlib import Path
from typing import Any

from ...solver.paraview import SOLID_FILE, TIP_FILE
from ..running.files import write_atomically
from .wave import Wave

SCRIPT_FILE = "open_in_paraview.py"
WHOLE_WIDTHS = 6.0
"""Length to which the whole bristle is compressed, in widths of the section."""

SCRIPT = '''\
"""The bristle's impact in ParaView: the whole with its axis compressed, and the tip beside it.

    paraview --script=open_in_paraview.py
    xvfb-run -a pvbatch open_in_paraview.py [PICTURE.png]
"""

import os
import sys

import paraview
from paraview.simple import *

SETTINGS = @settings@

try:
    FOLDER = os.path.dirname(os.path.abspath(__file__))
except NameError:  # ParaView does not always say which script it runs
    FOLDER = SETTINGS["folder"]


def read(name):
    path = os.path.join(FOLDER, SETTINGS["fields"], name)
    return ADIOS2VTXReader(registrationName=name, FileName=path)


def warped(source, factor, compression, name):
    warp = WarpByVector(registrationName=name + ", warped", Input=source)
    warp.Vectors = ["POINTS", "displacement_m"]
    warp.ScaleFactor = factor
    if compression == 1.0:
        return warp
    squeezed = Transform(registrationName=name + ", axis compressed", Input=warp)
    squeezed.Transform.Scale = [1.0, 1.0, 1.0 / compression]
    return squeezed


def ground(view, half):
    plane = Plane(registrationName="plane")
    plane.Origin, plane.Point1, plane.Point2 = [-half, -half, 0], [half, -half, 0], [-half, half, 0]
    shown = Show(plane, view)
    shown.AmbientColor = shown.DiffuseColor = [0.8, 0.8, 0.8]
    shown.DisableLighting = 1


def coloured(source, view, array, low, high, preset, title):
    shown = Show(source, view)
    ColorBy(shown, ("POINTS", array))
    colours = GetColorTransferFunction(array)
    colours.ApplyPreset(preset, True)
    colours.RescaleTransferFunction(low, high)
    shown.DisableLighting = 1
    label(shown, view, colours, title, "Lower Right Corner")


def label(shown, view, colours, title, corner):
    bar = GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle = title, ""
    bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
    bar.TitleFontSize = bar.LabelFontSize = 14
    bar.WindowLocation = corner
    shown.SetScalarBarVisibility(view, True)


def pressed(source, view):
    shown = Show(source, view)
    ColorBy(shown, ("POINTS", "pressure_Pa"))
    shown.DisableLighting = 1
    shown.RescaleTransferFunctionToDataRangeOverTime()
    colours = GetColorTransferFunction("pressure_Pa")
    colours.ApplyPreset("Inferno (matplotlib)", True)
    label(shown, view, colours, "contact pressure (Pa)", "Lower Left Corner")


def caption(view, text):
    shown = Show(Text(registrationName=text, Text=text), view)
    shown.Color, shown.FontSize = [0.0, 0.0, 0.0], 14
    shown.WindowLocation = "Lower Center"


def camera(view, middle, distance, scale, rise):
    view.CameraParallelProjection = 1
    view.CameraFocalPoint = middle
    view.CameraPosition = [m + distance * d for m, d in zip(middle, (-1.0, -0.8, rise))]
    view.CameraViewUp = [0.0, 0.0, 1.0]
    view.CameraParallelScale = scale


def new_view(layout, hint):
    view = CreateView("RenderView")
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    view.OrientationAxesLabelColor = [0.0, 0.0, 0.0]
    AssignViewToLayout(view=view, layout=layout, hint=hint)
    return view


def build():
    solid, tip = read(SETTINGS["solid"]), read(SETTINGS["tip"])
    length, width, limit = SETTINGS["length_m"], SETTINGS["width_m"], SETTINGS["axial_limit_Pa"]
    compression, factor = SETTINGS["compression"], SETTINGS["exaggeration"]
    layout = CreateLayout("bristle")
    layout.SetSize(1400, 900)

    whole = new_view(layout, 0)
    layout.SplitHorizontal(0, 0.5)
    shown = warped(solid, factor, compression, "whole")
    coloured(shown, whole, "axial_stress_Pa", -limit, limit, "Cool to Warm", "axial stress (Pa)")
    ground(whole, width)
    caption(whole, f"axis compressed {compression:.3g} times, displacement x {factor:g}")
    short = length / compression
    camera(whole, [0.0, 0.0, 0.5 * short], 10.0 * short, 0.65 * short, 0.35)

    close = new_view(layout, 2)
    shown = warped(solid, 1.0, 1.0, "tip in true proportions")
    high = SETTINGS["von_mises_limit_Pa"]
    coloured(shown, close, "von_mises_Pa", 0.0, high, "Viridis (matplotlib)", "von Mises (Pa)")
    nearer = Transform(registrationName="pressure on the tip", Input=warped(tip, 1.0, 1.0, "tip"))
    nearer.Transform.Translate = [0.0, 0.0, -0.005 * width]  # not to fight with the solid's face
    pressed(nearer, close)
    close.OrientationAxesVisibility = 0
    caption(close, "the tip in true proportions, from below")
    camera(close, [0.0, 0.0, 0.6 * width], 10.0 * width, 1.1 * width, -0.9)

    scene = GetAnimationScene()
    scene.UpdateAnimationUsingDataTimeSteps()
    scene.AnimationTime = SETTINGS["time_s"]
    for view in (whole, close):
        clock = Show(AnnotateTimeFilter(Input=solid, Format="{time:.6f} s after release"), view)
        clock.Color, clock.FontSize = [0.0, 0.0, 0.0], 14
        clock.WindowLocation = "Upper Left Corner"
        Render(view)
    return layout


made = build()
if not paraview.fromGUI:
    picture = sys.argv[1] if len(sys.argv) > 1 else os.path.join(FOLDER, "open_in_paraview.png")
    SaveScreenshot(
        picture, made, ImageResolution=[1400, 900], FontScaling="Do not scale fonts"
    )
'''


def write_state_script(result: Path, fields: str, wave: Wave, touch_s: float) -> Path:
    """Write ``open_in_paraview.py`` into the folder ``result``, whose fields are in ``fields``.

    It opens at the instant of the greatest stress near the tip. Returns its path.
    """
    width = float(wave.size_m[:2].max())
    frame = int(wave.tip_von_mises_Pa.argmax())
    settings: dict[str, Any] = {
        "folder": str(result.resolve()),
        "fields": fields,
        "solid": SOLID_FILE,
        "tip": TIP_FILE,
        "length_m": float(wave.size_m[2]),
        "width_m": width,
        "compression": max(1.0, float(wave.size_m[2]) / (WHOLE_WIDTHS * width)),
        "exaggeration": wave.world_exaggeration,
        "axial_limit_Pa": wave.greatest_axial_Pa or 1.0,
        "von_mises_limit_Pa": float(wave.tip_von_mises_Pa[frame]) or 1.0,
        "time_s": float(wave.times_s[frame] + touch_s),
    }
    path = result / SCRIPT_FILE
    text = pprint.pformat(settings, sort_dicts=False, width=96)
    write_atomically(path, SCRIPT.replace("@settings@", text))
    return path
