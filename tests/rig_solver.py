"""The rig's bodies in balance: finite elements from `fem`, driven by lines and a jet, one frame after another."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import fem
import numpy as np
from rig_mesh import fill
from rig_outlines import Soft
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import SuperLU, splu
from skfem import Basis, BilinearForm, ElementTetP2
from skfem.helpers import dot

from recon.rig.body import Body, edges_of

RESIDUAL = 1e-6  # of the internal and applied forces
FLOOR = 1e-7  # [N]
STEPS, HALVINGS = 150, 14
MANY = 30  # steps after which the stiffness is factorised again
LOOPS, STILL = 6, 1e-5  # the load follows the deformation until it moves the body by less than this [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """A body in scikit-fem's numbering and in the rig's."""

    fem: fem.FemBody
    body: Body
    order: np.ndarray  # (N,) scikit-fem's number of each node of `body`
    held: np.ndarray  # (N,) bool, taped to the ground, in the rig's order

    @classmethod
    def of(cls, soft: Soft, intorder: int) -> "Model":
        """Mesh the body and sample its material where the energy is integrated."""
        mesh = fill(soft)
        basis = Basis(mesh, ElementTetP2(), intorder=intorder)
        x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
        mu, nu = (f(x.reshape(-1, 3)).reshape(basis.dx.shape) for f in (soft.mu, soft.poisson))
        tets = basis.element_dofs[:4].T
        corners = np.unique(tets)
        tets = np.searchsorted(corners, tets)
        edges, index = edges_of(tets)
        middles = np.empty(len(edges), int)
        middles[index] = basis.element_dofs[4:].T
        order = np.concatenate([corners, middles])
        nodes = basis.doflocs.T[order]
        body, held = Body(nodes=nodes, tetrahedra=tets), nodes[:, 2] < soft.held
        fixed = np.zeros(basis.N, bool)
        fixed[order] = held
        gradients = np.stack([np.asarray(basis.basis[a][0].grad) for a in range(basis.Nbfun)])
        return cls(
            fem=fem.FemBody(
                mesh=mesh, basis=basis, gradients=np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)),
                weights=basis.dx, mu=mu, lam=2 * nu / (1 - 2 * nu) * mu,
                fixed=np.broadcast_to(fixed[:, None], (basis.N, 3)),
            ),
            body=body, order=order, held=held,
        )  # fmt: skip

    def mass(self, density: float) -> csr_matrix:
        """Consistent mass of one component, (N, N) [kg] in the rig's order."""
        matrix = BilinearForm(lambda u, v, w: density * dot(u[None], v[None])).assemble(self.fem.basis)
        return matrix[self.order][:, self.order]

    def stiffness(self) -> csr_matrix:
        """At rest, (3 N, 3 N) [N/m] in the rig's order."""
        dofs = (3 * self.order[:, None] + np.arange(3)).ravel()
        return fem.stiffness(self.fem, np.zeros_like(self.fem.nodes))[dofs][:, dofs]


@dataclass(eq=False)
class Solver:
    """Quasi-Newton steps (L-BFGS) on top of one factorised stiffness, renewed where they become many."""

    model: Model
    factor: SuperLU | None = None
    pairs: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)  # steps and changes of the force

    def balance(self, force: Callable[[np.ndarray], np.ndarray], u: np.ndarray) -> np.ndarray:
        """Displacement (N, 3) [m] under a load that depends on it, both in the rig's order, from a first guess."""
        order = self.model.order
        for _ in range(LOOPS):
            load, start = np.zeros_like(u), np.zeros_like(u)
            load[order], start[order] = force(u), u
            found = self._equilibrium(start, load)[order]
            change, u = np.abs(found - u).max(), found
            if change < STILL:
                break
        return u

    def internal(self, u: np.ndarray) -> np.ndarray:
        """Forces (N, 3) [N] that hold the body in the shape u, in the rig's order."""
        back = np.zeros_like(u)
        back[self.model.order] = u
        return fem.internal_force(self.model.fem, back)[self.model.order]

    def energy(self, u: np.ndarray) -> float:
        """Elastic energy [J] of the shape u (N, 3), in the rig's order."""
        back = np.zeros_like(u)
        back[self.model.order] = u
        return fem.energy(self.model.fem, back)

    def _equilibrium(self, u: np.ndarray, load: np.ndarray) -> np.ndarray:
        body = self.model.fem
        free = np.flatnonzero(~body.fixed.ravel())
        inner, potential = fem.internal_force(body, u), fem.energy(body, u) - (load * u).sum()
        residual = (inner - load).ravel()[free]
        self.pairs.clear()
        for count in range(STEPS):
            if np.linalg.norm(residual) <= FLOOR + RESIDUAL * (np.linalg.norm(inner) + np.linalg.norm(load)):
                return u
            if self.factor is None or count % MANY == MANY - 1:
                self._renew(fem.stiffness(body, u)[free][:, free])
            step = np.zeros(u.size)
            step[free] = -self._solved(residual)
            u, potential, size = self._searched(u, step.reshape(u.shape), load, potential, float(residual @ step[free]))
            inner = fem.internal_force(body, u)
            change = (inner - load).ravel()[free] - residual
            residual = residual + change
            if change @ step[free] > 0:
                self.pairs.append((size * step[free], change))
        raise RuntimeError(f"a residual of {np.linalg.norm(residual):.3g} N is left")

    def _renew(self, K: csr_matrix) -> None:
        options = {"SymmetricMode": True}
        self.factor = splu(K.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        self.pairs.clear()

    def _solved(self, right: np.ndarray) -> np.ndarray:
        """The two loops of L-BFGS around the factorisation (Nocedal and Wright 2006, algorithm 7.4)."""
        shares = []
        for step, change in reversed(self.pairs):
            shares.append(step @ right / (change @ step))
            right = right - shares[-1] * change
        out = self.factor.solve(right)
        for (step, change), share in zip(self.pairs, reversed(shares), strict=True):
            out = out + (share - change @ out / (change @ step)) * step
        return out

    def _searched(
        self, u: np.ndarray, step: np.ndarray, load: np.ndarray, before: float, slope: float
    ) -> tuple[np.ndarray, float, float]:
        """The step, halved until no element is crushed and the potential energy does not grow."""
        slack = 1e-10 * (abs(before) + np.abs(load * u).sum()) + 1e-13
        for halving in range(HALVINGS):
            size = 0.5**halving
            trial = u + size * step
            after = fem.energy(self.model.fem, trial) - (load * trial).sum()
            if after <= before + 1e-4 * size * slope + slack:
                return trial, after, size
        raise RuntimeError("no step lowers the energy")


def march(solver: Solver, loads: list[Callable[[np.ndarray], np.ndarray]]) -> Iterator[np.ndarray]:
    """Displacements (N, 3) [m] frame after frame, each from the one before."""
    u = before = np.zeros_like(solver.model.body.nodes)
    for load in loads:
        guess = 2 * u - before
        try:
            before, u = u, solver.balance(load, guess)
        except RuntimeError:
            solver.factor = None
            before, u = u, solver.balance(load, u)
        yield u
