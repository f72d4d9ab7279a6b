"""Make the rig's stored motions with finite elements: `python tests/make_rig_motions.py [SHAPE ...] [--out FILE]`.

A few minutes a shape on one core; what it says at the end is what the rig's note quotes.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from rig_bodies import BODIES
from rig_outlines import Pull, Soft
from rig_solver import Model, Solver, march
from scipy.sparse import csr_matrix

from recon.rig.body import Body, edges_of
from recon.rig.jet import Stream, stream_forces
from recon.rig.motion import KNOT, STORE, Motion, coded, decoded, pack, stored

FRAMES = 96
DISTANCE = 0.30  # [m] from the nozzle to the place it points at
PULLS = ((1, 14), (15, 28))  # first and last frame of each line's pull
SHAKY = (0.004, np.deg2rad(1.2))  # of the hand that holds the nozzle: [m], [rad]
KEPT = 15e-6  # [m], the stored motion is this close to the computed one
STRAINED = 0.0025  # and its strain to this share, in the energy norm, but for
STILL = 1e-11  # [J]
ROUNDED = 0.039  # share of the strain, in the energy norm and in half of the frames, that rounding the modes may add
STRAINED_AT_ALL = 1e-9  # [J], the frames that count there
COARSEST = 4e-6  # [m], the unit that rounding begins with


def streams(soft: Soft, seed: int = 0) -> list[Stream]:
    """The nozzle's path through its stations, in a hand that is not quite still."""
    frame, target, source = (np.array(column, float) for column in zip(*soft.path, strict=True))
    at = np.arange(FRAMES)
    target, source = (np.stack([np.interp(at, frame, a[:, i]) for i in range(3)], axis=1) for a in (target, source))
    source /= np.linalg.norm(source, axis=1, keepdims=True)
    rng, knots = np.random.default_rng(seed), np.arange(0, FRAMES + 8, 8)
    wobble = np.stack([np.interp(at, knots, rng.uniform(-1, 1, len(knots))) for _ in range(6)], axis=1)
    direction = -source + SHAKY[1] * wobble[:, :3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = target + DISTANCE * source + SHAKY[0] * wobble[:, 3:]
    return [
        Stream(position=p, direction=d, force=soft.jet, footprint=soft.footprint)
        for p, d in zip(position, direction, strict=True)
    ]


def tension(pull: Pull, first: int, last: int) -> np.ndarray:
    """How hard the line is pulled in each frame, (FRAMES,) [N]: up in half the time, held, let go in a quarter."""
    phase = (np.arange(FRAMES) - first + 1) / (last - first + 2)
    up, down = np.clip(phase / 0.5, 0, 1), np.clip((1 - phase) / 0.25, 0, 1)
    return pull.force * np.sin(np.pi / 2 * np.minimum(up, down)) ** 2


def knot_of(model: Model, pull: Pull) -> np.ndarray:
    """The skin's nodes to which the line is tied, by number."""
    distance = np.linalg.norm(model.body.nodes - pull.knot, axis=1)
    tied = np.flatnonzero(model.body.surface & (distance < KNOT) & ~model.held)
    return tied if len(tied) else np.flatnonzero(model.body.surface)[[distance[model.body.surface].argmin()]]


def simulate(soft: Soft, intorder: int) -> tuple[Motion, float, str]:
    """The motion of a body, the unit [m] in which its modes are to be stored, and what it is like."""
    model = Model.of(soft, intorder)
    body, blown = model.body, streams(soft)
    knots = [knot_of(model, pull) for pull in soft.pulls]
    tensions = np.stack([tension(p, *span) for p, span in zip(soft.pulls, PULLS, strict=True)], axis=1)

    def load(frame: int, u: np.ndarray) -> np.ndarray:
        y = body.nodes + u
        x, area = body.skin_points(y)
        force = body.consistent @ stream_forces(blown[frame], x, area, y, body.triangles)
        for pull, knot, strength in zip(soft.pulls, knots, tensions[frame], strict=True):
            way = np.array(pull.anchor) - y[knot].mean(axis=0)
            force[knot] += strength / len(knot) * way / np.linalg.norm(way)
        return force

    solver, u, reaction, began = Solver(model), [], [], time.perf_counter()
    for frame, found in enumerate(march(solver, [lambda v, f=f: load(f, v) for f in range(FRAMES)])):
        u.append(found)
        reaction.append((solver.internal(found) * model.held[:, None]).sum(axis=0))
        print(
            f"frame {frame}: {1e3 * np.linalg.norm(found, axis=1).max():.1f} mm, {time.perf_counter() - began:.0f} s",
            flush=True,
        )
    u = np.stack(u)
    mass, stiffness = model.mass(soft.density), model.stiffness()
    energy = np.array([solver.energy(v) for v in u])
    modes, course = reduced(u, stiffness, energy)
    fine = fineness(body, modes, course, stiffness, energy)
    flat = modes.reshape(len(modes), -1)
    ratio = 2 * soft.poisson(body.nodes) / (1 - 2 * soft.poisson(body.nodes))
    motion = Motion(
        body=body, held=model.held, mu=soft.mu(body.nodes), lam=ratio * soft.mu(body.nodes), modes=modes, course=course,
        mass=np.einsum("anj,bnj->ab", modes, np.stack([mass @ m for m in modes])),
        stiffness=flat @ (stiffness @ flat.T), position=np.stack([s.position for s in blown]),
        direction=np.stack([s.direction for s in blown]), force=soft.jet, footprint=soft.footprint,
        knots=tuple(knots), anchors=np.array([p.anchor for p in soft.pulls]), tension=tensions,
        reaction=np.stack(reaction), density=soft.density,
    )  # fmt: skip
    worst = np.linalg.norm(u, axis=2).max(axis=1)
    off = np.abs(np.einsum("tr,rnj->tnj", course, modes) - u).max()
    said = f"{len(body.nodes)} nodes, {len(modes)} modes, off by {1e6 * off:.0f} um, moved {1e3 * worst.max():.0f} mm"
    return motion, fine, f"{said}, unit {1e6 * fine:g} um"


def reduced(u: np.ndarray, stiffness: csr_matrix, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes (R, N, 3) [m] and their course (T, R) in -1..1 whose product is u (T, N, 3) but for KEPT and STRAINED.

    The modes are orthogonal in the energy of the rest shape: a small error of short waves is a large one of the stress.
    """
    flat = u.reshape(len(u), -1)
    size, share = np.linalg.eigh(flat @ (stiffness @ flat.T))
    size, share = np.sqrt(np.maximum(size[::-1], 0)), share[:, ::-1]
    for rank in range(1, len(u)):
        course = share[:, :rank] * size[:rank]
        modes = (share[:, :rank] / size[:rank]).T @ flat
        left = ((share[:, rank:] * size[rank:]) ** 2).sum(axis=1)
        if np.abs(course @ modes - flat).max() < KEPT and (left <= 2 * energy * STRAINED**2 + STILL).all():
            break
    most = np.abs(course).max(axis=0)
    return (modes * most[:, None]).reshape(rank, *u.shape[1:]), course / most


def fineness(body: Body, modes: np.ndarray, course: np.ndarray, stiffness: csr_matrix, energy: np.ndarray) -> float:
    """The unit [m] of the stored modes (R, N, 3): rounding is noise of the shortest waves, which strains the most."""
    edges, _ = edges_of(body.tetrahedra)
    values, unit = np.moveaxis(modes, 0, 1).reshape(len(body.nodes), -1), COARSEST
    while True:
        off = decoded(coded(values, edges, unit), edges, unit) - values
        off = np.moveaxis(off.reshape(len(off), -1, 3), 1, 0).reshape(len(modes), -1)
        added = np.einsum("ta,ab,tb->t", course, off @ (stiffness @ off.T), course) / 2
        if np.median((added / np.maximum(energy, STRAINED_AT_ALL))[energy > STRAINED_AT_ALL]) < ROUNDED**2:
            return unit
        unit /= 2


def main() -> None:
    """Simulate the shapes asked for, keep the others that the file has, and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shapes", nargs="*", default=list(BODIES))
    parser.add_argument("--out", type=Path, default=STORE)
    parser.add_argument("--intorder", type=int, default=2)
    given = parser.parse_args()
    arrays = stored(given.out) if given.out.exists() else {}
    for shape in given.shapes:
        motion, fine, said = simulate(BODIES[shape](), given.intorder)
        others = {key: value for key, value in arrays.items() if not key.startswith(f"{shape}/")}
        arrays = others | pack(shape, motion, fine)
        np.savez_compressed(given.out, **arrays)
        print(f"{shape}: {said}; {given.out.name} is now {given.out.stat().st_size / 1e6:.2f} MB", flush=True)


if __name__ == "__main__":
    main()
