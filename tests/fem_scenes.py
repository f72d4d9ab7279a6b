"""Reference scenes for tests of the meshless code: solved finite-element bodies and a stored noisy sequence."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import fem
import numpy as np
from scipy.optimize import root

TWO_REGION = Path(__file__).parent / "data" / "two_region.npz"


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A solved box clamped at x = lower[0], and all that a second simulator needs to solve it again."""

    lower: np.ndarray  # (3,) [m] corner
    upper: np.ndarray  # (3,) [m] opposite corner
    mu: fem.Field  # positions (M, 3) -> (M,) [Pa]
    lam: fem.Field
    body_force: np.ndarray  # (3,) [N/m3]
    traction: np.ndarray  # (3,) [Pa] dead load on the face x = upper[0]
    body: fem.FemBody
    u: np.ndarray  # (N, 3) [m] nodal displacement

    def displacement(self, points: np.ndarray) -> np.ndarray:
        """The solution at rest positions (M, 3) [m], (M, 3) [m]."""
        return fem.displacement_at(self.body, self.u, points)

    @property
    def tip(self) -> np.ndarray:
        """Displacement of the centre of the free end, (3,) [m]."""
        return self.displacement(np.array([[self.upper[0], *(self.lower + self.upper)[1:] / 2]]))[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Sequence:
    """Tracked points under known forces with the true material, in the terms of an observation."""

    points: np.ndarray  # (T, N, 3) [m]
    forces: np.ndarray  # (T, N, 3) [N]
    time: np.ndarray  # (T,) [s]
    fixed: np.ndarray  # (N,) bool
    surface: np.ndarray  # (N,) bool
    volume: np.ndarray  # (N,) [m3]
    nozzle_position: np.ndarray  # (T, 3) [m]
    nozzle_direction: np.ndarray  # (T, 3)
    nozzle_force: np.ndarray  # (T,) [N]
    nozzle_footprint: float  # [m]
    mu_true: np.ndarray  # (N,) [Pa]
    lam_true: np.ndarray  # (N,) [Pa]
    spacing: float  # [m] mean distance of neighbouring points
    sigma: float = 0.0  # [m] noise per coordinate on all frames but frame 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Jet:
    """Air jets p0 exp(-r^2 / 2 sigma^2) max(0, -n.d) d, one per frame, r the distance from the axis."""

    position: np.ndarray  # (T, 3) [m]
    direction: np.ndarray  # (T, 3)
    pressure: np.ndarray  # (T,) [Pa] p0
    footprint: float  # [m] sigma

    def traction(self, frame: int) -> fem.Traction:
        """The dead load of one frame on the rest surface, in Pa."""
        d, origin = self.direction[frame], self.position[frame]

        def pull(x: np.ndarray, n: np.ndarray) -> np.ndarray:
            across = (x - origin) - ((x - origin) @ d)[:, None] * d
            strength = np.exp(-(across**2).sum(1) / (2 * self.footprint**2)) * np.maximum(0, -n @ d)
            return self.pressure[frame] * strength[:, None] * d

        return pull

    @property
    def force(self) -> np.ndarray:
        """Force of each whole jet on a flat wall, 2 pi sigma^2 p0, (T,) [N]."""
        return 2 * np.pi * self.footprint**2 * self.pressure


def constant(value: float) -> fem.Field:
    """The field of one value."""
    return lambda x: np.full(len(x), float(value))


def lame_fields(young: fem.Field, poisson: float) -> tuple[fem.Field, fem.Field]:
    """Fields of mu and lam [Pa] from a field of Young's modulus."""
    return (
        lambda x: young(x) / (2 * (1 + poisson)),
        lambda x: young(x) * poisson / ((1 + poisson) * (1 - 2 * poisson)),
    )


def clamped_box(
    *,
    size: tuple,
    cells: tuple,
    mu: fem.Field,
    lam: fem.Field,
    body_force: tuple = (0, 0, 0),
    traction: tuple = (0, 0, 0),
) -> Scene:
    """Solve the box [0, l] x [-w/2, w/2] x [-h/2, h/2] clamped at x = 0."""
    upper = np.array([size[0], size[1] / 2, size[2] / 2])
    lower = upper - np.array(size)
    body = fem.FemBody.build(fem.box_mesh(lower, upper, cells), mu, lam, lambda x: x[:, 0] < 1e-9 * size[0])
    load = fem.surface_load(body.basis, lambda x, n: (n[:, :1] > 0.5) * np.asarray(traction, float))
    u = fem.solve(body, nodal_force=load, body_force=body_force, steps=2)
    force, pull = np.asarray(body_force, float), np.asarray(traction, float)
    return Scene(lower=lower, upper=upper, mu=mu, lam=lam, body_force=force, traction=pull, body=body, u=u)


@lru_cache
def cantilever(gravity: float, cells: tuple = (20, 3, 3), width: float = 0.2) -> Scene:
    """Beam of length 1, E = 1, nu = .3 under -gravity in z [N/m3]; 2e-3, 6e-3, 1.2e-2 bend it by 8, 22, 41 %."""
    mu, lam = lame_fields(constant(1.0), 0.3)
    return clamped_box(size=(1.0, width, width), cells=cells, mu=mu, lam=lam, body_force=(0, 0, -gravity))


@lru_cache
def two_material_block(
    axis: int = 0, traction: tuple = (0.08, 0.0, -0.06), contrast: float = 4.0, cells: tuple = (8, 4, 4)
) -> Scene:
    """Block 1 x .5 x .5 whose half towards + `axis` has E = 1 and the other `contrast`; nu = .3; pulled at x = 1."""
    middle = 0.5 if axis == 0 else 0.0
    mu, lam = lame_fields(lambda x: np.where(x[:, axis] < middle, contrast, 1.0), 0.3)
    return clamped_box(size=(1.0, 0.5, 0.5), cells=cells, mu=mu, lam=lam, traction=traction)


def uniaxial_stretch(stress: float, mu: float, lam: float) -> tuple[float, float]:
    """Closed form of uniaxial tension: axial and lateral stretch (a, b) under a nominal stress [Pa].

    P = mu (s - 1/s) + lam (J - 1) J / s with J = a b^2 equals the stress along the axis and zero across it.
    """

    def balance(s: np.ndarray) -> np.ndarray:
        J = s[0] * s[1] ** 2
        return mu * (s - 1 / s) + lam * (J - 1) * J / s - np.array([stress, 0.0])

    young, poisson = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
    found = root(balance, 1 + np.array([1, -poisson]) * stress / young, tol=1e-13)
    if not found.success:
        raise RuntimeError(f"uniaxial tension has no solution at {stress} Pa: {found.message}")
    return float(found.x[0]), float(found.x[1])


def jet_frames(body: fem.FemBody, jet: Jet) -> Iterator[np.ndarray]:
    """Equilibrium displacement (N, 3) [m] of each frame's jet, warm-started where that converges."""
    u = np.zeros_like(body.nodes)
    for frame in range(len(jet.pressure)):
        load = fem.surface_load(body.basis, jet.traction(frame))
        try:
            u = fem.solve(body, nodal_force=load, start=u)
        except RuntimeError:
            u = fem.solve(body, nodal_force=load, steps=6)
        yield u


def record(body: fem.FemBody, jet: Jet, mu: fem.Field, lam: fem.Field) -> Sequence:
    """The noise-free sequence of a body under jets, seen at the vertices of its mesh."""
    seen = fem.hats(body.mesh)
    rest, count, frames = body.mesh.p.T, body.mesh.p.shape[1], len(jet.pressure)
    edges, surface = body.mesh.edges, body.surface[:count]
    forces = np.stack([fem.surface_load(seen, jet.traction(frame)) for frame in range(frames)])
    return Sequence(
        # The vertices are the first nodes of the quadratic body.
        points=np.stack([rest + u[:count] for u in jet_frames(body, jet)]),
        forces=np.where(surface[:, None], forces, 0.0),  # rounding leaves 1e-16 N inside
        time=np.arange(frames) / 40,
        fixed=body.fixed[:count].all(1),
        surface=surface,
        volume=fem.volumes(seen),
        nozzle_position=jet.position,
        nozzle_direction=jet.direction,
        nozzle_force=jet.force,
        nozzle_footprint=jet.footprint,
        mu_true=mu(rest),
        lam_true=lam(rest),
        spacing=float(np.linalg.norm(rest[edges[0]] - rest[edges[1]], axis=1).mean()),
    )


def with_noise(sequence: Sequence, sigma: float, seed: int) -> Sequence:
    """The sequence with Gaussian tracking noise of `sigma` [m] per coordinate on all frames but frame 0."""
    noise = np.random.default_rng(seed).normal(0, 1, sequence.points.shape) * sigma
    noise[0] = 0
    return replace(sequence, points=sequence.points + noise, sigma=float(sigma))


@lru_cache
def two_region_sequence(noise_in_spacing: float = 0.05, seed: int = 0) -> Sequence:
    """A clamped beam, stiff half and soft half (contrast 5), under 24 jets; stored, made by make_example.py."""
    with np.load(TWO_REGION) as stored:
        values = {key: stored[key].astype(bool if stored[key].dtype == bool else float) for key in stored}
    scalars = {key: float(values[key]) for key in ("spacing", "sigma", "nozzle_footprint")}
    sequence = Sequence(**{**values, **scalars})
    return with_noise(sequence, noise_in_spacing * sequence.spacing, seed)
