"""Whether this machine can draw three-dimensional pictures without a display; asked once, in another process."""

import os
import subprocess
import sys
from functools import lru_cache

PROBE = """
import numpy as np
from vtkmodules.vtkFiltersSources import vtkSphereSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow
from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.util.numpy_support import vtk_to_numpy
source, mapper, actor, renderer = vtkSphereSource(), vtkPolyDataMapper(), vtkActor(), vtkRenderer()
mapper.SetInputConnection(source.GetOutputPort())
actor.SetMapper(mapper)
renderer.AddActor(actor)
window, shot = vtkRenderWindow(), vtkWindowToImageFilter()
window.SetOffScreenRendering(1)
window.AddRenderer(renderer)
window.Render()
shot.SetInput(window)
shot.Update()
pixels = vtk_to_numpy(shot.GetOutput().GetPointData().GetScalars())
raise SystemExit(0 if np.mean(pixels.max(axis=1) > 30) > 0.05 else 3)
"""


def prefer_headless() -> None:
    """Let VTK open an EGL window where Linux has no display: nothing tries X, nothing warns."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


@lru_cache(maxsize=1)
def can_render(timeout: float = 60.0) -> bool:
    """True when a sphere rendered off-screen is not black. VTK without OpenGL ends the process, hence another one."""
    prefer_headless()
    try:
        run = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, timeout=timeout, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return run.returncode == 0
