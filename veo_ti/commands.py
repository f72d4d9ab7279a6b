"""What the command line does: read, compute with a progress bar, write into a folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from recon.metrics import DistanceTable
from sim.basis import FitOptions
from sim.checks import require
from sim.cloud import CloudOptions
from sim.fit import FitState
from sim.terms.base import Term
from sim.terms.contact import Contact, contact_alpha
from veo_ti.diagnosis.causes import CATALOGUE
from veo_ti.diagnosis.effort import STEPS
from veo_ti.diagnosis.facts import facts
from veo_ti.diagnosis.report import write_diagnosis
from veo_ti.diagnosis.run import diagnose
from veo_ti.evaluation import evaluate
from veo_ti.identification import Identification, IdentifyOptions, identify
from veo_ti.interact import collider_of, force_of, vector
from veo_ti.object import VirtualElasticObject
from veo_ti.observation import Observation
from veo_ti.progress import console, waiting
from veo_ti.results import remove_checkpoints, sentence, write_identification
from veo_ti.store import SequenceWriter, read_sequence, writable_folder, write_json_atomic
from veo_ti.view import animation, error_map, lame_map, save_picture, sensitivity_map, turntable


def identify_source(
    source: str, out: Path, *, modes: int, every: int, paper: bool, diagnosed: bool = False
) -> dict[str, object]:
    """`veo identify`, and with diagnosed `veo run`: metrics of the written folder, then with the diagnosis in them."""
    result = identified(Observation.load(source), out, modes, every, paper)
    row = _paper_row(Path(source))
    metrics = write_identification(result, result.observation, out, paper=row, last=not diagnosed)
    console.print(sentence(metrics))
    return {**metrics, "diagnosis": _diagnosed(result, out)} if diagnosed else metrics


def diagnose_source(
    source: str, out: Path, *, modes: int, every: int, second: bool, effort: float
) -> dict[str, object]:  # fmt: skip
    """`veo diagnose`: the facts of the written folder."""
    require(effort > 0, "effort", "be positive", effort)
    found = identified(Observation.load(source), out, modes, every, paper=False)
    return _diagnosed(found, out, second=second, effort=effort)


def identified(observation: Observation, out: Path, modes: int, every: int, paper: bool) -> Identification:
    """The identified object; its checkpoints stay in `out`."""
    writable_folder(out)
    cloud = CloudOptions(mode="paper" if paper else "consistent")
    options = IdentifyOptions(fit=FitOptions(modes=modes), cloud=cloud, every=every)
    frames, points = observation.points.shape[:2]
    console.print(f"{observation.name or 'the measurement'}: {points} points, {frames} frames")
    with _progress(options.fit.iterations) as advance:
        return identify(observation, options=options, checkpoints=out, progress=advance)


def _diagnosed(
    result: Identification, out: Path, *, second: bool = True, effort: float = STEPS
) -> dict[str, object]:  # fmt: skip
    """One that is interrupted leaves what the first look said, and goes on when called again."""
    with waiting("diagnosis") as say:
        found = diagnose(
            result, CATALOGUE, second=second, effort=effort, checkpoints=out, progress=say,
            so_far=lambda first: write_json_atomic(out / "diagnosis.json", facts(first)),
        )  # fmt: skip
    written = write_diagnosis(found, out)
    remove_checkpoints(out)
    console.print(written["sentence"])
    return written


def _paper_row(source: Path) -> DistanceTable | None:
    """The paper's own result on a PLUSH folder that holds one, and a line on every part that the folder lacks."""
    if not source.is_dir():
        return None
    from recon.plush.reconstruction import (  # it needs torch: seconds that other inputs should not cost
        paper_table_row,
        read_plush,
    )

    folder = read_plush(source)
    for line in folder.missing:
        console.print(line)
    held = (source / "simulation" / "val_GT").exists() and (source / "simulation" / "val_simed").exists()
    return paper_table_row(folder) if held else None


@contextmanager
def _progress(most: int) -> Iterator:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        names = {"stream": "the width of the air stream", "rough": "a first guess",
                 "homogeneous": "one homogeneous material", "field": "per-point material"}  # fmt: skip
        task = bar.add_task("solving the first equilibria", total=len(names) * most)

        def advance(stage: str, state: FitState) -> None:
            text = f"{names[stage]}, step {len(state.objective) - 1}, noise {1e3 * state.sigma:.3g} mm"
            done = len(state.objective) - 1 + most * list(names).index(stage)
            bar.update(task, completed=done, description=text)

        yield advance


def evaluate_object(path: Path, source: str, out: Path) -> dict[str, object]:
    """`veo evaluate`: distances, an error picture, the simulated sequence."""
    writable_folder(out)
    obj, observation = VirtualElasticObject.load(path), Observation.load(source)
    result = evaluate(obj, observation)
    table = result.table()
    metrics = {
        "error_mm": {"mean": table.mean_mm, "p95": table.p95_mm, "max": table.max_mm},
        "rms_per_coordinate_mm": result.rms_mm(), "status": result.sentence,
        "force_scale_known": observation.force_scale_known,
    }  # fmt: skip
    with SequenceWriter(out / "evaluation.vtkhdf", static=obj.static, attributes=obj.attributes) as writer:
        for t, time in enumerate(observation.time):
            writer.append(float(time), result.y[t], {"observed": observation.points[t]})
    save_picture(error_map(obj.x, result.per_point_mm, title="Mean error of each point", up=obj.up), out / "error.png")
    write_json_atomic(out / "metrics.json", metrics)
    console.print(f"The simulation is {table.mean_mm:.2f} mm from the measurement on average.")
    return metrics


def simulate_object(
    path: Path, out: Path, forces: list[str], gravity: str | None, contacts: list[str], steps: int
) -> dict[str, object]:
    """`veo simulate`: the loads grow linearly over the steps; every step's equilibrium, a film and metrics."""
    writable_folder(out)
    require(steps >= 1, "steps", "be at least 1", steps)
    require(bool(forces or gravity or contacts), "veo simulate", "be given --force, --gravity or --contact", "none")
    obj = VirtualElasticObject.load(path)
    ramp = np.linspace(0, 1, steps + 1)[1:]
    terms: list[Term] = []
    for text in forces:
        total, place, radius = force_of(text)
        terms.append(obj.push_at(place, ramp[:, None] * total, radius))
    if gravity is not None:
        changed = obj.gravity + ramp[:, None] * (vector("gravity", gravity, 3) - obj.gravity)
        terms.append(obj.under_gravity(changed))
    alpha = contact_alpha(float(np.median(obj.lame.mu)), obj.cloud.spacing)
    for text in contacts:
        shape, position = collider_of(text, ramp)
        terms.append(Contact(shape=shape, volume=obj.cloud.volume, alpha=alpha, position=position))
    result = obj.simulate(*terms, frames=steps, gradual=True)
    moved = 1e3 * np.linalg.norm(result.y - obj.x, axis=2)
    with SequenceWriter(out / "simulation.vtkhdf", static=obj.static, attributes=obj.attributes) as writer:
        for t in range(steps):
            writer.append(float(ramp[t]), result.y[t], {"displacement": result.y[t] - obj.x})
    animation(result.y, moved, out / "motion.mp4", label="mm", title="Displacement", up=obj.up)
    metrics = {
        "status": result.sentence, "converged": result.converged, "residual": result.residual.tolist(),
        "largest_displacement_mm": float(moved.max()), "force_scale_known": obj.force_scale_known,
    }  # fmt: skip
    write_json_atomic(out / "metrics.json", metrics)
    console.print(f"The object moves by at most {moved.max():.2f} mm; {result.sentence}.")
    return metrics


def render_object(path: Path, out: Path) -> list[Path]:
    """`veo render`: the object's maps, a turntable, and its stored motion."""
    writable_folder(out)
    obj = VirtualElasticObject.load(path)
    up = obj.up
    pictures = [
        save_picture(lame_map(obj.x, obj.lame.mu, title="Shear modulus mu", up=up), out / "mu.png"),
        save_picture(lame_map(obj.x, obj.lame.mu, inside=True, title="mu, cut open", up=up), out / "mu_inside.png"),
        save_picture(lame_map(obj.x, obj.lame.lam, title="First Lame parameter lam", up=up), out / "lam.png"),
        save_picture(sensitivity_map(obj.x, obj.static["sensitivity"], up=up), out / "sensitivity.png"),
        turntable(obj.x, obj.lame.mu / 1e3, out / "mu.mp4", label="kPa", title="Shear modulus mu", log=True, up=up),
    ]
    stored = read_sequence(path / "object.vtkhdf" if path.is_dir() else path)
    if len(stored.time) > 1:
        moved = 1e3 * np.linalg.norm(stored.points - obj.x, axis=2)
        film = animation(
            stored.points, moved, out / "motion.mp4", label="mm", title="Simulated motion", time=stored.time, up=up
        )
        pictures.append(film)
    return pictures
