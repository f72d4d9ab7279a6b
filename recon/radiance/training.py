"""Train a dynamic field on filmed pictures: its canonical state first, then all frames, one joining after the other."""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from recon.radiance.batches import Pixels, frames_of
from recon.radiance.device import device
from recon.radiance.fields import Box, Dynamic
from recon.radiance.hulls import hulls_of
from recon.radiance.losses import colour_loss, motion_loss, shape_loss
from recon.radiance.marching import Occupancy
from recon.radiance.options import TrainOptions
from recon.radiance.rendering import along
from recon.radiance.run_state import Run
from recon.radiance.stopping import Stops
from recon.views import Views
from sim.checks import require

Watch = Callable[[int, Dynamic, Occupancy], None]  # told the step and shown the field every so often

CHECKPOINT = "checkpoint.pt"
_EVERY = 200  # steps between checkpoints
_SMOOTH = 0.98  # of the running mean of the loss
_MEAN = 0.2  # share of all steps, the last ones, the mean of whose states is what was learnt: less of it is noise
_RAYS = (256, 8192)  # fewest and most in a step
_WORSE = 5.0  # times its best running mean, at which the loss counts as diverged
_RESTARTS = 3
_TRIED, _TRIED_RAYS = 4, 512  # motions that a joining frame may start from, and rays that choose
_LOOK = 100  # steps between looks at what has become opaque
_LOOKED = 16  # frames looked at each time
_SCHEME = 8  # of this training: what an earlier one left is not gone on with
_WHOLE = 20  # one ray in so many goes on behind what is opaque, or the inside would never be learnt


@dataclass(frozen=True, kw_only=True, eq=False)
class Trained:
    """field, where it may have something, how the training ended: "done" or "diverged", with a sentence; and the
    fingerprint of what it was made from."""

    field: Dynamic
    box: Box
    occupancy: Occupancy
    status: str
    sentence: str
    made_from: str


def train(
    views: Views, folder: str | Path, options: TrainOptions | None = None, *,
    say: Callable[[str], None] | None = None, watch: Watch | None = None, look: int = 1000,
) -> Trained:  # fmt: skip
    """Reconstruct what views show: a canonical field at frame 0 and the motion of all frames.

    say: told what is being done; watch: shown the field every `look` steps.
    A checkpoint in the folder is gone on from when it was made from the same views and options. A loss that is not
    finite or grows goes back to the last checkpoint at half the rates; after three times the status is "diverged".
    Raises ValueError without mattes, with one camera, with fewer than canonical_frames, or where one shows nothing.
    """
    options, folder, say = options or TrainOptions(), Path(folder), say or (lambda text: None)
    first, count = options.canonical_frames, len(views.times)
    require(first <= count, "canonical_frames", f"be at most the {count} frames there are", first)
    folder.mkdir(parents=True, exist_ok=True)
    box, occupancy = hulls_of(views, cells=options.cells, say=say)
    pixels, stops = Pixels.of(views, occupancy), Stops.of(occupancy)
    made_from = fingerprint(views, options)
    run = _started(views, box, options)
    run.resume(folder / CHECKPOINT, made_from)
    run.save(folder / CHECKPOINT, made_from)
    total = options.steps(count)

    def ended(status: str, sentence: str) -> Trained:
        return Trained(field=run.learnt.eval(), box=box, occupancy=occupancy, status=status, sentence=sentence,
                       made_from=made_from)  # fmt: skip

    while run.step < total:
        _look(run, stops, options)
        loss = _step(run, pixels, occupancy, stops, options)
        if _diverged(run, loss):
            if run.restarts == _RESTARTS:
                told = (
                    f"the training diverged {_RESTARTS + 1} times, last at step {run.step}; the last checkpoint is kept"
                )
                run.resume(folder / CHECKPOINT, made_from)
                return ended("diverged", told)
            restarts, slower = run.restarts + 1, run.slower / 2
            run.resume(folder / CHECKPOINT, made_from)
            run.restarts, run.slower = restarts, slower
            continue
        run.step += 1
        if run.step > (1 - _MEAN) * total:
            run.take_in()
        if run.step % _EVERY == 0 or run.step == total:
            run.save(folder / CHECKPOINT, made_from)
            say(f"step {run.step} of {total}, loss {run.mean:.4f}")
        if watch is not None and (run.step % look == 0 or run.step == total):
            watch(run.step, run.learnt, occupancy)
    return ended("done", f"trained for {total} steps")


def _started(views: Views, box: Box, options: TrainOptions) -> Run:
    model = Dynamic(box, len(views.times), options.field, seed=options.seed).to(device())
    gains = torch.nn.Parameter(torch.tensor([[1.0, 0.0]], device=device()).repeat(len(views.cameras), 1))
    groups = [
        {"name": "field", "params": [*model.canonical.parameters()], "eps": 1e-15, "betas": (0.9, 0.99)},
        {"name": "latents", "params": [model.latents]},
        {"name": "others", "params": [*model.bending.parameters(), *model.warping.parameters(), gains]},
    ]
    optimiser = torch.optim.Adam(groups, fused=True)  # each step sets the rates
    generator = torch.Generator().manual_seed(options.seed)
    with torch.no_grad():
        model.latents[1:2] = 0.1 * torch.randn(1, model.latents.shape[1], generator=generator).to(model.latents)
    return Run(model=model, gains=gains, optimiser=optimiser, generator=generator)


def _look(run: Run, stops: Stops, options: TrainOptions) -> None:
    """Every so many steps, and of many frames some at a time."""
    turn, left = divmod(run.step, _LOOK)
    if turn and not left:
        frames = len(run.model.latents) if run.step > options.canonical_steps else options.canonical_frames
        turns = -(-frames // _LOOKED)
        stops.look(run.model, range(turn % turns, frames, turns))


def _step(run: Run, pixels: Pixels, occupancy: Occupancy, stops: Stops, options: TrainOptions) -> float:
    """One batch of rays, one step; the loss."""
    moving = run.step >= options.canonical_steps
    chosen = _joined(run, pixels, occupancy, options) if moving else range(options.canonical_frames)
    _set_rates(run, options, moving)
    batch = pixels.draw(frames_of(run.rays, chosen, run.generator), run.generator)
    behind, shift = (torch.rand(run.rays, *n, generator=run.generator).to(device()) for n in ((3,), ()))
    since, until = stops.span(batch.start, batch.direction, batch.frame)
    until[::_WHOLE] = torch.inf
    canonical: list[torch.Tensor] = []

    def field(places: torch.Tensor, frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        canonical.append(run.model.bent(places, frame) if moving else places)
        return run.model.canonical(canonical[0])

    seen, samples, thickness = along(field, occupancy, batch.start, batch.direction, batch.frame,
                                    shift=shift, since=since, until=until)  # fmt: skip
    loss = colour_loss(seen, batch, run.gains, behind)
    loss = loss + shape_loss(seen, samples, thickness, batch, options.weights)
    moved = motion_loss(run.model, samples, canonical[0], thickness, options.weights, run.generator) if moving else 0
    run.optimiser.zero_grad(set_to_none=True)
    (loss + moved).backward()
    run.optimiser.step()  # of all that took part
    run.rays = int(np.clip(run.rays * options.samples / max(len(samples.depth), 1), *_RAYS))
    return float(loss.detach())


def _joined(run: Run, pixels: Pixels, occupancy: Occupancy, options: TrainOptions) -> list[int]:
    """The frames that take part; one that joins starts from the motion that suits it best, and is drawn often."""
    frames = len(run.model.latents)
    done = options.moved(run.step)
    count, before = (
        min(frames, 2 + int(options.moved(step) / options.ramp * (frames - 1))) for step in (run.step, run.step - 1)
    )
    with torch.no_grad():
        for frame in range(max(before, 2), count):
            run.model.latents[frame] = run.model.latents[_alike(run, pixels, occupancy, frame)]
    every = list(range(count))
    return every + [count - 1] * count + [count - 2] * (count // 2) if done < options.ramp else every


def _alike(run: Run, pixels: Pixels, occupancy: Occupancy, frame: int) -> int:
    """Which earlier frame's motion shows this frame best: the last ones, and some of all."""
    batch = pixels.draw(torch.full((_TRIED_RAYS,), frame), run.generator)
    tried = {*range(max(1, frame - _TRIED), frame), *np.linspace(1, frame - 1, _TRIED).astype(int).tolist()}
    losses = {}
    for other in sorted(tried):

        def field(places: torch.Tensor, frames: torch.Tensor, other: int = other) -> tuple[torch.Tensor, torch.Tensor]:
            return run.model(places, torch.full_like(frames, other))

        seen = along(field, occupancy, batch.start, batch.direction, batch.frame)[0]
        losses[other] = float(colour_loss(seen, batch, run.gains, torch.zeros_like(batch.colour)))
    return min(losses, key=losses.__getitem__)


def _set_rates(run: Run, options: TrainOptions, moving: bool) -> None:
    """Those of the options; and fine levels of the hash grid do not pull at the bending while frames join."""
    rates = options.rates(run.step, len(run.model.latents))
    for group in run.optimiser.param_groups:
        group["lr"] = run.slower * rates[group["name"]]
    if options.field.encoding == "hash":
        weight = run.model.canonical.encoding.level_weight
        weight[:] = 1
        weight[options.pulling :] = float(not moving or options.moved(run.step) >= options.ramp)


def _diverged(run: Run, loss: float) -> bool:
    """Whether the loss is no number, or its running mean has grown far above its best."""
    if not math.isfinite(loss):
        return True
    run.mean = loss if math.isinf(run.mean) else _SMOOTH * run.mean + (1 - _SMOOTH) * loss
    run.best = min(run.best, run.mean)
    return run.mean > _WORSE * run.best and run.mean > _WORSE * 1e-2


def fingerprint(views: Views, options: TrainOptions) -> str:
    """Changes when what was filmed, or how it is trained on, does."""
    return hashlib.sha256(repr((_SCHEME, options, views.identity)).encode()).hexdigest()
