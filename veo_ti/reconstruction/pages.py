"""Pictures and the page of a reconstruction: held-out cameras beside what was rendered, the cloud, the numbers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from recon.images import shown, write_image
from recon.radiance.extraction import Cloud4D
from veo_ti.report import Section, Table, write_report

_SHOWN = 4  # pairs on the page
_HEIGHT = 220  # [px] of each picture

Pair = tuple[str, int, np.ndarray, np.ndarray]  # camera, frame, rendered, filmed, both (h, w, 3) in 0 to 1


def write_page(out: Path, folder: Path, facts: Mapping[str, object], pairs: Sequence[Pair], cloud: Cloud4D) -> Path:
    """reconstruct.html with held_out.png and cloud.png."""
    few = [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, _SHOWN).astype(int))]
    write_image(out / "held_out.png", np.concatenate([_beside(*pair) for pair in few], axis=0))
    write_image(out / "cloud.png", _cloud_picture(cloud))
    quality = facts["quality"]
    rows = [
        (name, *(_number(quality[part][measure]) for measure in ("psnr", "ssim", "lpips")))
        for name, part in (("whole picture", "not_masked"), ("object on black", "masked"))
    ]
    sections = [
        Section(
            heading="Cameras that taught nothing",
            text=f"Rendered, filmed, and their difference (times four). On the object's own pixels alone the rendering "
            f"reaches {quality['object_psnr']:.1f} dB; a black background, easily right, flatters the table.",
            table=Table(columns=("", "PSNR [dB]", "SSIM", "LPIPS"), rows=rows),
            pictures=(out / "held_out.png",),
        ),
        Section(
            heading="Points in correspondence",
            text=f"{facts['points']} points, {facts['spacing_mm']:.1f} mm apart, {facts['surface_points']} of them on "
            f"the surface, {facts['fixed_points']} taken as fixed; from the front and from the side, coloured, and by "
            "how far they move.",
            pictures=(out / "cloud.png",),
        ),
    ]
    title = f"Reconstruction of {folder.resolve().name}"
    return write_report(out / "reconstruct.html", title, str(facts["sentence"]), sections)


def _number(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.3g}"


def _beside(camera: str, frame: int, rendered: np.ndarray, filmed: np.ndarray) -> np.ndarray:
    row = np.concatenate([rendered, filmed, 4 * np.abs(rendered - filmed)], axis=1)
    scale = _HEIGHT / row.shape[0]
    size = (3 * _HEIGHT, _HEIGHT)
    image = cv2.resize(shown(row), (max(1, round(scale * row.shape[1])), _HEIGHT))
    image = cv2.resize(image, size) if image.shape[1] != size[0] else image
    label = f"{camera}, frame {frame}"
    return cv2.putText(image, label, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)


def _cloud_picture(cloud: Cloud4D) -> np.ndarray:
    """The cloud from two sides: its colours, and how far each point moves, from dark (not) to bright (most)."""
    moved = np.linalg.norm(cloud.points - cloud.points[:1], axis=2).max(axis=0)
    level = shown(moved / max(float(moved.max()), 1e-12))
    heat = cv2.applyColorMap(level[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    parts = [_dots(cloud, axes, colours) for colours in (shown(cloud.colours), heat)
             for axes in ((0, 2), (2, 0))]  # fmt: skip
    return np.concatenate(parts, axis=1)


def _dots(cloud: Cloud4D, axes: tuple[int, int], colours: np.ndarray) -> np.ndarray:
    """Points seen along an axis, the nearest drawn last: axes (across, along the view)."""
    points, side = cloud.points[0], 2 * _HEIGHT
    across, along = axes
    flat = np.stack([points[:, across], -points[:, 1]], axis=1)
    span = np.ptp(points, axis=0).max() * 1.1
    place = ((flat - (flat.min(axis=0) + flat.max(axis=0)) / 2) / span + 0.5) * side
    image = np.full((side, side, 3), 245, np.uint8)
    radius = max(1, round(0.6 * cloud.spacing / span * side))
    for i in np.argsort(points[:, along]):
        cv2.circle(image, tuple(place[i].round().astype(int).tolist()), radius, colours[i].tolist(), cv2.FILLED)
    return image
