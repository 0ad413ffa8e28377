"""A script that opens a result in ParaView in one step: the whole, and a camera on the tip.

``open_in_paraview.py`` is written beside the result. It finds the fields in its own folder, so a
result may be moved, and runs in ParaView's own Python, where nothing of this program is needed.
"""

from __future__ import annotations

import itertools
import pprint
from pathlib import Path
from typing import Any

import numpy as np

from ...solver.arrays import Array
from ...solver.paraview import SOLID_FILE, TIP_FILE
from ..running.files import write_atomically
from .wave import Wave

SCRIPT_FILE = "open_in_paraview.py"
WHOLE_WIDTHS = 6.0
"""Height to which the whole is compressed, in widths of the section."""
WHOLE_SPREADS = 1.5
"""The same where the bristle leans or goes to the side, in lengths of its way across."""
WHOLE_FROM, TIP_FROM = (-1.0, -0.8, 0.35), (-1.0, -0.8, -0.9)
"""Toward the cameras: along the world's axes, and along the tip's own."""
VIEW_WIDTH = 0.75
"""Width of a view over its height."""
ROOM = 1.2
"""How much higher the view is than what it shows."""
TIP_ROOM = 2.2
"""The same of the tip's face, which stands below the middle."""

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


def warped(source, vectors, name):
    warp = WarpByVector(registrationName=name, Input=source)
    warp.Vectors = ["POINTS", vectors]
    return warp


def exaggerated(solid):
    """The solid, displacements from where it first touches times a factor, its axis compressed."""
    shown = Calculator(registrationName="exaggerated", Input=solid)
    shown.ResultArrayName, shown.Function = "shown_m", SETTINGS["shown_m"]
    return compressed(warped(shown, "shown_m", "whole, warped"), "whole")


def compressed(source, name):
    squeezed = Transform(registrationName=name, Input=source)
    squeezed.Transform.Scale = [1.0, 1.0, 1.0 / SETTINGS["compression"]]
    return squeezed


def ground(view):
    plane = Plane(registrationName="plane")
    plane.Origin, plane.Point1, plane.Point2 = SETTINGS["ground_m"]
    shown = Show(compressed(plane, "ground"), view)
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
    # beside the edge of contact it dips below zero
    colours.RescaleTransferFunction(0.0, max(colours.RGBPoints[-4], 1.0))
    label(shown, view, colours, "contact pressure (Pa)", "Lower Left Corner")


def caption(view, text):
    shown = Show(Text(registrationName=text, Text=text), view)
    shown.Color, shown.FontSize = [0.0, 0.0, 0.0], 14
    shown.WindowLocation = "Lower Center"


def camera(view, towards, up, middle, scale):
    view.CameraParallelProjection = 1
    view.CameraFocalPoint = middle
    view.CameraPosition = [m + 10.0 * scale * d for m, d in zip(middle, towards)]
    view.CameraViewUp = up
    view.CameraParallelScale = scale


def follow(view, tip, scene):
    """Keep the camera on the tip, whose face fills a part of the view, wherever it goes."""
    around = Transform(registrationName="around the tip", Input=tip, TransformAllInputVectors=0)
    around.Transform.Scale = [SETTINGS["room"]] * 3
    around.Transform.Translate = [0.0, 0.0, 0.5 * SETTINGS["width_m"]]
    cue = CameraAnimationCue(AnimatedProxy=view, Mode="Follow-data")
    cue.DataSource = warped(around, "displacement_m", "around the tip, warped")
    cue.KeyFrames = [CameraKeyFrame(KeyTime=0.0), CameraKeyFrame(KeyTime=1.0)]
    scene.Cues.append(cue)


def new_view(layout, hint):
    view = CreateView("RenderView")
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    view.OrientationAxesLabelColor = [0.0, 0.0, 0.0]
    AssignViewToLayout(view=view, layout=layout, hint=hint)
    return view


def build():
    solid, tip = read(SETTINGS["solid"]), read(SETTINGS["tip"])
    limit, factor = SETTINGS["axial_limit_Pa"], SETTINGS["exaggeration"]
    layout = CreateLayout("bristle")
    layout.SetSize(1400, 900)

    whole = new_view(layout, 0)
    layout.SplitHorizontal(0, 0.5)
    shown = exaggerated(solid)
    coloured(shown, whole, "axial_stress_Pa", -limit, limit, "Cool to Warm", "axial stress (Pa)")
    ground(whole)
    compression = SETTINGS["compression"]
    caption(whole, f"axis compressed {compression:.3g} times, displacement x {factor:g}")
    camera(whole, *SETTINGS["camera"])

    close = new_view(layout, 2)
    shown = warped(solid, "displacement_m", "tip in true proportions")
    high = SETTINGS["von_mises_limit_Pa"]
    coloured(shown, close, "von_mises_Pa", 0.0, high, "Viridis (matplotlib)", "von Mises (Pa)")
    nearer = Transform(
        registrationName="pressure on the tip", Input=warped(tip, "displacement_m", "tip, warped")
    )
    nearer.Transform.Translate = SETTINGS["nearer_m"]  # not to fight with the solid's face
    pressed(nearer, close)
    close.OrientationAxesVisibility = 0
    caption(close, "the tip in true proportions, from below")
    camera(close, *SETTINGS["tip_camera"])

    scene = GetAnimationScene()
    scene.UpdateAnimationUsingDataTimeSteps()
    follow(close, tip, scene)
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
    width, frame = float(wave.size_m[:2].max()), wave.tip_frame
    settings: dict[str, Any] = {
        "folder": str(result.resolve()),
        "fields": fields,
        "solid": SOLID_FILE,
        "tip": TIP_FILE,
        "width_m": width,
        **_whole(wave, width),
        "exaggeration": wave.exaggeration,
        "shown_m": _exaggerated(wave),
        "tip_camera": _tip_camera(wave, width),
        "room": TIP_ROOM,
        "nearer_m": (wave.tip_stand.turn @ [0.0, 0.0, -0.005 * width]).tolist(),
        "axial_limit_Pa": wave.greatest_axial_Pa or 1.0,
        "von_mises_limit_Pa": float(wave.tip_von_mises_Pa[frame]) or 1.0,
        "time_s": float(wave.times_s[frame] + touch_s),
    }
    path = result / SCRIPT_FILE
    text = pprint.pformat(settings, sort_dicts=False, width=96)
    write_atomically(path, SCRIPT.replace("@settings@", text))
    return path


def _exaggerated(wave: Wave) -> str:
    """ParaView's formula for a displacement whose part beyond the stand is made larger."""
    stand, factor = wave.stand, wave.exaggeration
    placed = np.column_stack([stand.turn - np.eye(3), -stand.turn @ stand.touching_m])
    moved = (1.0 - factor) * placed
    parts = [f"{factor}*displacement_m", *(_along("ijk"[k], moved[k]) for k in range(3))]
    return "+".join(parts).replace("+-", "-")


def _along(axis: str, row: Array) -> str:
    x, y, z, at = map(float, row)
    return f"({x}*coordsX+{y}*coordsY+{z}*coordsZ+{at})*{axis}Hat"


def _whole(wave: Wave, width_m: float) -> dict[str, Any]:
    """The whole with its axis compressed: by how much, its camera, and the ground below it, by a
    corner and those beside it, uncompressed."""
    low, high = wave.extent_m(np.ones(3))
    height, across = high[2] - low[2], (high - low)[:2].max()
    compression = max(1.0, height / max(WHOLE_WIDTHS * width_m, WHOLE_SPREADS * across))
    (left, near), (right, far) = low[:2] - width_m, high[:2] + width_m
    corners = np.array([[left, near], [right, near], [left, far], [right, far]])
    ground = np.column_stack([corners, -corners @ wave.normal[:2] / wave.normal[2]])
    box = np.array(list(itertools.product(*np.array([low, high]).T)))

    away = np.array(WHOLE_FROM) / np.linalg.norm(WHOLE_FROM)
    right_hand = np.cross([0.0, 0.0, 1.0], away)
    right_hand /= np.linalg.norm(right_hand)
    plane = np.array([right_hand, np.cross(away, right_hand)])
    seen = np.vstack([box, ground]) / [1.0, 1.0, compression] @ plane.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0)) @ plane
    half = 0.5 * np.ptp(seen, axis=0) / [VIEW_WIDTH, 1.0]
    return {
        "compression": float(compression),
        "ground_m": ground[:3].tolist(),
        "camera": [away.tolist(), [0.0, 0.0, 1.0], middle.tolist(), ROOM * float(half.max())],
    }


def _tip_camera(wave: Wave, width_m: float) -> list[Any]:
    """Direction to the camera along the tip's own axes, upward, middle and half the height of the
    view; where it looks follows the tip."""
    turn = wave.tip_stand.turn
    away = turn @ (np.array(TIP_FROM) / np.linalg.norm(TIP_FROM))
    return [away.tolist(), turn[:, 2].tolist(), [0.0, 0.0, 0.0], width_m]
