"""From a recording with mattes to a trained field, its quality on cameras that taught nothing, and a 4D cloud."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from recon.capture import Capture
from recon.exchange.nerfstudio import FILE as TRANSFORMS
from recon.exchange.nerfstudio import read_transforms
from recon.files import replacing
from recon.images import shown, write_image
from recon.plush.capture import CALIBRATION, MARKERS, read_capture
from recon.plush.reconstruction_writer import write_reconstruction
from recon.quality.lpips import Lpips
from recon.quality.similarity import QualityRow, psnr, quality_row
from recon.radiance.extraction import Cloud4D, ExtractOptions, extract
from recon.radiance.fields import Field
from recon.radiance.marching import Occupancy
from recon.radiance.options import TrainOptions
from recon.radiance.rendering import STILL, render
from recon.radiance.storage import load_trained, save_trained
from recon.radiance.training import Trained, fingerprint, train
from recon.views import ViewOptions, Views, training_views
from sim.checks import require
from veo_ti.reconstruction.pages import write_page
from veo_ti.store import Sequence as Stored
from veo_ti.store import writable_folder, write_json_atomic, write_sequence

FIELD, FACTS, CLOUD = "field.pt", "reconstruct.json", "cloud.vtkhdf"
_JUDGED = 6  # frames that the held-out cameras judge
_EVERY = 6  # one camera in so many judges, where none is chosen
_STILL = 0.002  # of the object's size, that a fixed point may seem to move
_LOW = 0.1  # of its height, within which fixed points are looked for


@dataclass(frozen=True, kw_only=True)
class ReconstructChoice:
    """resolution [px] of the longer side; test: cameras that judge, whose devices teach nothing; greys: whether the
    left and right ones of the others teach too."""

    resolution: int = 128
    test: tuple[str, ...] = ()
    greys: bool = False
    train: TrainOptions = field(default_factory=TrainOptions)
    extract: ExtractOptions = field(default_factory=ExtractOptions)

    @property
    def streams(self) -> tuple[str, ...]:
        """The sensors of a device that teach."""
        return ("colour", "left", "right") if self.greys else ("colour",)


def reconstruct_folder(
    folder: str | Path, out: str | Path, choice: ReconstructChoice | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, object]:  # fmt: skip
    """Write field.pt, `reconstruction/` as PLUSH has it, cloud.vtkhdf, pictures, reconstruct.json and .html into out.

    What is there already, made from the same recording and choice, is not made again. Raises ValueError for a
    recording without calibration or mattes, with one camera, or in which a frame shows nothing.
    """
    choice, say, out = choice or ReconstructChoice(), say or (lambda text: None), writable_folder(out)
    capture = capture_of(Path(folder), choice)
    say("pictures at training resolution")
    options = ViewOptions(resolution=choice.resolution, streams=choice.streams)
    views = training_views(capture, out / "views", options, say)
    judges = judging_views(capture, out, choice, say)
    trained = _trained(views, judges, choice, out, say)
    say("judging")
    row, pairs = _judged(trained, judges)
    say("points")
    cloud = extract(trained, views, choice.extract)
    fixed = fixed_points(cloud)
    _write_cloud(out, cloud, fixed)
    _keep_beside(Path(folder), out)
    facts = _facts(capture, views, judges, trained, row, cloud, fixed)
    write_json_atomic(out / FACTS, facts)
    write_page(out, Path(folder), facts, pairs, cloud)
    return facts


def judging_views(
    capture: Capture, out: Path, choice: ReconstructChoice, say: Callable[[str], None] | None = None
) -> Views:
    """The pictures of the cameras that judge; decoded once."""
    return training_views(capture, out / "views", ViewOptions(resolution=choice.resolution, roles=("test",)), say)


def fixed_points(cloud: Cloud4D) -> np.ndarray:
    """Points (N,) bool near the ground that never move: what the object stands on. The world's y points upwards."""
    size = float(np.linalg.norm(np.ptp(cloud.points[0], axis=0)))
    height = cloud.points[0, :, 1] - cloud.points[0, :, 1].min()
    moved = np.linalg.norm(cloud.points - cloud.points[:1], axis=2).max(axis=0)
    low = height < _LOW * np.ptp(cloud.points[0, :, 1])
    still = moved < max(_STILL * size, float(np.quantile(moved[low], 0.5)))
    return low & still


def capture_of(folder: Path, choice: ReconstructChoice) -> Capture:
    """The recording with the roles that the choice gives; raises ValueError where it cannot be reconstructed."""
    capture = read_transforms(folder) if (folder / TRANSFORMS).exists() else read_capture(folder, strict=False)
    require(len(capture.cameras) > 0, "FOLDER", "hold calibrated cameras: veo calibrate", " ".join(capture.missing))
    able = [c for c in capture.cameras if c.stream == "colour" and c.role != "nozzle" and c.name in capture.mattes]
    require(len(able) >= 3, "FOLDER", f"hold mattes of at least three cameras: veo matte {folder}", f"{len(able)}")
    names = [camera.name for camera in able]
    test = choice.test or tuple(names[_EVERY // 2 :: _EVERY])
    strange = sorted(set(test) - set(names))
    require(not strange, "--test", f"be among {', '.join(names)}", ", ".join(strange))
    require(len(test) <= len(names) - 2, "--test", "leave two cameras to learn from", ", ".join(test))
    with_mattes = [c for c in capture.cameras if c.name in capture.mattes]
    judging = {c.device for c in able if c.name in test}  # a grey sensor sees almost what the colour one beside it does
    return replace(capture, cameras=tuple(replace(c, role="test") if c.device in judging else c for c in with_mattes))


def _trained(
    views: Views, judges: Views, choice: ReconstructChoice, out: Path, say: Callable[[str], None]
) -> Trained:
    """The field that is there, when it was made from the same choice and pictures, else a new one.

    A held-out camera is shown every so often, in training/NUMBER.png: rendered, filmed.
    """
    found = load_trained(out / FIELD) if (out / FIELD).exists() else None
    if found is not None and found.made_from == fingerprint(views, choice.train):
        return found

    def watch(step: int, model: Field, occupancy: Occupancy) -> None:
        frame = 0 if step <= choice.train.canonical_steps else len(judges.times) // 2
        picture, filmed = render(model, occupancy, judges.cameras[0], frame=frame).colour, judges.images[0][frame] / 255
        write_image(out / "training" / f"{step:06d}.png", shown(np.concatenate([picture, filmed], axis=1)))
        seen = judges.mattes[0][frame] > 127
        told = f", {psnr(picture, filmed, seen):.1f} dB on the object in {judges.cameras[0].name}" if seen.any() else ""
        say(f"step {step}{told}")

    trained = train(views, out / "training", choice.train, say=say, watch=watch)
    save_trained(out / FIELD, trained, choice.train.field)
    return trained


def _judged(trained: Trained, judges: Views) -> tuple[QualityRow, list[tuple[str, int, np.ndarray, np.ndarray]]]:
    """Quality on cameras that taught nothing, in a few frames; and the pairs of pictures it was measured on."""
    pairs, mattes = [], []
    for camera, frame, target, matte in judges.looks(judged_frames(len(judges.times))):
        picture = render(trained.field, trained.occupancy, camera, frame=frame, fineness=STILL).colour
        pairs.append((camera.name, frame, picture, target))
        mattes.append(matte)
    renders, filmed = ([pair[side] for pair in pairs] for side in (2, 3))
    return quality_row(renders, filmed, mattes, lpips_or_none()), pairs


def judged_frames(count: int) -> list[int]:
    """Which of so many frames the held-out cameras judge: a few, evenly."""
    return np.unique(np.linspace(0, count - 1, _JUDGED).astype(int)).tolist()


def lpips_or_none() -> Lpips | None:
    """The measure, or None where its weights are not installed."""
    try:
        return Lpips.load()
    except ValueError:
        return None


def _write_cloud(out: Path, cloud: Cloud4D, fixed: np.ndarray) -> None:
    every = np.arange(cloud.points.shape[1])
    write_reconstruction(out, vertices=cloud.points, colors=cloud.colours, object_index=every,
                         fixed=np.flatnonzero(fixed))  # fmt: skip
    static = {"colour": cloud.colours, "surface": cloud.surface, "normal": cloud.normals, "fixed": fixed}
    write_sequence(out / CLOUD, Stored(time=cloud.times, points=cloud.points, static=static))


def _keep_beside(folder: Path, out: Path) -> None:
    """Calibration and nozzle's path beside the cloud: the result is then a PLUSH folder that `veo identify` takes."""
    for source in (folder / "capture" / name for name in (MARKERS, CALIBRATION)):
        if source.exists():
            goal = out / "capture" / source.name
            goal.parent.mkdir(exist_ok=True)
            with replacing(goal) as partial:
                partial.write_bytes(source.read_bytes())


def _facts(
    capture: Capture, views: Views, judges: Views, trained: Trained, row: QualityRow, cloud: Cloud4D, fixed: np.ndarray
) -> dict[str, object]:
    names: Sequence[str] = [camera.name for camera in judges.cameras]
    count = cloud.points.shape[1]
    return {
        "sentence": f"{len(views.times)} frames of {len(views.cameras)} cameras became a field that shows {len(names)} "
        f"held-out cameras with {row.object_psnr:.1f} dB on the object, and {count} points.",
        "status": trained.status, "training": trained.sentence, "train_cameras": [c.name for c in views.cameras],
        "test_cameras": list(names), "quality": asdict(row), "points": count,
        "surface_points": int(cloud.surface.sum()), "fixed_points": int(fixed.sum()), "spacing_mm": 1e3 * cloud.spacing,
        "missing": list(capture.missing),
    }  # fmt: skip
