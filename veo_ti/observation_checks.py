"""What a sound measurement must satisfy beyond shapes, each failure one sentence."""

import numpy as np
from scipy.spatial import cKDTree

from sim.checks import require, some

LARGEST = 10.0  # [m]; anything larger is a unit mistake


def check_motion(points: np.ndarray, time: np.ndarray) -> None:
    """points (T, N, 3) [m] and time (T,) [s] must be a sequence of distinct points of plausible size.

    Raises ValueError for fewer than 2 frames, time that does not increase, lengths in millimetres, duplicate points.
    """
    require(len(points) >= 2, "points", "hold at least 2 frames: the reference pose and a loaded one", len(points))
    late = np.flatnonzero(np.diff(time) <= 0) + 1
    require(len(late) == 0, "time", "increase from frame to frame", f"no increase at frame {some(late)}")
    size = float(np.ptp(points[0], axis=0).max())
    rule = f"be in metres and span less than {LARGEST:g} m"
    require(size <= LARGEST, "points", rule, f"an object {size:.3g} m across, which looks like millimetres")
    require(size > 0, "points", "span more than one place", "all points in one place")
    nearest = cKDTree(points[0]).query(points[0], k=2)[0][:, 1]
    twins = np.flatnonzero(nearest <= 1e-9 * size)
    require(len(twins) == 0, "points", "be distinct in frame 0", f"duplicates at points {some(twins)}")


def check_holding(fixed: np.ndarray, handles: np.ndarray, surface: np.ndarray, pushed: bool) -> None:
    """fixed, handles, surface (N,) bool must leave something that is held and something that can move.

    pushed: whether any force acts. Raises ValueError when all points are fixed, or none is held, or none compared.
    """
    require(not fixed.all(), "fixed", "leave some points free", f"all {len(fixed)} points fixed")
    held = bool(fixed.any() or handles.any())
    rule = "hold at least one point where forces act, else the body moves as a rigid motion"
    require(held or not pushed, "fixed", rule, "no fixed point and no handle")
    require(bool((surface & ~fixed).any()), "surface", "include at least one free point to compare", "none")


def check_loads(
    forces: np.ndarray | None, jet_force: np.ndarray | None, gravity: np.ndarray, handles: np.ndarray
) -> None:
    """forces (T, N, 3) [N] or the jet's (T,) [N] must be given, be zero in frame 0 and act at some time.

    Raises ValueError otherwise; gravity (3,) [m/s2] and handles (N,) count as something that acts.
    """
    name, load = ("forces", forces) if forces is not None else ("nozzle_force", jet_force)
    require(load is not None, "forces", "be given where no jet (nozzle_*) is", "neither")
    first = np.flatnonzero(np.atleast_2d(load[0].T).any(axis=0))
    where = f"non-zero at points {some(first)}" if name == "forces" else f"{load[0]} N"
    require(len(first) == 0, name, "be zero in frame 0, the reference pose", where)
    acting = bool(load.any() or gravity.any() or handles.any())
    require(acting, name, "be non-zero in some frame where neither gravity nor a handle acts", "zeros only")


def check_amounts(volume: np.ndarray | None, mass: float | None, sigma: float | np.ndarray | None) -> None:
    """volume (N,) [m3], mass [kg] and sigma () or (T, N) [m], where given, must be positive."""
    for name, value in (("volume", volume), ("mass", mass), ("sigma", sigma)):
        low = 1.0 if value is None else float(np.min(value))
        require(low > 0, name, "be positive", low)
