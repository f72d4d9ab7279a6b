"""A plotter's picture painted in software, for machines without OpenGL: spheres, arrows, colour bar and words."""

import numpy as np
import pyvista as pv
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkActor, vtkTextActor
from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper

LIGHT = np.array([-0.42, 0.54, 0.73])  # in the camera's axes: right, up, towards the eye
AMBIENT, DIFFUSE = 0.42, 0.62


def paint(stage: pv.Plotter) -> np.ndarray:
    """The picture (height, width, 3) uint8 of what veo_ti.stage put on the plotter."""
    width, height = stage.window_size
    canvas = np.full((height, width, 3), np.array(stage.background_color.float_rgb) * 255.0)
    depth = np.full((height, width), np.inf)
    for actor in stage.actors.values():
        if isinstance(actor, vtkActor) and isinstance(actor.GetMapper(), vtkOpenGLSphereMapper):
            _paint_spheres(canvas, depth, stage, actor.GetMapper())
        elif isinstance(actor, vtkActor):
            _paint_triangles(canvas, depth, stage, actor)
    return _with_words(canvas.astype(np.uint8), stage)


def _paint_spheres(canvas: np.ndarray, depth: np.ndarray, stage: pv.Plotter, mapper: vtkOpenGLSphereMapper) -> None:
    height, width = depth.shape
    cloud = pv.wrap(mapper.GetInput())
    colours = _colours(mapper.GetLookupTable(), cloud["value"])
    seen = _project(stage, cloud.points)
    scale = height / 2 / np.tan(np.deg2rad(stage.camera.view_angle / 2))
    for (column, row, far), colour in zip(seen, colours, strict=True):
        size = scale * mapper.GetRadius() / far
        rows = np.arange(max(0, int(row - size)), min(height, int(row + size) + 2))
        columns = np.arange(max(0, int(column - size)), min(width, int(column + size) + 2))
        right, above = np.meshgrid((columns - column) / size, (row - rows) / size)
        toward = np.sqrt(np.maximum(0.0, 1.0 - right**2 - above**2))
        distance = far - mapper.GetRadius() * toward
        block = np.ix_(rows, columns)
        hit = (toward > 0) & (distance < depth[block])
        shade = AMBIENT + DIFFUSE * np.maximum(0.0, right * LIGHT[0] + above * LIGHT[1] + toward * LIGHT[2])
        depth[block] = np.where(hit, distance, depth[block])
        canvas[block] = np.where(hit[..., None], np.minimum(255.0, shade[..., None] * colour), canvas[block])


def _paint_triangles(canvas: np.ndarray, depth: np.ndarray, stage: pv.Plotter, actor: vtkActor) -> None:
    """Flat triangles in the actor's one colour, with the light of the spheres."""
    mesh = pv.wrap(actor.GetMapper().GetInput())
    corners = mesh.faces.reshape(-1, 4)[:, 1:]
    normals = np.cross(*(mesh.points[corners[:, i]] - mesh.points[corners[:, 0]] for i in (1, 2)))
    light = np.abs(normals @ (LIGHT @ _axes(stage))) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    colour = 255 * np.array(actor.GetProperty().GetColor())
    seen = _project(stage, mesh.points)
    for triangle, bright in zip(seen[corners], AMBIENT + DIFFUSE * light, strict=True):
        low, high = triangle[:, :2].min(axis=0), triangle[:, :2].max(axis=0)
        columns = np.arange(max(0, int(low[0])), min(canvas.shape[1], int(high[0]) + 2))
        rows = np.arange(max(0, int(low[1])), min(canvas.shape[0], int(high[1]) + 2))
        sides = np.column_stack([triangle[:, :2], np.ones(3)])
        if abs(np.linalg.det(sides)) < 1e-9:
            continue
        grid = np.stack([*np.meshgrid(columns, rows), np.ones((len(rows), len(columns)))], axis=-1)
        share = grid @ np.linalg.inv(sides)  # barycentric
        distance = share @ triangle[:, 2]
        block = np.ix_(rows, columns)
        hit = (share > -1e-9).all(axis=-1) & (distance < depth[block])
        depth[block] = np.where(hit, distance, depth[block])
        canvas[block] = np.where(hit[..., None], np.minimum(255.0, bright * colour), canvas[block])


def _axes(stage: pv.Plotter) -> np.ndarray:
    """The camera's right, up and towards the eye, as rows (3, 3)."""
    toward = np.array(stage.camera.position) - np.array(stage.camera.focal_point)
    toward /= np.linalg.norm(toward)
    right = np.cross(stage.camera.up, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def _colours(table: pv.LookupTable, values: np.ndarray) -> np.ndarray:
    """Red, green and blue (N, 3), 0 to 255, of values (N,)."""
    low, high = table.scalar_range
    share = np.log(values / low) / np.log(high / low) if table.log_scale else (values - low) / (high - low)
    return table.values[np.clip(share * 256, 0, 255).astype(int), :3].astype(float)


def _project(stage: pv.Plotter, x: np.ndarray) -> np.ndarray:
    """Column, row [pixels] and distance along the line of sight [m] of points x (N, 3); returns (N, 3)."""
    width, height = stage.window_size
    matrix = stage.camera.GetCompositeProjectionTransformMatrix(width / height, -1.0, 1.0)
    matrix = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
    clip = np.column_stack([x, np.ones(len(x))]) @ matrix.T
    column, row = (clip[:, 0] / clip[:, 3] + 1) * width / 2, (1 - clip[:, 1] / clip[:, 3]) * height / 2
    return np.column_stack([column, row, clip[:, 3]])


def _with_words(picture: np.ndarray, stage: pv.Plotter) -> np.ndarray:
    height, width = picture.shape[:2]
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    agg = FigureCanvasAgg(figure)
    figure.figimage(picture, zorder=-1)
    for actor in stage.actors.values():
        if isinstance(actor, vtkTextActor):
            left, bottom = actor.GetPosition()
            size = actor.GetTextProperty().GetFontSize() * 0.62
            figure.text(left / width, bottom / height, actor.GetInput(), fontsize=size, color="#2b2d33")
        elif isinstance(actor, vtkScalarBarActor):
            _draw_bar(figure, actor)
    agg.draw()
    return np.ascontiguousarray(np.asarray(agg.buffer_rgba())[..., :3])


def _draw_bar(figure: Figure, bar: vtkScalarBarActor) -> None:
    table = bar.GetLookupTable()
    low, high = table.scalar_range
    left, bottom = bar.GetPosition()
    size = figure.get_size_inches() * 100
    axes = figure.add_axes((left, bottom, 26 / size[0], bar.GetPosition2()[1]))
    steps = (np.geomspace if table.log_scale else np.linspace)(low, high, 257)
    axes.pcolormesh([0, 1], steps, table.values[:, None, :3] / 255.0)
    axes.set_yscale("log" if table.log_scale else "linear")
    ticks = vtk_to_numpy(bar.GetCustomLabels())
    axes.yaxis.tick_right()
    axes.set_yticks(ticks, [f"{tick:.6g}" for tick in ticks])
    axes.set_yticks([], minor=True)
    axes.set_xticks([])
    axes.set_ylim(low, high)
    axes.spines[:].set_visible(False)
    axes.tick_params(colors="#2b2d33", length=0, labelsize=11)
