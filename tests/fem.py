"""Independent oracle: quasi-static Neo-Hookean finite elements on scikit-fem's quadratic hexahedra.

psi = mu/2 (I_c - 3) - mu log J + lam/2 (J - 1)^2. Nothing here imports the simulator under test.
Nodes are the 27 Lagrange points of each hexahedron; nodal arrays are (N, 3).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex1, ElementHex2, FacetBasis, LinearForm, MeshHex

Field = Callable[[np.ndarray], np.ndarray]  # positions (M, 3) [m] -> values (M,)
Traction = Callable[[np.ndarray, np.ndarray], np.ndarray]  # positions (M, 3), outward normals (M, 3) -> (M, 3) [Pa]

J_FLOOR = 0.05  # a line search step may not compress a quadrature point below this share of its volume
RESIDUAL = 1e-10  # force left over, relative to the internal and applied forces
NEWTON_STEPS = 40
HALVINGS = 25


@dataclass(frozen=True, kw_only=True, eq=False)
class FemBody:
    """A discretised soft body with its material sampled at the quadrature points; build it with `FemBody.build`."""

    mesh: MeshHex
    basis: Basis  # scalar quadratic basis: one degree of freedom per node
    gradients: np.ndarray  # (E, Q, 27, 3) [1/m] shape function gradients
    weights: np.ndarray  # (E, Q) [m3]
    mu: np.ndarray  # (E, Q) [Pa]
    lam: np.ndarray  # (E, Q) [Pa]
    fixed: np.ndarray  # (N, 3) bool, components held at the start's value

    @classmethod
    def build(cls, mesh: MeshHex, mu: Field, lam: Field, fixed: Field) -> "FemBody":
        """Sample mu, lam [Pa] where the energy is integrated; `fixed` maps (N, 3) to (N,) or (N, 3) bool."""
        basis = Basis(mesh, ElementHex2(), intorder=4)
        x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
        held = np.asarray(fixed(basis.doflocs.T))
        gradients = np.stack([np.asarray(basis.basis[a][0].grad) for a in range(basis.Nbfun)])
        return cls(
            mesh=mesh,
            basis=basis,
            gradients=np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)),
            weights=basis.dx,
            mu=mu(x.reshape(-1, 3)).reshape(basis.dx.shape),
            lam=lam(x.reshape(-1, 3)).reshape(basis.dx.shape),
            fixed=np.broadcast_to(held[:, None] if held.ndim == 1 else held, (basis.N, 3)),
        )

    @property
    def nodes(self) -> np.ndarray:
        """Rest positions (N, 3) [m]."""
        return self.basis.doflocs.T

    @property
    def elements(self) -> np.ndarray:
        """Node numbers of each hexahedron, (E, 27)."""
        return self.basis.element_dofs.T

    @property
    def surface(self) -> np.ndarray:
        """Which nodes lie on the boundary, (N,) bool."""
        outer = np.zeros(self.basis.N, bool)
        outer[self.basis.get_dofs().all()] = True
        return outer


def box_mesh(lower: tuple, upper: tuple, cells: tuple) -> MeshHex:
    """A regular grid of `cells` hexahedra between two corners [m]."""
    return MeshHex.init_tensor(*(np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, cells, strict=True)))


def deformation_gradient(body: FemBody, u: np.ndarray) -> np.ndarray:
    """F = I + sum_a u_a (x) grad N_a at the quadrature points, (E, Q, 3, 3)."""
    local = u[body.elements].transpose(0, 2, 1)[:, None]
    return np.eye(3) + local @ body.gradients


def energy(body: FemBody, u: np.ndarray) -> float:
    """Elastic energy [J] of the displacement u (N, 3); infinite where the body is turned inside out."""
    F = deformation_gradient(body, u)
    J = np.linalg.det(F)
    if J.min() <= 0:
        return np.inf
    psi = body.mu / 2 * ((F * F).sum((-1, -2)) - 3) - body.mu * np.log(J) + body.lam / 2 * (J - 1) ** 2
    return float((body.weights * psi).sum())


def internal_force(body: FemBody, u: np.ndarray) -> np.ndarray:
    """Derivative of the energy, (N, 3) [N], from P = mu (F - F^-T) + lam (J - 1) J F^-T."""
    F = deformation_gradient(body, u)
    J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
    P = body.mu[..., None, None] * (F - H) + (body.lam * (J - 1) * J)[..., None, None] * H
    local = np.einsum("eqij,eqaj,eq->eai", P, body.gradients, body.weights, optimize=True)
    force = np.zeros_like(u)
    np.add.at(force, body.elements, local)
    return force


def stiffness(body: FemBody, u: np.ndarray) -> csr_matrix:
    """Second derivative of the energy, sparse (3N, 3N) [N/m]."""
    F = deformation_gradient(body, u)
    J, H = np.linalg.det(F), np.linalg.inv(F).swapaxes(-1, -2)
    twist = body.weights * (body.mu - body.lam * (J - 1) * J)
    bulk = body.weights * body.lam * (2 * J - 1) * J
    A = np.einsum("eq,eqil,eqkj->eqijkl", twist, H, H) + np.einsum("eq,eqij,eqkl->eqijkl", bulk, H, H)
    A += np.einsum("eq,ik,jl->eqijkl", body.weights * body.mu, np.eye(3), np.eye(3))
    cells, points, shapes = body.gradients.shape[:3]
    G = body.gradients.transpose(0, 2, 1, 3).reshape(cells, shapes, points * 3)
    AG = np.einsum("eqijkl,eqbl->eiqjbk", A, body.gradients, optimize=True)
    K = G[:, None] @ AG.reshape(cells, 3, points * 3, shapes * 3)
    dofs = (3 * body.elements[..., None] + np.arange(3)).reshape(cells, -1)
    block = K.transpose(0, 2, 1, 3).reshape(cells, shapes * 3, shapes * 3)
    rows, columns = np.broadcast_to(dofs[:, :, None], block.shape), np.broadcast_to(dofs[:, None], block.shape)
    return csr_matrix((block.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * body.basis.N,) * 2)


def solve(
    body: FemBody,
    *,
    nodal_force: np.ndarray | None = None,
    body_force: tuple | None = None,
    steps: int = 1,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Static equilibrium under forces (N, 3) [N] and a force density (3,) [N/m3]; displacement (N, 3) [m].

    The load grows in `steps` equal parts; held components keep their value in `start`.
    Raises RuntimeError when Newton's method does not converge.
    """
    force = np.zeros((body.basis.N, 3)) if nodal_force is None else np.asarray(nodal_force, float)
    if body_force is not None:
        force = force + volumes(body.basis)[:, None] * np.asarray(body_force, float)
    u = np.zeros_like(force) if start is None else np.array(start, float)
    for share in np.arange(1, steps + 1) / steps:
        u = _newton(body, u, share * force)
    return u


def _newton(body: FemBody, u: np.ndarray, force: np.ndarray) -> np.ndarray:
    free, floor = np.flatnonzero(~body.fixed.ravel()), _rounding_of_force(body)
    for _ in range(NEWTON_STEPS):
        inner = internal_force(body, u)
        residual = (inner - force).ravel()[free]
        if np.linalg.norm(residual) <= floor + RESIDUAL * (np.linalg.norm(inner) + np.linalg.norm(force)):
            return u
        step = np.zeros(u.size)
        step[free] = -_solve_symmetric(stiffness(body, u)[free][:, free], residual)
        u = _line_search(body, u, step.reshape(u.shape), force, residual @ step[free])
    raise RuntimeError(f"finite-element Newton left a residual of {np.linalg.norm(residual):.3g} N")


def _rounding_of_force(body: FemBody) -> float:
    """Norm [N] of what is left of nodal forces that cancel, stresses being sums of terms as large as mu + lam."""
    stress = body.weights * (body.mu + body.lam)
    share = np.linalg.norm(np.einsum("eq,eqai->eai", stress, np.abs(body.gradients)))
    return 4 * np.finfo(float).eps * float(share)


def _solve_symmetric(matrix: csr_matrix, right: np.ndarray) -> np.ndarray:
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve(right)


def _line_search(body: FemBody, u: np.ndarray, step: np.ndarray, force: np.ndarray, slope: float) -> np.ndarray:
    """Halve the step until no quadrature point is crushed and the potential energy does not grow."""
    before = energy(body, u) - (force * u).sum()
    sums = (body.weights * (body.mu + body.lam)).sum() * np.finfo(float).eps
    rounding = 10 * sums + 1e-11 * (abs(before) + np.abs(force * u).sum())
    for halving in range(HALVINGS):
        size = 0.5**halving
        trial = u + size * step
        upright = np.linalg.det(deformation_gradient(body, trial)).min() > J_FLOOR
        if upright and energy(body, trial) - (force * trial).sum() <= before + 1e-4 * size * slope + rounding:
            return trial
    raise RuntimeError("finite-element line search found no step that keeps J > 0 and lowers the energy")


def displacement_at(body: FemBody, u: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The finite-element field at rest positions (M, 3) [m] inside the body, (M, 3) [m]."""
    centre = (body.nodes.max(0) + body.nodes.min(0)) / 2
    # A hair towards the centre, so that rounding leaves no boundary point outside every element.
    inside = centre + (np.asarray(points, float) - centre) * (1 - 1e-9)
    return np.asarray(body.basis.probes(inside.T) @ u)


def surface_load(basis: Basis, traction: Traction) -> np.ndarray:
    """Nodal forces integral N_a t dA of a traction t(x, n) over the boundary, (nodes of `basis`, 3) [N].

    With `body.basis` it is the load to solve for; with `hats(mesh)` the same load shared among the vertices.
    """
    facets = FacetBasis(basis.mesh, basis.elem, intorder=6)
    x = np.asarray(facets.global_coordinates())
    t = traction(x.reshape(3, -1).T, np.asarray(facets.normals).reshape(3, -1).T)
    form = LinearForm(lambda v, w: w.t * v)
    return np.stack([form.assemble(facets, t=t[:, i].reshape(x.shape[1:])) for i in range(3)], axis=1)


def volumes(basis: Basis) -> np.ndarray:
    """Nodal volumes integral N_a dV, (nodes of `basis`,) [m3]; they sum to the body's volume."""
    return LinearForm(lambda v, w: v).assemble(basis)


def hats(mesh: MeshHex) -> Basis:
    """Trilinear basis at the vertices of `mesh`, for lumping; `mesh.refined()` has a vertex at each node of a body."""
    return Basis(mesh, ElementHex1(), intorder=4)


def area_vectors(basis: Basis) -> np.ndarray:
    """Outward nodal area vectors A_i n_i, (nodes of `basis`, 3) [m2]; zero inside."""
    return surface_load(basis, lambda x, n: n)
