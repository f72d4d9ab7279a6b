"""The stage for pictures of point clouds: light paper, soft light, shaded spheres, a colour bar, the finished image."""

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from scipy.spatial import cKDTree

from veo_ti.offscreen import can_render, prefer_headless
from veo_ti.viewpoint import BAR, LENS_DEG, MARGIN, Viewpoint

prefer_headless()

import pyvista as pv  # noqa: E402
from vtkmodules.util.numpy_support import numpy_to_vtk  # noqa: E402
from vtkmodules.vtkCommonCore import vtkLogger  # noqa: E402
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor  # noqa: E402
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper  # noqa: E402

INK = "#2b2d33"
PAPER = "#fbfbf9"
ARROW = "#2f4fa8"
LIGHTS = (((-0.7, 0.9, 1.0), 0.70), ((1.0, 0.1, 0.8), 0.28), ((0.0, -1.0, 0.6), 0.12))  # camera frame, strength
BAR_WIDTH = 26  # pixels


@dataclass(frozen=True, kw_only=True)
class Colours:
    """How numbers become colours, and the words above the bar."""

    label: str
    limits: tuple[float, float]
    colormap: str
    span: tuple[float, float] = (0.06, 0.97)
    log: bool = False

    def steps(self) -> ListedColormap:
        """The colour map in 256 steps, without the darkest end of maps that run to black: shading needs the room."""
        return ListedColormap(colormaps[self.colormap](np.linspace(*self.span, 256)))


def spacing_of(x: np.ndarray) -> float:
    """The median over points of x (N, 3) of the mean distance [m] to up to six nearest others."""
    if len(x) < 2:
        return 1e-3
    nearest = cKDTree(x).query(x, k=min(7, len(x)))[0][:, 1:].mean(axis=1)
    return float(np.median(nearest)) or 1e-3


def limits_of(values: np.ndarray, *, log: bool = False, zero: bool = False) -> tuple[float, float]:
    """Colour limits that hold all but the outer 1 % of values, widened where all are equal; zero: start at 0."""
    low, high = (float(v) for v in np.percentile(values, (1.0, 99.0)))
    if log:
        return (low, high) if high > 1.05 * low else (low / 1.25, high * 1.25)
    low = 0.0 if zero else low
    return low, max(high, low + max(1e-6, 1e-2 * abs(low)))


def ticks_of(limits: tuple[float, float], *, log: bool) -> np.ndarray:
    """At least three round numbers inside the limits, as few as possible."""
    low, high = limits
    if log:
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        steps = ([1], [1, 3], [1, 2, 5], [1, 1.5, 2, 3, 4, 5, 6, 8], np.arange(1, 10, 0.2), np.arange(1, 10, 0.02))
        choices = [np.outer(decades, step).ravel() for step in steps]
    else:
        step = 10.0 ** np.floor(np.log10(high - low))
        choices = [np.arange(np.ceil(low / s), np.floor(high / s) + 1) * s for s in step * np.array([1, 0.5, 0.2])]
    inside = [np.sort(c[(c >= low * (1 - 1e-9)) & (c <= high * (1 + 1e-9))]) for c in choices]
    few = next(c for c in [*inside, np.array([low, high])] if len(c) >= 3 or (len(c) == 2 and c[0] == low))
    return few[:: 1 + len(few) // 7]


def set_up(view: Viewpoint, title: str) -> pv.Plotter:
    """An off-screen plotter with light paper, three soft lights that follow the camera, the view and a title."""
    if not can_render():
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # the picture is painted instead: nobody needs to hear
    stage = pv.Plotter(off_screen=True, window_size=list(view.size), lighting="none")
    stage.set_background(PAPER)
    for position, strength in LIGHTS:
        light = pv.Light(position=position, focal_point=(0, 0, 0), light_type="camera light", intensity=strength)
        stage.add_light(light)
    stage.enable_anti_aliasing("ssaa")
    place(stage, view)
    write(stage, title, (MARGIN - 24, view.size[1] - 54), size=20)
    return stage


def place(stage: pv.Plotter, view: Viewpoint) -> None:
    """Move the plotter's camera to the view."""
    stage.camera.focal_point = view.focus
    stage.camera.position = view.focus + view.distance * view.toward
    stage.camera.up = view.up
    stage.camera.view_angle = LENS_DEG
    stage.renderer.ResetCameraClippingRange()


def write(stage: pv.Plotter, text: str, position: tuple[float, float], *, size: int = 17) -> pv.Text:
    """Write text at a pixel position counted from the lower left corner; the text returned can be changed."""
    words = stage.add_text(text or " ", position=position, color=INK, font="arial")
    words.prop.font_size = size
    return words


def add_spheres(
    stage: pv.Plotter, x: np.ndarray, values: np.ndarray, colours: Colours, *, radius: float
) -> pv.PolyData:
    """Draw a shaded sphere of the given radius [m] at each of x (N, 3), coloured by values (N,).

    Returns the points, which `repaint` may move and recolour before the next picture.
    """
    cloud = pv.PolyData(np.array(x, dtype=np.float64))
    cloud["value"] = np.clip(values, *colours.limits)
    actor = stage.add_mesh(cloud, scalars="value", cmap=colours.steps(), clim=colours.limits, log_scale=colours.log,
                           show_scalar_bar=False, reset_camera=False)
    actor.prop.ambient, actor.prop.diffuse, actor.prop.specular, actor.prop.specular_power = 0.40, 0.70, 0.08, 16.0
    actor.SetMapper(_sphere_mapper(cloud, radius, actor.mapper.lookup_table))
    stage.renderer.ResetCameraClippingRange()
    return cloud


def add_arrows(stage: pv.Plotter, tails: np.ndarray, arrows: np.ndarray, *, thickness: float) -> None:
    """Draw shaded arrows (M, 3) [m] from tails (M, 3); thickness [m] is the shaft's radius, less for short arrows."""
    for tail, arrow in zip(tails, arrows, strict=True):
        length = float(np.linalg.norm(arrow))
        radius = min(thickness, 0.08 * length) / length
        shape = pv.Arrow(start=tail, direction=arrow, scale=length, tip_length=min(0.35, 8 * radius),
                         tip_radius=2.6 * radius, shaft_radius=radius, tip_resolution=24, shaft_resolution=16)
        actor = stage.add_mesh(shape.triangulate(), color=ARROW, reset_camera=False, smooth_shading=False)
        actor.prop.ambient, actor.prop.diffuse = 0.40, 0.70
    stage.renderer.ResetCameraClippingRange()


def repaint(stage: pv.Plotter, cloud: pv.PolyData, x: np.ndarray, values: np.ndarray, colours: Colours) -> None:
    """Move the spheres to x (N, 3) and recolour them."""
    cloud.points = np.array(x, dtype=np.float64)
    cloud["value"] = np.clip(values, *colours.limits)
    cloud.Modified()
    stage.renderer.ResetCameraClippingRange()


def add_bar(stage: pv.Plotter, colours: Colours) -> None:
    """A tall colour bar with round numbers at the right edge, its label above it."""
    width, height = stage.window_size
    tall = min(0.56 * height, 440.0)
    left, bottom = width - BAR + 24, (height - tall) / 2 - 16
    table = pv.LookupTable(colours.steps(), scalar_range=colours.limits, log_scale=colours.log)
    bar = vtkScalarBarActor()
    bar.SetLookupTable(table)
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetBarRatio(1.0 * BAR_WIDTH / 100)
    bar.SetPosition(left / width, bottom / height)
    bar.SetPosition2(100 / width, tall / height)
    bar.SetLabelFormat("%.6g")
    bar.SetTitle("")
    bar.UseCustomLabelsOn()
    bar.SetCustomLabels(numpy_to_vtk(ticks_of(colours.limits, log=colours.log), deep=True))
    text = bar.GetLabelTextProperty()
    text.SetFontFamilyToArial()
    text.SetFontSize(17)
    text.SetColor(pv.Color(INK).float_rgb)
    text.ItalicOff()
    text.BoldOff()
    text.ShadowOff()
    stage.add_actor(bar, reset_camera=False, pickable=False)
    write(stage, colours.label, (left, bottom + tall + 14))


def image(stage: pv.Plotter) -> np.ndarray:
    """The picture (height, width, 3) uint8; painted in software where this machine has no OpenGL."""
    if not can_render():
        from veo_ti.paint import paint

        return paint(stage)
    stage.render()
    return np.ascontiguousarray(stage.screenshot(None, return_img=True)[..., :3])


def _sphere_mapper(cloud: pv.PolyData, radius: float, table: pv.LookupTable) -> vtkOpenGLSphereMapper:
    mapper = vtkOpenGLSphereMapper()
    mapper.SetInputData(cloud)
    mapper.SetRadius(radius)
    mapper.SetLookupTable(table)
    mapper.UseLookupTableScalarRangeOn()
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray("value")
    return mapper
