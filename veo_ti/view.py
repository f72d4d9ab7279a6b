"""Pictures of a virtual elastic object: material, error and sensitivity maps, poses side by side, films.

Every map returns a pyvista Plotter that was not shown: `save_picture` writes it, `.show()` opens it in a notebook.
"""

from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pyvista as pv

from recon.files import replacing
from sim.checks import as_array, require
from veo_ti.stage import Colours, add_bar, add_spheres, image, limits_of, place, repaint, set_up, spacing_of, write
from veo_ti.viewpoint import Viewpoint, look_at

RADIUS = 0.62  # of the spacing: neighbouring spheres touch and close the surface
Up = Sequence[float]
Z_UP = (0.0, 0.0, 1.0)


def lame_map(x: np.ndarray, values_pa: np.ndarray, *, inside: bool = False, title: str = "Shear modulus",
             up: Up = Z_UP) -> pv.Plotter:
    """A Lame parameter on the rest shape, on a logarithmic scale in kPa.

    x (N, 3) [m]; values_pa (N,) [Pa], positive. inside: take the half of the object towards the eye away, so that the
    inner points are seen.
    Raises ValueError on wrong shapes, NaN, or values that are not positive.
    """
    x, values_pa = _cloud(x, values_pa, "values_pa")
    require(bool((values_pa > 0).all()), "values_pa", "be positive", values_pa.min())
    colours = Colours(label="kPa", limits=limits_of(values_pa / 1e3, log=True), colormap="viridis", log=True)
    return _map(x, values_pa / 1e3, colours, title, up, inside)


def error_map(y: np.ndarray, error_mm: np.ndarray, *, limit_mm: float | None = None, title: str = "Error",
              up: Up = Z_UP) -> pv.Plotter:
    """The distance between model and measurement at each point y (N, 3) [m], error_mm (N,), from zero to limit_mm.

    Give the same limit_mm to pictures that are to be compared. Raises ValueError on wrong shapes or NaN.
    """
    y, error_mm = _cloud(y, error_mm, "error_mm")
    limits = limits_of(error_mm, zero=True) if limit_mm is None else (0.0, float(limit_mm))
    return _map(y, error_mm, Colours(label="mm", limits=limits, colormap="YlOrRd", span=(0.02, 0.94)), title, up)


def sensitivity_map(x: np.ndarray, sensitivity: np.ndarray, *, title: str = "What the data determined",
                    up: Up = Z_UP) -> pv.Plotter:
    """How far the data, not the prior, determined the material at x (N, 3) [m]: sensitivity (N,), 0 to 1."""
    x, sensitivity = _cloud(x, sensitivity, "sensitivity")
    colours = Colours(label="0: prior, 1: data", limits=(0.0, max(1.0, float(sensitivity.max()))), colormap="YlGnBu",
                      span=(0.04, 0.92))
    return _map(x, sensitivity, colours, title, up)


def frames_strip(y: np.ndarray, values: np.ndarray, *, label: str, captions: Sequence[str], title: str = "",
                 limits: tuple[float, float] | None = None, up: Up = Z_UP) -> pv.Plotter:
    """Poses side by side under one colour scale: y (F, N, 3) [m], values (F, N), one caption a pose.

    Raises ValueError on wrong shapes or when captions do not match the poses.
    """
    y = as_array("y", y, (None, None, 3))
    values = as_array("values", values, y.shape[:2])
    require(len(captions) == len(y), "captions", f"have one entry for each of {len(y)} poses", len(captions))
    colours = Colours(label=label, limits=limits or limits_of(values, zero=True), colormap="YlOrRd", span=(0.02, 0.94))
    radius = RADIUS * spacing_of(y[0])
    right = look_at(y.reshape(-1, 3), up=up).axes()[0]
    along = y @ right
    step = 1.12 * (along.max(axis=1) - along.min(axis=1)).max() + 4 * radius
    moved = y + (np.arange(len(y)) * step - along.mean(axis=1))[:, None, None] * right
    view = look_at(moved.reshape(-1, 3), up=up, pad=radius, room=(1560, 640), like=y.reshape(-1, 3))
    stage = set_up(view, title)
    add_spheres(stage, moved.reshape(-1, 3), values.ravel(), colours, radius=radius)
    add_bar(stage, colours)
    for pose, caption in zip(moved, captions, strict=True):
        write(stage, caption, (view.to_pixels(pose)[:, 0].mean() - 4.2 * len(caption), 22))
    return stage


def save_picture(plotter: pv.Plotter, path: str | Path) -> Path:
    """Write the plotter's picture to a .png or .jpg and close the plotter; works without display and without OpenGL."""
    with replacing(path) as partial:
        iio.imwrite(partial, image(plotter))
    plotter.close()
    return Path(path)


def turntable(points: np.ndarray, scalars: np.ndarray, path: str | Path, *, frames: int = 48, label: str = "",
              title: str = "", log: bool = False, fps: int = 16, up: Up = Z_UP) -> Path:
    """A film of one walk round points (N, 3) [m] coloured by scalars (N,), as an .mp4. Needs no installed ffmpeg."""
    points, scalars = _cloud(points, scalars, "scalars")
    view = look_at(points, up=up, pad=RADIUS * spacing_of(points), room=(800, 640), around=True)
    colours = _film_colours(scalars, label, log)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2

    def pictures() -> Generator[np.ndarray, None, None]:
        stage, _ = _film_stage(view, points, scalars, colours, title)
        for angle in np.linspace(0, 2 * np.pi, frames, endpoint=False):
            place(stage, view.turned(angle, middle))
            yield image(stage)
        stage.close()

    return write_film(pictures(), view.size, Path(path), fps)


def animation(points: np.ndarray, scalars: np.ndarray, path: str | Path, *, label: str = "", title: str = "",
              time: np.ndarray | None = None, log: bool = False, fps: int = 12, up: Up = Z_UP) -> Path:
    """A film, as an .mp4, of points (T, N, 3) [m] coloured by scalars (T, N) or (N,); time (T,) [s] is shown."""
    points = as_array("points", points, (None, None, 3))
    scalars = as_array("scalars", np.broadcast_to(scalars, points.shape[:2]), points.shape[:2])
    view = look_at(points.reshape(-1, 3), up=up, pad=RADIUS * spacing_of(points[0]), room=(800, 640))
    colours = _film_colours(scalars, label, log)

    def pictures() -> Generator[np.ndarray, None, None]:
        stage, cloud = _film_stage(view, points[0], scalars[0], colours, title)
        clock = write(stage, "", (40, 24))
        for t, (now, value) in enumerate(zip(points, scalars, strict=True)):
            repaint(stage, cloud, now, value, colours)
            clock.input = " " if time is None else f"t = {time[t]:.2f} s"
            yield image(stage)
        stage.close()

    return write_film(pictures(), view.size, Path(path), fps)


def _cloud(x: np.ndarray, values: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    x = as_array("points", x, (None, 3))
    return x, as_array(name, values, (len(x),))


def _map(x: np.ndarray, values: np.ndarray, colours: Colours, title: str, up: Up, inside: bool = False) -> pv.Plotter:
    radius = RADIUS * spacing_of(x)
    view = look_at(x, up=up, pad=radius)
    nearness = x @ np.cross(view.axes()[0], view.up)
    shown = nearness <= np.median(nearness) if inside else np.ones(len(x), bool)
    stage = set_up(view, title)
    add_spheres(stage, x[shown], values[shown], colours, radius=radius)
    add_bar(stage, colours)
    return stage


def _film_colours(scalars: np.ndarray, label: str, log: bool) -> Colours:
    colormap = "viridis" if log else "YlOrRd"
    return Colours(label=label, limits=limits_of(scalars, log=log, zero=not log), colormap=colormap, log=log)


def _film_stage(view: Viewpoint, points: np.ndarray, scalars: np.ndarray, colours: Colours,
                title: str) -> tuple[pv.Plotter, pv.PolyData]:
    stage = set_up(view, title)
    stage.disable_anti_aliasing()
    cloud = add_spheres(stage, points, scalars, colours, radius=RADIUS * spacing_of(points))
    add_bar(stage, colours)
    return stage, cloud


def write_film(pictures: Generator[np.ndarray, None, None], size: tuple[int, int], path: Path, fps: int) -> Path:
    """An mp4 of pictures (h, w, 3) uint8; size: width and height [px], multiples of 16."""
    require(path.suffix == ".mp4", "path", "end in .mp4", path)
    with replacing(path) as partial:
        writer = imageio_ffmpeg.write_frames(str(partial), size, fps=fps, quality=7, ffmpeg_log_level="error")
        with closing(writer), closing(pictures):
            writer.send(None)
            for picture in pictures:
                writer.send(picture)
    return path
