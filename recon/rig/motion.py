"""The stored motions: what finite elements computed for each shape (tests/make_rig_motions.py), to be replayed."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.rig.body import Body, edges_of
from sim.checks import require

STORE = Path(__file__).parent / "motions.npz"
SHAPES = ("plush", "dinosaur", "pillow", "leaf")
KNOT = 0.012  # [m], a line holds the skin this far around its knot
FINE = 2e-6  # [m], the unit of the stored nodes; each shape's modes have their own, as fine as its stress needs
PLAIN = ("course", "mass", "stiffness", "position", "direction", "anchors", "tension", "reaction")
NUMBERS = ("force", "footprint", "density")


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A body driven by an air stream and two lines, quasi-statically, frame 0 at rest; z up, the front towards -y.

    The displacement of frame t is `sum_r course[t, r] modes[r]`. It balances the stream on the deformed skin
    (`recon.rig.jet`) and the lines, each of which pulls its knot's nodes towards its anchor; gravity is left out.
    """

    body: Body
    held: np.ndarray  # (N,) bool, taped to the ground
    mu: np.ndarray  # (N,) [Pa]
    lam: np.ndarray  # (N,) [Pa]
    modes: np.ndarray  # (R, N, 3) [m]
    course: np.ndarray  # (T, R)
    mass: np.ndarray  # (R, R) [kg m2], of the modes
    stiffness: np.ndarray  # (R, R) [N m], of the modes, at rest: diagonal, for the modes are orthogonal in it
    position: np.ndarray  # (T, 3) [m] of the nozzle
    direction: np.ndarray  # (T, 3)
    force: float  # [N] of the stream on a flat wall
    footprint: float  # [m]
    knots: tuple[np.ndarray, ...]  # nodes that each line holds
    anchors: np.ndarray  # (L, 3) [m]
    tension: np.ndarray  # (T, L) [N]
    reaction: np.ndarray  # (T, 3) [N], what the ground adds, as the finite elements found it
    density: float  # [kg/m3]

    @property
    def frames(self) -> int:
        """Stored frames."""
        return len(self.course)


def load_motion(shape: str) -> Motion:
    """The stored motion of one of SHAPES; raises ValueError for another name."""
    require(shape in SHAPES, "shape", f"be one of {', '.join(SHAPES)}", shape)
    return unpack(shape, stored(STORE, shape))


def stored(path: Path, shape: str = "") -> dict[str, np.ndarray]:
    """The arrays of the file, of one shape or of all."""
    with np.load(path, allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files if key.startswith(shape)}


def pack(shape: str, motion: Motion, fine: float) -> dict[str, np.ndarray]:
    """A motion as small arrays: whole numbers, those of the modes of `fine` [m], middles of edges less their ends'."""
    edges, _ = edges_of(motion.body.tetrahedra)
    material = np.log(np.stack([motion.mu, motion.lam], axis=1))
    out = {
        "nodes": _split(coded(motion.body.nodes, edges, FINE)),
        "modes": _split(coded(_flat(motion.modes), edges, fine).T),
        "fine": np.array(fine),
        "material": coded(material, edges, 1e-3).astype(np.int16),
        "tetrahedra": motion.body.tetrahedra.astype(np.uint16),
        "held": np.packbits(motion.held),
        "numbers": np.array([getattr(motion, name) for name in NUMBERS]),
    }
    out |= {name: getattr(motion, name) for name in PLAIN}
    out |= {name: getattr(motion, name).astype(np.float32) for name in ("course", "mass")}
    out["stiffness"] = np.diag(motion.stiffness)
    out |= {f"knot{i}": knot.astype(np.uint16) for i, knot in enumerate(motion.knots)}
    return {f"{shape}/{name}": value for name, value in out.items()}


def unpack(shape: str, arrays: Mapping[str, np.ndarray]) -> Motion:
    """The motion that `pack` stored."""
    part = {key.split("/")[1]: value for key, value in arrays.items() if key.startswith(f"{shape}/")}
    tetrahedra = part["tetrahedra"].astype(np.int64)
    edges, _ = edges_of(tetrahedra)
    nodes = decoded(_joined(part["nodes"]), edges, FINE)
    modes = decoded(_joined(part["modes"]).T, edges, float(part["fine"])).reshape(len(nodes), -1, 3)
    mu, lam = np.exp(decoded(part["material"], edges, 1e-3)).T
    knots = tuple(part[f"knot{i}"].astype(np.int64) for i in range(len(part["anchors"])))
    plain = {name: part[name].astype(float) for name in PLAIN}
    plain["stiffness"] = np.diag(plain["stiffness"])
    return Motion(
        body=Body(nodes=nodes, tetrahedra=tetrahedra),
        held=np.unpackbits(part["held"], count=len(nodes)).astype(bool),
        mu=mu, lam=lam, modes=np.ascontiguousarray(np.moveaxis(modes, 1, 0)), knots=knots,
        **dict(zip(NUMBERS, part["numbers"].tolist(), strict=True)), **plain,
    )  # fmt: skip


def coded(values: np.ndarray, edges: np.ndarray, unit: float) -> np.ndarray:
    """Whole numbers (N, C) int32 of the unit; what an edge's middle has beyond the mean of its ends is small."""
    whole = np.round(values / unit).astype(np.int64)
    corners = len(whole) - len(edges)
    whole[corners:] -= whole[edges].sum(axis=1) // 2
    whole[1:corners] -= whole[: corners - 1].copy()
    require(bool(np.abs(whole).max() < 2**30), "motion", "fit into 31 bits", np.abs(whole).max())
    return whole.astype(np.int32)


def decoded(whole: np.ndarray, edges: np.ndarray, unit: float) -> np.ndarray:
    """The values (N, C) that `coded` was given, to half a unit."""
    whole = whole.astype(np.int64)
    corners = len(whole) - len(edges)
    whole[:corners] = np.cumsum(whole[:corners], axis=0)
    whole[corners:] += whole[edges].sum(axis=1) // 2
    return unit * whole


def _flat(modes: np.ndarray) -> np.ndarray:
    """Modes (R, N, 3) as (N, 3 R)."""
    return np.moveaxis(modes, 0, 1).reshape(modes.shape[1], -1)


def _split(whole: np.ndarray) -> np.ndarray:
    """Bytes (4, ...) of whole numbers (...), the sign in the lowest bit: the high bytes are nearly all alike."""
    folded = ((whole << 1) ^ (whole >> 31)).astype(np.uint32)
    return np.stack([(folded >> shift & 255).astype(np.uint8) for shift in (0, 8, 16, 24)])


def _joined(parts: np.ndarray) -> np.ndarray:
    folded = sum(part.astype(np.int64) << shift for part, shift in zip(parts, (0, 8, 16, 24), strict=True))
    return (folded >> 1) ^ -(folded & 1)
