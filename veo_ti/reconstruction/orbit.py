"""`veo render` of a reconstruction: one of the recording's cameras, or a film that goes round the object."""

from collections.abc import Generator
from pathlib import Path

import numpy as np

from recon.cameras import UP, Camera, look_at
from recon.images import shown, write_image
from recon.plush.calibration import camera_of, read_calibration
from recon.plush.capture import CALIBRATION
from recon.radiance.rendering import STILL, render
from recon.radiance.storage import load_trained
from recon.radiance.training import Trained
from sim.checks import require
from veo_ti.reconstruction.run import FIELD
from veo_ti.store import writable_folder
from veo_ti.view import write_film

_LIFT, _AWAY = 0.25, 2.6  # of the box's side: how high above the middle, and how far away, the orbit runs
_FPS = 20


def render_reconstruction(
    folder: Path, out: Path, *, view: str | None = None, orbit: int = 0, frame: int | None = None, size: int = 256
) -> list[Path]:
    """Pictures of a folder that `veo reconstruct` wrote.

    view: a camera of the recording, without its lens' distortion; orbit: pictures of a film round the object, in which
    the frames pass unless `frame` is given; size [px] of the longer side, of films a multiple of 16. Raises ValueError
    for a camera or frame that is not there, or when neither view nor orbit is asked for.
    """
    require(view is not None or orbit > 0, "veo render", "be given --view or --orbit for a reconstruction", "neither")
    require(16 <= size <= 4096 and (not orbit or size % 16 == 0), "size", "be 16 to 4096, a multiple of 16", size)
    trained, out = load_trained(folder / FIELD), writable_folder(out)
    count = len(trained.field.latents)
    require(frame is None or 0 <= frame < count, "--frame", f"be 0 to {count - 1}", frame)
    made = []
    if view is not None:
        camera = _camera(folder, view, size)
        picture = render(trained.field, trained.occupancy, camera, frame=frame or 0, fineness=STILL)
        made.append(out / f"{view}_{frame or 0:04d}.png")
        write_image(made[-1], shown(picture.colour))
    if orbit > 0:
        path = out / "orbit.mp4"
        made.append(write_film(_turning(trained, orbit, frame, size), (size, size), path, _FPS))
    return made


def _turning(trained: Trained, orbit: int, frame: int | None, size: int) -> Generator[np.ndarray, None, None]:
    """The pictures of the film."""
    middle, side, count = trained.box.origin + _half(trained), trained.box.side, len(trained.field.latents)
    K = np.array([[size * _AWAY * 0.9, 0, size / 2 - 0.5], [0, size * _AWAY * 0.9, size / 2 - 0.5], [0, 0, 1]])
    for i in range(orbit):
        angle = 2 * np.pi * i / orbit
        eye = middle + side * np.array([_AWAY * np.sin(angle), _LIFT, _AWAY * np.cos(angle)])
        camera = Camera(name="orbit", K=K, T_camera_world=look_at(eye, middle, UP), size=(size, size))
        at = i * count // orbit if frame is None else frame
        yield shown(render(trained.field, trained.occupancy, camera, frame=at).colour)


def _half(trained: Trained) -> np.ndarray:
    """From the box's lowest corner to the middle of what the occupancy's grid spans."""
    return trained.occupancy.size.double().numpy() / 2


def _camera(folder: Path, name: str, size: int) -> Camera:
    place = folder / "capture" / CALIBRATION
    require(place.exists(), "--view", f"have {CALIBRATION} beside the reconstruction", "none; use --orbit")
    entries = read_calibration(place)
    require(name in entries, "--view", f"be one of {', '.join(sorted(entries))}", name)
    camera = camera_of(name, entries[name], tuple(int(n) for n in entries[name]["resolution_w_h"])).undistorted()
    scale = size / max(camera.size)
    return camera.resized((max(1, round(scale * camera.size[0])), max(1, round(scale * camera.size[1]))))
