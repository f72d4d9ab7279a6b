"""Bundle adjustment: cameras, lenses and boards moved together until the pictures agree with them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from recon.calibration.problem import Problem, State, factor, least
from recon.calibration.sightings import LENS, Sightings, lenses, residuals, with_lens
from recon.cameras import Camera
from sim.checks import require

_RADIAL, _SHEAR, _TILT, _CENTRE = 0.5, 0.003, 0.01, 0.02
_MEDIAN = 1.1774  # median length of a two-dimensional normal error, in its standard deviation


@dataclass(frozen=True, kw_only=True)
class BundleOptions:
    """How the adjustment treats lenses and wrong corners.

    lenses: whether they are adjusted too; coefficients: how many of OpenCV's distortion numbers they have. What
    pictures leave open is settled by what lenses are: radial numbers of 0 +- 0.5, tangential and thin-prism ones of
    0 +- 0.003, tilts of 0 +- 0.01 rad, a principal point within 2 % of the width about the picture's middle; where a
    lens is known beforehand, the same about its numbers.
    loose: residuals count by their size, no longer by its square, beyond so many standard deviations; stray: corners
    beyond so many are left out. iterations: most steps of each of the `rounds` in which the noise is estimated anew.
    """

    lenses: bool = True
    coefficients: int = 5
    loose: float = 3.0
    stray: float = 6.0
    rounds: int = 3
    iterations: int = 60

    def __post_init__(self) -> None:
        known = self.coefficients in (0, 4, 5, 8, 12, 14)
        require(known, "coefficients", "be 0, 4, 5, 8, 12 or 14", self.coefficients)
        sound = 0 < self.loose <= self.stray and min(self.rounds, self.iterations) > 0
        require(sound, "loose, stray, rounds, iterations", "be positive and in order", repr(self))


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """Adjusted cameras and boards, what remains, and how sure they are."""

    cameras: tuple[Camera, ...]
    T_world_body: np.ndarray  # (B, 4, 4) [m]
    residual: np.ndarray  # (M, 2) [px], of every corner given
    kept: np.ndarray  # (M,) bool, corners that took part
    noise_px: float  # of one coordinate of a corner [px]
    covariance: np.ndarray  # (C, 6, 6), turn in the camera's axes [rad], place in the world [m]; zero for the first
    lens_error: np.ndarray  # (C, 18) standard errors of fx, fy, cx, cy [px] and the coefficients


def adjusted(
    cameras: Sequence[Camera],
    T_world_body: np.ndarray,
    sightings: Sightings,
    *,
    usual: np.ndarray | None = None,
    options: BundleOptions | None = None,
) -> Bundle:
    """Least `sum rho(|predicted - seen| / noise)` over cameras, lenses and bodies, the first camera staying in place.

    usual: (C, 18), what the lenses are held to be where the pictures leave them open, by default perfect.
    Levenberg and Marquardt's steps on the sparse normal equations (Triggs et al., Bundle Adjustment, 2000): scipy's
    own `least_squares` offers only LSMR for such a Jacobian, which after a hundred steps is still millimetres away.
    The covariance is `noise^2 (J^T W J)^-1`. Raises ValueError when the pictures do not fix the unknowns.
    """
    options = options or BundleOptions()
    usual = _perfect(cameras) if usual is None else usual
    T_camera = np.array([camera.T_camera_world for camera in cameras])
    state = State(lens=lenses(cameras), T_camera=T_camera, T_body=T_world_body)
    kept = np.ones(len(sightings.camera), bool)
    for turn in range(options.rounds):
        left = np.linalg.norm(residuals(state.lens, state.T_camera, state.T_body, sightings), axis=1)
        noise = max(float(np.median(left[kept])) / _MEDIAN, 1e-6)
        kept = left < options.stray * noise if turn else kept
        problem = _posed(cameras, usual, sightings.chosen(kept), len(T_world_body), noise, options)
        state = least(problem, state, options.iterations)
    return _result(cameras, state, problem, sightings, kept, options)


def _perfect(cameras: Sequence[Camera]) -> np.ndarray:
    """Lenses (C, 18) without distortion, looking through the middle of the picture."""
    usual = np.zeros((len(cameras), LENS))
    usual[:, 2:4] = [[(n - 1) / 2 for n in camera.size] for camera in cameras]
    return usual


def _posed(
    cameras: Sequence[Camera],
    usual: np.ndarray,
    sightings: Sightings,
    bodies: int,
    noise: float,
    options: BundleOptions,
) -> Problem:
    spread, moves = np.zeros_like(usual), np.zeros(usual.shape, bool)
    spread[:, 2:4] = [[_CENTRE * camera.size[0]] * 2 for camera in cameras]
    spread[:, 4:] = [_RADIAL] * 2 + [_SHEAR] * 2 + [_RADIAL] * 4 + [_SHEAR] * 4 + [_TILT] * 2
    moves[:, : 4 + options.coefficients] = options.lenses
    weight = np.divide(1, spread**2, out=np.zeros_like(spread), where=moves & (spread > 0))
    camera, body = np.ones((len(cameras), 6), bool), np.zeros((bodies, 6), bool)
    camera[0] = False
    body[np.unique(sightings.body)] = True
    free = np.flatnonzero(np.concatenate([camera.ravel(), moves.ravel(), body.ravel()]))
    loose = options.loose * noise
    return Problem(sightings=sightings, free=free, usual=usual, weight=weight, noise=noise, loose=loose)


def _result(
    cameras: Sequence[Camera],
    state: State,
    problem: Problem,
    sightings: Sightings,
    kept: np.ndarray,
    options: BundleOptions,
) -> Bundle:
    left = residuals(state.lens, state.T_camera, state.T_body, sightings)
    spare = 2 * int(kept.sum()) - len(problem.free)
    require(spare > 0, "corners", f"be more than {len(problem.free) // 2}, half the unknowns", int(kept.sum()))
    noise = float(np.sqrt((left[kept] ** 2).sum() / spare))
    covariance, lens_error = _uncertainty(problem, state, noise)
    found = [replace(camera, T_camera_world=T) for camera, T in zip(cameras, state.T_camera, strict=True)]
    if options.lenses:
        found = [with_lens(c, lens, options.coefficients) for c, lens in zip(found, state.lens, strict=True)]
    return Bundle(
        cameras=tuple(found),
        T_world_body=state.T_body,
        residual=left,
        kept=kept,
        noise_px=noise,
        covariance=covariance,
        lens_error=lens_error,
    )


def _uncertainty(problem: Problem, state: State, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (C, 6, 6) of the cameras' poses and standard errors (C, 18) of their lenses."""
    count = len(state.lens)
    wanted = problem.free < (6 + LENS) * count
    unit = np.eye(len(problem.free))[:, wanted]
    solved = factor(problem.normal(state)[0]).solve(unit)[wanted] * (noise / problem.noise) ** 2
    whole, at = np.zeros(((6 + LENS) * count,) * 2), problem.free[wanted]
    whole[np.ix_(at, at)] = solved
    rows = 6 * np.arange(count)[:, None] + np.arange(6)
    return whole[rows[:, :, None], rows[:, None]], np.sqrt(np.diag(whole)[6 * count :]).reshape(count, LENS)
