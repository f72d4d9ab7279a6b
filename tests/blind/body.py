"""A soft body of quadratic hexahedra as plain arrays: where it is integrated, loaded, held and seen.

Nodes are the 27 Lagrange points of each hexahedron; E cells, Q points of integration in each, N nodes.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import fem
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from skfem import Basis, ElementHex2, FacetBasis, MeshHex


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Discretised geometry; `Body.of` builds it, `split` cracks it."""

    nodes: np.ndarray  # (N, 3) [m] rest positions
    elements: np.ndarray  # (E, 27) node numbers
    gradients: np.ndarray  # (E, Q, 27, 3) [1/m]
    weights: np.ndarray  # (E, Q) [m3]
    facet_cell: np.ndarray  # (B,) the cell behind each outer facet
    facet_values: np.ndarray  # (B, q, 27) shape functions on it
    facet_gradients: np.ndarray  # (B, q, 27, 3) [1/m]
    facet_area: np.ndarray  # (B, q, 3) [m2] outward area vectors of the points of integration
    fixed: np.ndarray  # (N,) bool
    seen_cell: np.ndarray  # (M,) the cell in which each observed point lies
    seen_values: np.ndarray  # (M, 27) shape functions there

    @classmethod
    def of(cls, mesh: MeshHex, fixed: np.ndarray, seen_cell: np.ndarray, seen_values: np.ndarray) -> "Body":
        """Quadratic shape functions on a mesh of trilinear cells; fixed: (vertices,) bool, a facet needs all four."""
        basis, facets = Basis(mesh, ElementHex2(), intorder=4), FacetBasis(mesh, ElementHex2(), intorder=4)
        held = np.flatnonzero(fixed[mesh.facets].all(axis=0) & (mesh.f2t[1] == -1))
        nodes = np.zeros(basis.N, bool)
        nodes[basis.get_dofs(facets=held).all()] = True
        normals = np.moveaxis(np.asarray(facets.normals), 0, -1)
        return cls(
            nodes=basis.doflocs.T.copy(),
            elements=basis.element_dofs.T.copy(),
            gradients=np.stack([np.asarray(b[0].grad) for b in basis.basis]).transpose(2, 3, 0, 1).copy(),
            weights=basis.dx,
            facet_cell=facets.tind,
            facet_values=np.stack([np.asarray(b[0]) for b in facets.basis]).transpose(1, 2, 0).copy(),
            facet_gradients=np.stack([np.asarray(b[0].grad) for b in facets.basis]).transpose(2, 3, 0, 1).copy(),
            facet_area=normals * facets.dx[..., None],
            fixed=nodes,
            seen_cell=seen_cell,
            seen_values=seen_values,
        )

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def hangs_together(self) -> bool:
        """Whether its cells are one piece, across whole facets of nine nodes."""
        rows, columns = np.repeat(np.arange(len(self.elements)), 27), self.elements.ravel()
        of_cell = csr_matrix((np.ones(len(rows), int), (rows, columns)))  # which nodes a cell has
        return connected_components(of_cell @ of_cell.T >= 9, directed=False)[0] == 1

    @cached_property
    def points(self) -> np.ndarray:
        """Rest positions of the points of integration, (E, Q, 3) [m]."""
        return _shape_values() @ self.nodes[self.elements]

    @cached_property
    def seen(self) -> csr_matrix:
        """Nodal values to values at the observed points, (M, N)."""
        rows = np.repeat(np.arange(len(self.seen_cell)), 27)
        columns = self.elements[self.seen_cell].ravel()
        return csr_matrix((self.seen_values.ravel(), (rows, columns)), shape=(len(self.seen_cell), self.count))

    @cached_property
    def facet_nodes(self) -> np.ndarray:
        """Node numbers behind each outer facet, (B, 27)."""
        return self.elements[self.facet_cell]

    @cached_property
    def spread(self) -> csr_matrix:
        """Forces at the facets' points of integration to nodal forces, (N, B q): consistent, sum kept."""
        facets, points, _ = self.facet_values.shape
        rows = np.repeat(self.facet_nodes[:, None], points, axis=1).ravel()
        columns = np.repeat(np.arange(facets * points), 27)
        return csr_matrix((self.facet_values.ravel(), (rows, columns)), shape=(self.count, facets * points))

    @cached_property
    def volume(self) -> np.ndarray:
        """Nodal volumes (N,) [m3]; positive, since those of this element are."""
        return nodal(self, self.weights @ _shape_values())

    @cached_property
    def surface(self) -> np.ndarray:
        """Nodal shares of the outer area, (N,) [m2]; zero inside."""
        return np.asarray(self.spread @ np.linalg.norm(self.facet_area, axis=-1).ravel())

    def F(self, u: np.ndarray) -> np.ndarray:
        """Deformation gradients I + sum_a u_a (x) grad N_a of u (N, 3), (E, Q, 3, 3)."""
        return np.eye(3) + u[self.elements].transpose(0, 2, 1)[:, None] @ self.gradients

    def facet_F(self, u: np.ndarray) -> np.ndarray:
        """The same on the outer facets, (B, q, 3, 3)."""
        return np.eye(3) + u[self.facet_nodes].transpose(0, 2, 1)[:, None] @ self.facet_gradients

    def facet_geometry(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and outward area vectors `cof(F) A` of the facets' points displaced by u, both (B q, 3)."""
        x = self.facet_values @ (self.nodes + u)[self.facet_nodes]
        return x.reshape(-1, 3), (cofactor(self.facet_F(u)) @ self.facet_area[..., None]).reshape(-1, 3)


def nodal(body: Body, local: np.ndarray) -> np.ndarray:
    """Sum of cell-wise nodal values (E, 27, ...) over the nodes, (N, ...)."""
    flat = local.reshape(local.shape[0] * 27, -1)
    columns = [np.bincount(body.elements.ravel(), flat[:, i], minlength=body.count) for i in range(flat.shape[1])]
    return np.stack(columns, axis=1).reshape(body.count, *local.shape[2:])


def cofactor(F: np.ndarray) -> np.ndarray:
    """`cof F = J F^-T`, (..., 3, 3)."""
    return np.linalg.det(F)[..., None, None] * np.linalg.inv(F).swapaxes(-1, -2)


def split(body: Body, inside: np.ndarray, above: np.ndarray) -> Body:
    """A crack: the nodes `inside` (N,) bool become two, of which the cells `above` (E,) bool take the new ones.

    Nodes with cells on one side only stay as they are.
    """
    number = np.arange(body.count)
    inside = inside & np.isin(number, body.elements[above]) & np.isin(number, body.elements[~above])
    number[inside] = body.count + np.arange(inside.sum())
    elements = np.where(above[:, None], number[body.elements], body.elements)
    return replace(
        body,
        nodes=np.concatenate([body.nodes, body.nodes[inside]]),
        elements=elements,
        fixed=np.concatenate([body.fixed, body.fixed[inside]]),
    )


@cache
def _shape_values() -> np.ndarray:
    """Shape functions at the points of integration, (Q, 27), the same in every cell."""
    cell = Basis(fem.box_mesh((0, 0, 0), (1, 1, 1), (1, 1, 1)), ElementHex2(), intorder=4)
    return np.stack([np.asarray(b[0])[0] for b in cell.basis], axis=1)
