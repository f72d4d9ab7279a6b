"""A pulled strip filmed without a load cell: what tracked points alone can tell, and what they cannot.

Nothing here has a stress scale: any multiple of the energy moves the points alike. Stretches and their ratio, places
of unlike stiffness, and how the pull of the grip arrives can be told.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from sim.checks import as_array, require
from veo_ti.store import read_npz

PIECES = 8  # along the strip
_DRAWS, _FEW = 2000, 400
_KEYS = ("points_aligned_mm", "valid", "grip_displacement_mm")
CLEAR = 4.3  # standard deviations from which something sudden counts
_LEAST = 0.02  # of axial strain from which ratios are taken: below it noise rules


@dataclass(frozen=True, kw_only=True, eq=False)
class Dogbone:
    """x (N, 3): points at rest [m], x the pulled axis, z across the sheet; y (T, N, 3); grip (T,): its travel [m]."""

    x: np.ndarray
    y: np.ndarray
    grip: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, eq=False)
class DogboneFacts:
    """What the film tells.

    axial, lateral (T, PIECES): stretches; noise (2,): of one of them. contraction: -d ln lateral / d ln axial;
    needed_scale: growth of the camera's scale by the last state that would make an isotropic incompressible strip look
    like this. beta: strain stiffening in Yeoh's form, 1 + 2 beta I, which the pieces' unlike stretches under one force
    give without knowing the force. stiffness (PIECES,): of each piece over the mean, were all Neo-Hookean, with sd.
    free_length (T-1,) [m]: grip travel over the strain. seen_share: of that travel in the tracked part, first and last
    state. odd: states whose strain is off its neighbours', with how far. slips: (state, metres) of the clearest sudden
    slip, if any is clear; slip_limit [m]: the smallest that would have been seen.
    """

    data: Dogbone
    axial: np.ndarray
    lateral: np.ndarray
    noise: np.ndarray
    contraction: Estimate
    needed_scale: Estimate
    beta: Estimate
    stiffness: np.ndarray
    stiffness_sd: float
    free_length: np.ndarray
    seen_share: tuple[float, float]  # of the grip's travel that the tracked part takes, first and last state
    odd: tuple[tuple[int, float], ...]
    slips: tuple[tuple[int, float], ...]
    slip_limit: float


def is_dogbone(source: str | Path) -> bool:
    """Whether a file holds tracked points of a strip rather than stress-stretch curves."""
    path = Path(source)
    return path.suffix.lower() == ".npz" and path.is_file() and "points_aligned_mm" in read_npz(path)


def read_dogbone(path: str | Path) -> Dogbone:
    """An .npz with points_aligned_mm (T, N, 3), valid (N,), grip_displacement_mm (T,); metres from here on."""
    arrays = read_npz(path)
    for key in _KEYS:
        require(key in arrays, "dog-bone", f"hold {key}", ", ".join(arrays) or "nothing")
    valid = arrays["valid"].astype(bool)
    y = as_array("points_aligned_mm", arrays["points_aligned_mm"][:, valid], (None, int(valid.sum()), 3)) / 1e3
    require(len(y) >= 10, "points_aligned_mm", "have at least 10 states", len(y))
    require(y.shape[1] >= 4 * PIECES, "points_aligned_mm", f"have at least {4 * PIECES} valid points", y.shape[1])
    return Dogbone(x=y[0], y=y, grip=as_array("grip_displacement_mm", arrays["grip_displacement_mm"], (len(y),)) / 1e3)


def examine_dogbone(data: Dogbone, *, seed: int = 0) -> DogboneFacts:
    """What the tracked points tell, with intervals over pieces of the strip drawn anew."""
    axial, lateral = stretches(data)
    noise = np.array([_rough(part) for part in (axial, lateral)])
    random = np.random.default_rng(seed)
    draws = random.integers(PIECES, size=(_DRAWS, PIECES))
    strain = data_strain(data)
    odd, slips, limit = _sudden(data, strain)
    a, b = np.log(axial[-1]), np.log(lateral[-1])
    moved = np.diff(_ends(data), axis=1)[:, 0]
    stiffness, sd = _stiffness(axial, noise[0])
    return DogboneFacts(
        data=data, axial=axial, lateral=lateral, noise=noise, odd=odd, slips=slips, slip_limit=limit,
        contraction=_estimate(lambda k: _contraction(axial[:, k], lateral[:, k]), draws),
        needed_scale=_estimate(lambda k: float((b[k] + 0.5 * a[k]).mean() / 1.5), draws),
        beta=_estimate(lambda k: _beta(axial[:, np.unique(k)]), draws[:_FEW]),
        stiffness=stiffness, stiffness_sd=sd, free_length=data.grip[1:] / strain[1:],
        seen_share=(float(moved[1] / data.grip[1]), float(moved[-1] / data.grip[-1])) ,
    )  # fmt: skip


def stretches(data: Dogbone) -> tuple[np.ndarray, np.ndarray]:
    """Axial and lateral stretch (T, PIECES): singular values of the affine map that fits each piece of the strip."""
    order = np.argsort(data.x[:, 0])
    found = []
    for piece in np.array_split(order, PIECES):
        at = data.x[piece, :2] - data.x[piece, :2].mean(axis=0)
        design = np.column_stack([at, np.ones(len(at))])
        fit = np.einsum("kn,tnc->tkc", np.linalg.pinv(design), data.y[:, piece])
        found.append(np.linalg.svd(fit[:, :2].swapaxes(1, 2), compute_uv=False))
    both = np.stack(found, axis=1)
    return both[..., 0], both[..., 1]


def data_strain(data: Dogbone) -> np.ndarray:
    """Axial strain of the whole tracked part, (T,): slope of the displacement along x."""
    x = data.x[:, 0] - data.x[:, 0].mean()
    return np.einsum("n,tn->t", x, data.y[:, :, 0] - data.x[:, 0]) / (x @ x)


def _ends(data: Dogbone) -> np.ndarray:
    """Displacement of the tracked part's ends along x by the straight line through all points, (T, 2) [m]."""
    x = data.x[:, 0]
    design = np.column_stack([np.ones(len(x)), x])
    line = np.einsum("kn,tn->tk", np.linalg.pinv(design), data.y[:, :, 0] - x)
    return line[:, :1] + line[:, 1:] * np.array([x.min(), x.max()])


def _rough(series: np.ndarray) -> float:
    """Noise (standard deviation) of smooth series (T, ...) from their third differences."""
    return float(np.median(np.abs(np.diff(series, n=3, axis=0)))) / 0.67449 / np.sqrt(20)


def _contraction(axial: np.ndarray, lateral: np.ndarray) -> float:
    """-d ln lateral / d ln axial through the origin, over the states with enough strain."""
    a, b = np.log(axial).mean(axis=1), np.log(lateral).mean(axis=1)
    used = a > _LEAST
    return float(-(a[used] @ b[used]) / (a[used] @ a[used]))


def _estimate(of: Callable[[np.ndarray], float], draws: np.ndarray) -> Estimate:
    values = np.array([of(k) for k in draws])
    low, high = np.quantile(values, [0.025, 0.975])
    return Estimate(value=float(of(np.arange(PIECES))), low=float(low), high=float(high))


def _beta(axial: np.ndarray) -> float:
    """Yeoh's beta for which `ln P(l)` is a sum of a force for each state and a stiffness for each piece."""
    l = axial[np.log(axial).mean(axis=1) > _LEAST]  # noqa: E741

    def unshared(beta: float) -> float:
        q = np.log((l - l**-2) * np.maximum(1 + 2 * beta * (l**2 + 2 / l - 3), 1e-6))
        q = q - q.mean(axis=1, keepdims=True)
        return float(((q - q.mean(axis=0)) ** 2).sum())

    return float(minimize_scalar(unshared, bounds=(-2.0, 10.0), method="bounded").x)


def _stiffness(axial: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
    """All sections carry one force, so a Neo-Hookean one's stiffness goes as 1 / (l - l^-2): (PIECES,), and sd."""
    l = axial[-1]  # noqa: E741
    k = 1 / (l - l**-2)
    slope = (1 + 2 * l**-3) / (l - l**-2)
    return k / k.mean(), float((slope * noise).mean())


def _sudden(
    data: Dogbone, strain: np.ndarray
) -> tuple[tuple[tuple[int, float], ...], tuple[tuple[int, float], ...], float]:
    """States that are off alone, and a lasting sudden loss of strain, each at most one; the smallest loss seen [m].

    A cubic in the grip's travel with one spike, or one step, at each state in turn; the clearer one is taken first.
    """
    states = np.arange(1, len(strain))
    length = float(np.median(data.grip[1:] / strain[1:]))
    spike, step = (_clearest(data.grip, strain, states, kind) for kind in (np.equal, np.greater_equal))
    odd = ()
    if abs(spike[2]) > max(abs(step[2]), CLEAR):
        odd = ((spike[0], spike[1]),)
        step = _clearest(data.grip, strain, np.setdiff1d(states, [spike[0]]), np.greater_equal)
    slips = ((step[0], -length * step[1]),) if step[2] < -CLEAR else ()
    return odd, slips, CLEAR * length * abs(step[1] / step[2])


def _clearest(
    grip: np.ndarray, strain: np.ndarray, states: np.ndarray, kind: Callable[[np.ndarray, int], np.ndarray]
) -> tuple[int, float, float]:
    """The state at which kind(states, state) beside a cubic is clearest: (state, its size, size over its sd)."""
    found = []
    smooth = np.vander(grip[states] / max(float(grip.max()), 1e-12), 4)
    for t in states[2:-2]:
        design = np.column_stack([smooth, kind(states, t)])
        solution = np.linalg.lstsq(design, strain[states], rcond=None)[0]
        left = strain[states] - design @ solution
        variance = float(left @ left) / (len(states) - 5) * np.linalg.inv(design.T @ design)[-1, -1]
        found.append((int(t), float(solution[-1]), float(solution[-1] / np.sqrt(max(variance, 1e-300)))))
    return max(found, key=lambda f: abs(f[2]))
