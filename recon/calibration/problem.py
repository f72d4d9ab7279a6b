"""Bundle adjustment's unknowns, and the weighted squares that it makes small."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import SuperLU, splu

from recon.calibration.bodies import huber
from recon.calibration.sightings import LENS, Sightings, projected, residuals
from recon.rigid import rigid

_CLOSE = 1e-7  # smallest relative gain of a step that is worth another
_DAMPING = (1e-4, 1e-12, 1e10)  # at first, least, most
_UP, _DOWN = 8.0, 0.2  # of the damping after a bad and a good step


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """Everything that may move."""

    lens: np.ndarray  # (C, 18)
    T_camera: np.ndarray  # (C, 4, 4)
    T_body: np.ndarray  # (B, 4, 4)

    def stepped(self, step: np.ndarray) -> "State":
        """After a step: 6 of each camera, 18 of each lens, 6 of each body, as `projected` orders them."""
        count, bodies = len(self.lens), len(self.T_body)
        cut = np.cumsum([6 * count, LENS * count])
        camera, lens, body = (
            p.reshape(n, -1) for p, n in zip(np.split(step, cut), (count, count, bodies), strict=True)
        )
        T_camera, T_body = self.T_camera.copy(), self.T_body.copy()
        centre = -np.einsum("cji,cj->ci", T_camera[:, :3, :3], T_camera[:, :3, 3]) + camera[:, 3:]
        T_camera[:, :3, :3] = _turns(camera) @ T_camera[:, :3, :3]
        T_camera[:, :3, 3] = -np.einsum("cij,cj->ci", T_camera[:, :3, :3], centre)
        T_body[:, :3, :3] = _turns(body) @ T_body[:, :3, :3]
        T_body[:, :3, 3] += body[:, 3:]
        return State(lens=self.lens + lens.reshape(count, LENS), T_camera=T_camera, T_body=T_body)


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """The weighted squares to make small: pixels over their noise, and lenses over what is known of them."""

    sightings: Sightings
    free: np.ndarray  # columns of all unknowns that may change
    usual: np.ndarray  # (C, 18), lenses as they usually are
    weight: np.ndarray  # (C, 18), inverse variance of that
    noise: float  # [px]
    loose: float  # [px]

    def cost(self, state: State) -> float:
        """`sum rho(|r|) / noise^2 + sum ((lens - usual) / spread)^2`."""
        left = residuals(state.lens, state.T_camera, state.T_body, self.sightings)
        lens = self.weight * (state.lens - self.usual) ** 2
        return float(huber(left, self.loose)[0].sum() / self.noise**2 + lens.sum())

    def normal(self, state: State) -> tuple[csc_matrix, np.ndarray]:
        """`J^T W J` and `J^T W r` over the free columns."""
        seen = projected(state.lens, state.T_camera, state.T_body, self.sightings)
        left = seen.pixel - self.sightings.pixel
        root = np.sqrt(huber(left, self.loose)[1])[:, None] / self.noise
        J = self._sparse(np.concatenate([seen.by_camera, seen.by_lens, seen.by_body], axis=2) * root[..., None], state)
        lens, full = np.zeros((2, J.shape[1]))
        place = slice(6 * len(state.lens), (6 + LENS) * len(state.lens))
        lens[place], full[place] = self.weight.ravel(), (self.weight * (state.lens - self.usual)).ravel()
        J = J[:, self.free]
        return (J.T @ J + diags(lens[self.free])).tocsc(), J.T @ (left * root).ravel() + full[self.free]

    def _sparse(self, slopes: np.ndarray, state: State) -> csr_matrix:
        cameras, bodies = len(state.lens), len(state.T_body)
        c, b = self.sightings.camera[:, None], self.sightings.body[:, None]
        starts = (6 * c + np.arange(6), 6 * cameras + LENS * c + np.arange(LENS))
        columns = np.concatenate([*starts, (6 + LENS) * cameras + 6 * b + np.arange(6)], axis=1)
        width, rows = columns.shape[1], 2 * len(columns)
        shape = (rows, (6 + LENS) * cameras + 6 * bodies)
        return csr_matrix((slopes.ravel(), np.repeat(columns, 2, axis=0).ravel(), np.arange(rows + 1) * width), shape)

    def whole(self, state: State, step: np.ndarray) -> np.ndarray:
        """A step of the free unknowns as one of all."""
        every = np.zeros((6 + LENS) * len(state.lens) + 6 * len(state.T_body))
        every[self.free] = step
        return every


def least(problem: Problem, state: State, iterations: int) -> State:
    """Levenberg and Marquardt's steps to the least cost."""
    damping, cost = _DAMPING[0], problem.cost(state)
    A, slope = problem.normal(state)
    for _ in range(iterations):
        step = factor(A + damping * diags(A.diagonal())).solve(-slope)
        tried = state.stepped(problem.whole(state, step))
        found = problem.cost(tried)
        if not found < cost:
            damping *= _UP
            if damping > _DAMPING[2]:
                break
            continue
        gain, state, cost, damping = cost - found, tried, found, max(_DOWN * damping, _DAMPING[1])
        if gain <= _CLOSE * cost:
            break
        A, slope = problem.normal(state)
    return state


def factor(A: csc_matrix) -> SuperLU:
    """The factors of a normal matrix; raises ValueError where the pictures leave an unknown quite open."""
    try:
        return splu(A.tocsc())
    except RuntimeError:
        raise ValueError("the pictures must fix every camera and board; got a singular normal matrix") from None


def _turns(step: np.ndarray) -> np.ndarray:
    return rigid(step[:, :3], np.zeros((len(step), 3)))[:, :3, :3]
