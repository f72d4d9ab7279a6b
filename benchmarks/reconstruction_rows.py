"""What a reconstruction of a rig recording shows of cameras that taught nothing, and how far its points are off."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from benchmarks.table import Row
from recon.cameras import Camera
from recon.plush.reconstruction import read_plush
from recon.quality.similarity import psnr
from recon.radiance.device import array, tensor
from recon.radiance.extraction import Cloud4D
from recon.radiance.options import TrainOptions
from recon.radiance.rendering import STILL, render
from recon.radiance.training import Trained, train
from recon.rig.truth import Truth, read_truth
from recon.views import ViewOptions, Views, training_views
from sim.terms.shapes import Mesh
from veo_ti.observation_files import PLUSH_FRAME_RATE
from veo_ti.reconstruction.rerender import Rerenderer
from veo_ti.reconstruction.run import ReconstructChoice, capture_of, judged_frames, judging_views
from veo_ti.store import read_sequence


@dataclass(frozen=True, kw_only=True, eq=False)
class Work:
    """A field with the wall and processor seconds that its training took, kernels compiled before."""

    trained: Trained
    wall: float
    cpu: float

    @property
    def took(self) -> str:
        """In words."""
        return f"{self.wall:.0f} s, {self.cpu:.0f} s of processor time"

    def picture(self, camera: Camera, frame: int) -> np.ndarray:
        """What a camera sees of the field in a frame, (h, w, 3)."""
        return render(self.trained.field, self.trained.occupancy, camera, frame=frame, fineness=STILL).colour


@dataclass(frozen=True, kw_only=True, eq=False)
class Filmed:
    """A recording's pictures, those that teach and those that judge, and its truth."""

    views: Views
    judges: Views
    truth: Truth

    @classmethod
    def of(cls, folder: Path, resolution: int, test: tuple[str, ...], *, greys: bool = False) -> "Filmed":
        """Decoded into the folder beside the recording; greys: the left and right sensors teach too."""
        choice = ReconstructChoice(resolution=resolution, test=test, greys=greys)
        capture, place = capture_of(folder, choice), folder.with_name(f"{folder.name}-{resolution}")
        views = training_views(capture, place / "views", ViewOptions(resolution=resolution, streams=choice.streams))
        return cls(views=views, judges=judging_views(capture, place, choice), truth=read_truth(folder))

    def only_first_frame(self) -> "Filmed":
        """As if one picture a camera had been taken."""
        return replace(self, views=_first(self.views), judges=_first(self.judges))


def _first(views: Views) -> Views:
    return replace(views, times=views.times[:1], images=tuple(i[:1] for i in views.images),
                   mattes=tuple(m[:1] for m in views.mattes))  # fmt: skip


def timed(filmed: Filmed, options: TrainOptions) -> Work:
    """Train anew."""
    with tempfile.TemporaryDirectory() as folder:
        train(filmed.views, Path(folder) / "warm", replace(options, canonical_steps=2, motion_steps=2))
        wall, cpu = time.perf_counter(), time.process_time()
        trained = train(filmed.views, Path(folder) / "timed", options)
        return Work(trained=trained, wall=time.perf_counter() - wall, cpu=time.process_time() - cpu)


def judged(filmed: Filmed, picture: Callable[[object, int], np.ndarray]) -> float:
    """Mean PSNR [dB] on the object's pixels of held-out cameras of what picture(camera, frame) (h, w, 3) shows."""
    looks = filmed.judges.looks(judged_frames(len(filmed.judges.times)))
    return float(np.mean([psnr(picture(camera, frame), seen, matte > 0.5) for camera, frame, seen, matte in looks]))


def picture_row(filmed: Filmed, work: Work, what: str, *, least: float, most: float) -> Row:
    """Held-out quality and the time it took, against both targets."""
    found = judged(filmed, work.picture)
    return Row(
        what=f"{what}: PSNR on the object's pixels of {len(filmed.judges.cameras)} held-out cameras, training time",
        figure=f"{found:.1f} dB in {work.took}", target=f">= {least:g} dB in <= {most:g} s",
        reached=found >= least and work.wall <= most,
    )  # fmt: skip


def grey_row(colour: tuple[Filmed, Work], greys: tuple[Filmed, Work]) -> Row:
    """Held-out quality of one frame by the colour sensors of few devices, and by all three sensors of each."""
    found = [judged(filmed, work.picture) for filmed, work in (colour, greys)]
    devices, sensors = (len(filmed.views.cameras) for filmed, _ in (colour, greys))
    return Row(
        what=f"One frame, {devices} devices: object PSNR of {len(colour[0].judges.cameras)} held-out cameras, by the "
        f"colour sensors alone, and with the two grey ones of each ({sensors} sensors), as many steps",
        figure=f"{found[0]:.1f} and {found[1]:.1f} dB",
    )


@torch.no_grad()
def correspondence_row(filmed: Filmed, work: Work, what: str, *, mean: float, median: float | None) -> Row:
    """How far w carries true surface points from where they truly go, in every frame but the first."""
    truth, trained = filmed.truth, work.trained
    start = tensor(truth.rest[truth.surface].astype(np.float32))
    off, moved = [], []
    canonical = trained.field.from_first(start)
    for frame in range(1, len(truth.points)):
        found = array(trained.field.warped(canonical, torch.full((len(start),), frame, device=start.device)).double())
        off.append(np.linalg.norm(found - truth.points[frame][truth.surface], axis=1))
        moved.append(np.linalg.norm(truth.points[frame][truth.surface] - truth.rest[truth.surface], axis=1))
    share, still = (100 * np.array(v) / diagonal(truth) for v in (off, moved))
    target = f"mean <= {mean:g} %" + ("" if median is None else f", median <= {median:g} %")
    reached = share.mean() <= mean and (median is None or np.median(share) <= median)
    return Row(
        what=f"{what}: surface points carried by w, off by",
        figure=f"mean {share.mean():.2f} %, median {np.median(share):.2f} % of the diagonal (without motion "
        f"{still.mean():.2f} and {np.median(still):.2f} %)",
        target=target, reached=bool(reached),
    )  # fmt: skip


def diagonal(truth: Truth) -> float:
    """Of the body's box at rest [m]."""
    return float(np.linalg.norm(np.ptp(truth.rest, axis=0)))


def cloud_rows(filmed: Filmed, cloud: Cloud4D, what: str) -> list[Row]:
    """Whether extracted points lie in the body, and whether they go where those pieces of it go."""
    truth = filmed.truth
    inside = inside_of(truth, cloud.points[0], slack=cloud.spacing / 2)
    off = [np.linalg.norm(cloud.points[f] - truth.warp(cloud.points[0], f), axis=1)[inside]
           for f in range(1, len(cloud.points))]  # fmt: skip
    share, within = 100 * float(np.mean(off)) / diagonal(truth), 100 * float(inside.mean())
    return [
        Row(what=f"{what}: extracted points inside the body, or within half their spacing of it",
            figure=f"{within:.1f} % of {len(inside)}", target=">= 95 %", reached=within >= 95),
        Row(what=f"{what}: 4D error of those, mean", figure=f"{share:.2f} % of the diagonal", target="<= 0.4 %",
            reached=share <= 0.4),
    ]  # fmt: skip


def inside_of(truth: Truth, points: np.ndarray, *, slack: float) -> np.ndarray:
    """Which points (M, 3) are in the body at rest, or nearer than slack [m] to where a point of it is."""
    return Mesh(vertices=truth.rest, faces=truth.triangles).distance(points).d <= slack


def bent_rows(filmed: Filmed, trained: Trained, cloud: Cloud4D, what: str) -> list[Row]:
    """The cost of a frame bent by the cloud, and what is lost to a cloud that moves as the body truly did."""
    renderer = Rerenderer(trained=trained, rest=cloud.points[0], spacing=cloud.spacing)
    true = [filmed.truth.warp(cloud.points[0], frame) for frame in range(len(cloud.points))]
    found, ceiling = (
        judged(filmed, lambda camera, frame, states=states: renderer.picture(states[frame], camera).colour)
        for states in (cloud.points, true)
    )
    camera = filmed.judges.cameras[0]
    seconds = []
    for frame in judged_frames(len(cloud.points)):
        begin = time.perf_counter()
        renderer.picture(cloud.points[frame], camera)
        seconds.append(time.perf_counter() - begin)
    size = " x ".join(map(str, camera.size))
    return [
        Row(what=f"{what}: a frame of {size} pixels bent by {cloud.points.shape[1]} points",
            figure=f"{np.median(seconds):.2f} s", target="<= 0.3 s", reached=bool(np.median(seconds) <= 0.3)),
        Row(what=f"{what}: object PSNR of frames bent by the cloud, and by the same points moved as is true",
            figure=f"{found:.1f} and {ceiling:.1f} dB", target="at most 2.5 dB apart",
            reached=found >= ceiling - 2.5),
    ]  # fmt: skip


def object_rows(shape: str, found: dict, out: Path) -> list[Row]:
    """A line of our Tables 1 and 2 from what `veo run` found."""
    material, pictures = found["material"], found["table_2"]
    every = [material[f"error_mm{of}"] for of in ("", "_homogeneous", "_no_change")]
    learned, even, still = (error["held_out"] or error["training"] for error in every)
    size = np.linalg.norm(np.ptp(read_plush(out / "reconstruction").points(0), axis=0))
    shown, simulated = (pictures[name]["masked"]["psnr"] for name in ("reconstructed", "simulated"))
    mean, high, most = (learned[k] for k in ("mean", "p95", "max"))
    return [
        Row(what=f"Table 1, {shape} (diagonal {1e3 * size:.0f} mm): held-out distance, average, 95 % and largest",
            figure=f"{mean:.2f}, {high:.2f}, {most:.2f} mm; one homogeneous material {even['mean']:.2f}, "
            f"no motion {still['mean']:.2f} mm"),
        Row(what=f"Table 2, {shape}: masked PSNR of held-out frames, reconstructed and simulated",
            figure=f"{shown:.1f} and {simulated:.1f} dB, {shown - simulated:.2f} apart", target="at most 0.3 dB apart",
            reached=shown - simulated <= 0.3),
    ]  # fmt: skip


def truth_row(shape: str, found: dict, out: Path, truth: Truth) -> Row:
    """How far simulated and reconstructed surface points that lie in the true body are from the truth, held out."""
    stored, frames = read_sequence(out / "material" / "object.vtkhdf"), found["material"]["frames"]
    surface, fixed = (stored.static[name].astype(bool) for name in ("surface", "fixed"))
    judged = surface & ~fixed & inside_of(truth, stored.static["x"], slack=0.0)
    rest, off = stored.static["x"][judged], []
    for t in frames["held_out"] or frames["training"][1:]:
        true = truth.warp(rest, round(stored.time[t] * PLUSH_FRAME_RATE))
        pair = stored.points[t], stored.point_data["observed"][t]
        off.append([np.linalg.norm(points[judged] - true, axis=1).mean() for points in pair])
    simulated, reconstructed = 1e3 * np.mean(off, axis=0)
    return Row(
        what=f"The same frames, {shape}: mean distance from where these points truly went, simulated and reconstructed",
        figure=f"{simulated:.2f} and {reconstructed:.2f} mm",
    )  # fmt: skip


def stiffness_row(shape: str, out: Path, truth: Truth) -> Row:
    """Whether points are stiff where the body truly is: forces are known up to scale, so a common factor is free."""
    static = read_sequence(out / "material" / "object.vtkhdf").static
    free = ~static["fixed"].astype(bool)
    x, mu, sd = (static[name][free] for name in ("x", "mu", "log_mu_sd"))
    true = truth.mu[cKDTree(truth.rest).query(x)[1]]
    off = np.log(mu / true)
    agree = np.corrcoef(np.log(true), np.log(mu))[0, 1]
    found, given = (np.diff(np.quantile(np.log10(m), (0.05, 0.95)))[0] for m in (mu, true))
    hold = np.abs(off - np.median(off)) < 1.96 * sd
    return Row(
        what=f"Material, {shape}: correlation of log mu with the truth, and decades that nine points in ten span; "
        "points whose 95 % interval holds the truth",
        figure=f"{agree:.2f}; {found:.1f} (truth {given:.1f}); {hold.mean():.0%}",
    )
