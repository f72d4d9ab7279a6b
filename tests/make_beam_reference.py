"""Reference for the silicone beam that does not lock: `python tests/make_beam_reference.py [nodes along]`.

Mixed finite elements of felupe (`pip install felupe`): quadratic hexahedra for the displacement, discontinuous linear
pressure and dilatation. The tests hold its numbers, so that felupe is not needed to run them.
"""

import sys

import felupe
import numpy as np

YOUNG, DENSITY, GRAVITY, WEIGHT = 263_824.0, 1070.0, 9.807, 0.51012  # [Pa], [kg/m3], [m/s2], [N]


def settled_tip(poisson: float, weight: float, nodes: tuple[int, int, int]) -> np.ndarray:
    """Displacement (3,) [m] of the middle of the free end under gravity and a weight [N] along the upper tip edge."""
    mu, lam = YOUNG / (2 * (1 + poisson)), YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson))
    mesh = felupe.Cube(a=(-0.1, 0, 0), b=(0, 0.03, 0.03), n=nodes)
    mesh = mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    field = felupe.FieldsMixed(felupe.RegionTriQuadraticHexahedron(mesh), n=3)
    law = felupe.ThreeFieldVariation(felupe.NeoHookeCompressible(mu=mu, lmbda=lam))
    items = [felupe.SolidBody(law, field), felupe.SolidBodyForce(field, values=[0, 0, -DENSITY * GRAVITY])]
    if weight:
        items.append(edge_load(field, mesh.points, weight, nodes[1] - 1))
    clamp = {"clamp": felupe.Boundary(field[0], fx=-0.1)}
    free, held = felupe.dof.partition(field, clamp)[::-1]
    felupe.newtonraphson(items=items, dof0=held, dof1=free, verbose=0, tol=1e-6)
    tip = np.linalg.norm(mesh.points - [0, 0.015, 0.015], axis=1).argmin()
    return field[0].values[tip]


def edge_load(field: felupe.FieldsMixed, points: np.ndarray, weight: float, cells: int) -> felupe.PointLoad:
    """The weight [N] spread evenly along the upper tip edge: Simpson's weights on each quadratic cell."""
    edge = np.flatnonzero((points[:, 0] > -1e-9) & (points[:, 2] > 0.03 - 1e-9))
    share = np.zeros(2 * cells + 1)
    for cell in range(cells):
        share[2 * cell : 2 * cell + 3] += np.array([1, 4, 1]) / (6 * cells)
    values = np.zeros((len(edge), 3))
    values[:, 2] = -weight * share
    return felupe.PointLoad(field, edge[np.argsort(points[edge, 1])], values=values)


def main() -> None:
    """Print the tip's displacement for each Poisson's ratio and load."""
    along = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    across = 2 * round((along - 1) * 0.3 / 2 * 1.2) + 2  # an odd number of cells, so that a midpoint is the centre
    for poisson in (0.3, 0.45, 0.49, 0.499):
        for weight in (0.0, WEIGHT):
            u = 1e3 * settled_tip(poisson, weight, (along, across, across))
            nodes = f"{along} x {across} x {across} nodes"
            print(f"nu {poisson}, weight {weight} N, {nodes}: u = {u.round(4)} mm", flush=True)


if __name__ == "__main__":
    main()
