"""The beam about a settled pose with a handful of shapes: stiffness, mass, and closed-form motion after a release."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr
from scipy.sparse.linalg import eigsh, splu

from sim.direct import Layout
from sim.elastic import Elastic
from sim.energy import Energy
from sim.lame import Lame
from veo_ti.beam import DENSITY, BeamModel
from veo_ti.body import MarkerTies

MODES = 6  # the lowest ones; the sixth of the silicone beam swings five times as fast as the first


@dataclass(frozen=True, kw_only=True)
class Physics:
    """What moves the beam beside its elasticity; the defaults are the quasi-static model.

    `(M + M_added) q'' + (a (M + M_added) + b e K) q' + e K (q + sum_i g_i (q - z_i)) = 0, z_i' = (q - z_i) / tau_i`:
    a standard linear solid of several branches, E the modulus long after.
    """

    modulus: float = 1.0  # e, Young's modulus over the one of the settled poses
    inertia: bool = False
    hung: float = 0.0  # [kg] along the upper tip edge, beyond its weight
    on_string: bool = False  # the hung mass follows vertical motion only
    fittings: float = 0.0  # [kg] there too, fixed to the beam
    mass_damping: float = 0.0  # a [1/s]
    stiffness_damping: float = 0.0  # b [s]
    branches: tuple[tuple[float, float], ...] = ()  # g, tau [s]


@dataclass(frozen=True, kw_only=True)
class Start:
    """How a take began: its support gave way from `latency` to `latency + rise`, and how far it had to fall."""

    latency: float = 0.0  # [s] after the frame that the data call the release
    rise: float = 1e-3  # [s] over which the support's force fell linearly to nothing
    reach: float = 1.0  # held minus settled pose, over the model's


@dataclass(frozen=True, kw_only=True, eq=False)
class Ritz:
    """Matrices on n shapes; q = 0 is the settled pose and `straight` the held one."""

    K: np.ndarray  # (n, n) [N/m]
    M: np.ndarray  # (n, n) [kg]
    added: np.ndarray  # (n, n) [-] mass matrix of 1 kg on the tip edge
    added_z: np.ndarray  # (n, n) [-] the same, in vertical motion only
    show: np.ndarray  # (M, 3, n): marker displacement of each shape
    edge: np.ndarray  # (3, n): mean displacement of the tip edge
    straight: np.ndarray  # (n,)
    settled: np.ndarray  # (N, 3) [m]

    @classmethod
    def about(cls, model: BeamModel, elastic: Elastic, settled: np.ndarray, ties: MarkerTies) -> "Ritz":
        """Shapes: the held pose itself, so that it is met exactly, the lowest modes, and what the tip edge does."""
        inner = np.flatnonzero(~np.repeat(model.fixed, 3))
        K = stiffness_of(model, elastic, settled, inner)
        mass = np.repeat(DENSITY * model.cloud.volume, 3)[inner]
        edge = edge_share(model)[:, None]
        each = [np.ravel(edge * axis)[inner] for axis in np.eye(3)]
        fall = np.ravel(model.cloud.x - settled)[inner]
        modes = eigsh(K, MODES, sp.diags(mass).tocsc(), sigma=0, v0=np.ones(len(mass)))[1]
        pushed = splu(K).solve(np.stack([each[2], each[0], sum(each) * fall], axis=1))
        columns = np.column_stack([fall, modes, pushed])
        root = np.sqrt(mass)[:, None]
        V = qr(root * columns / np.linalg.norm(root * columns, axis=0), mode="economic")[0] / root
        shapes = np.zeros((3 * model.cloud.count, V.shape[1]))
        shapes[inner] = V
        shapes = shapes.reshape(-1, 3, V.shape[1])
        show = np.stack([ties.positions(shapes[..., k]) for k in range(V.shape[1])], axis=-1)
        return cls(
            K=V.T @ (K @ V), M=V.T @ (mass[:, None] * V), added=V.T @ (sum(each)[:, None] * V),
            added_z=V.T @ (each[2][:, None] * V), show=show, edge=np.stack(each) @ V, straight=V.T @ (mass * fall),
            settled=settled,
        )  # fmt: skip

    def markers(self, physics: Physics, start: Start, time: np.ndarray) -> np.ndarray:
        """Marker displacements from their settled places (T, M, 3) [m]."""
        rates, amounts = self.free_motion(physics)
        return np.tensordot(released(rates, amounts, self.straight, start, time), self.show, axes=(1, 2))

    def memory(self, physics: Physics, start: Start, time: np.ndarray) -> np.ndarray:
        """How far each branch has crept from the held pose (0) to the settled one (1), by its tip's height, (B, T)."""
        rates, amounts = self.free_motion(physics)
        tip, plain = self.show[:, 2].mean(axis=0), Start(latency=start.latency, rise=start.rise)
        lags = [1 / (1 + rates * tau) for _, tau in physics.branches]
        z = [released(rates, amounts * lag, self.straight, plain, time) @ tip for lag in lags]
        return 1 - np.reshape(z, (len(lags), len(time))) / (tip @ self.straight)

    def edge_acceleration(self, physics: Physics, start: Start, time: np.ndarray) -> np.ndarray:
        """Of the tip edge, (T, 3) [m/s2], shapes that a step cannot follow left out."""
        rates, amounts = self.free_motion(physics)
        slow = np.abs(rates) < 1 / np.diff(time).mean()
        still, plain = np.zeros(len(self.straight)), Start(latency=start.latency, rise=start.rise)
        return released(rates[slow], amounts[:, slow] * rates[slow] ** 2, still, plain, time) @ self.edge.T

    def free_motion(self, physics: Physics) -> tuple[np.ndarray, np.ndarray]:
        """After a sudden release from the held pose: q(t) = Re sum_k amounts[:, k] exp(rates[k] t); (R,), (n, R)."""
        if not physics.inertia:
            rates, amounts = creep(physics)
            return rates, self.straight[:, None] * amounts
        n, count = len(self.K), len(physics.branches)
        M = self.M + physics.fittings * self.added
        M += physics.hung * (self.added_z if physics.on_string else self.added)
        K, eye = physics.modulus * self.K, np.eye(n)
        A = np.zeros(((2 + count) * n,) * 2)
        A[:n, n : 2 * n] = eye
        A[n : 2 * n, :n] = -(1 + sum(g for g, _ in physics.branches)) * K
        A[n : 2 * n, n : 2 * n] = -physics.mass_damping * M - physics.stiffness_damping * K
        for i, (g, tau) in enumerate(physics.branches):
            z = slice((2 + i) * n, (3 + i) * n)
            A[n : 2 * n, z], A[z, :n], A[z, z] = g * K, eye / tau, -eye / tau
        A[n : 2 * n] = np.linalg.solve(M, A[n : 2 * n])
        rates, vectors = np.linalg.eig(A)
        first = np.concatenate([self.straight, np.zeros(n), *[self.straight] * count])
        return rates, vectors[:n] * np.linalg.solve(vectors, first.astype(complex))

    def ring(self, physics: Physics) -> tuple[float, float]:
        """Frequency [Hz] and damping ratio of what swings furthest at the tip; zero and one where nothing swings."""
        rates, amounts = self.free_motion(physics)
        seen = np.abs(np.tensordot(self.show[:, 2].mean(axis=0), amounts, axes=1)) * (rates.imag > 1e-6)
        if not physics.inertia or not seen.any():
            return 0.0, 1.0
        rate = rates[int(seen.argmax())]
        return float(rate.imag / (2 * np.pi)), float(-rate.real / abs(rate))


def creep(physics: Physics) -> tuple[np.ndarray, np.ndarray]:
    """Without mass every shape follows one law: q(t) = q(0) sum_k amounts[k] exp(rates[k] t) after a sudden release.

    `b q' + q + sum_i g_i (q - z_i) = 0`; without b the first fall is instant, to g / (1 + g) of the way up.
    """
    b, g = physics.stiffness_damping, np.array([g for g, _ in physics.branches])
    tau = np.array([tau for _, tau in physics.branches])
    if b <= 0:
        if not len(g):
            return np.zeros(0, complex), np.zeros(0, complex)
        A, seen = (g / (1 + g.sum()) - np.eye(len(g))) / tau[:, None], g / (1 + g.sum())
    else:
        A = np.zeros((1 + len(g),) * 2)
        A[0, 0], A[0, 1:], A[1:, 0] = -(1 + g.sum()) / b, g / b, 1 / tau
        A[1:, 1:], seen = -np.diag(1 / tau), np.eye(1 + len(g))[0]
    rates, vectors = np.linalg.eig(A.astype(complex))
    return rates, (seen @ vectors) * np.linalg.solve(vectors, np.ones(len(A), complex))


def released(rates: np.ndarray, amounts: np.ndarray, held: np.ndarray, start: Start, time: np.ndarray) -> np.ndarray:
    """Motion (T, n) after a support that gives way linearly over `rise`: the mean over the moments of release."""
    rise = max(start.rise, 1e-6)
    past = np.maximum(time - start.latency, 0)[:, None]
    gone = np.minimum(past, rise)
    wave = (np.exp(past * rates) - np.exp((past - gone) * rates)) / (rates * rise)
    return start.reach * ((wave @ amounts.T).real + (1 - gone / rise) * held)


def edge_share(model: BeamModel) -> np.ndarray:
    """How a weight hung on the upper tip edge is shared by the points, (N,), sum one."""
    return (model.force(0.0) - model.force(1.0))[:, 2]


def beam_elastic(model: BeamModel, young: float, poisson: float) -> Elastic:
    """The beam's elasticity at a modulus [Pa]."""
    return Elastic.neo_hookean(model.cloud, Lame.from_young(young, poisson))


def stiffness_of(model: BeamModel, elastic: Elastic, y: np.ndarray, inner: np.ndarray) -> sp.csc_matrix:
    """d2E/dy2 at y (N, 3) among the coordinates `inner`, [N/m]."""
    tangent = Energy.of(elastic, [], model.fixed).tangent(y[None])
    whole = Layout.of(elastic).matrix(tangent.assembled(slice(0, 1))[0])
    return whole[inner][:, inner].tocsc()
