"""Takes that no fit saw: their release is read from their first frames, the rest of the motion is predicted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from veo_ti.beam_dynamics.fitting import FREE, Data, Fit, seen
from veo_ti.beam_dynamics.hypotheses import LATENCY, RISE
from veo_ti.beam_dynamics.ritz import Start
from veo_ti.beam_dynamics.sinusoid import RingDown, ring_down
from veo_ti.beam_dynamics.takes import Release

READ = 0.3  # [s] after the release: the frames from FREE to here tell when and how slowly the hand let go
BLOCK = 0.1  # [s] of frames that are drawn together
DRAWS = 2000


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Root mean square errors per coordinate [mm] after READ, of all takes together, and what was gained."""

    no_change: float  # the held pose
    quasi_static: float
    refit_only: float  # the same with the release, the modulus and the reach refitted
    hold_residual: float  # quasi-static, off by as much as at READ for ever
    replay: float  # the first fitted take of the same loading, frame by frame
    after: float
    lateral: float  # of the measured motion across the plane of the loads, which nothing here predicts
    gained: tuple[float, float, float]  # refit_only minus after: estimate, and a 95 % interval over blocks

    @property
    def confirmed(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.gained[1] > 0


def read_start(data: Data, fit: Fit, release: Release) -> Start:
    """When and how slowly the hand let go, from frames FREE to READ, everything else as fitted elsewhere."""
    inside = (release.time >= FREE) & (release.time <= READ)
    physics = fit.setup.physics(fit.theta, release)
    reach = fit.setup.values(fit.theta).get(f"reach_{release.kind}", 1.0)

    def start(p: np.ndarray) -> Start:
        return Start(latency=float(p[0]), rise=float(np.exp(p[1])), reach=reach)

    def left(p: np.ndarray) -> np.ndarray:
        w = data.one(physics, start(p), release)
        prior = [(p[0] - LATENCY.mean) / LATENCY.width, (p[1] - RISE.mean) / RISE.width]
        return np.concatenate([seen((release.w - w)[inside]) / (5 * fit.sigma), prior])

    firsts = [[latency, np.log(rise)] for latency in (-0.03, 0.0) for rise in (0.02, 0.06)]
    return start(min((least_squares(left, p) for p in firsts), key=lambda f: f.cost).x)


def predicted(data: Data, fit: Fit, release: Release) -> np.ndarray:
    """A take that the fit did not see, (T, 3, 3) [m]."""
    return data.one(fit.setup.physics(fit.theta, release), read_start(data, fit, release), release)


def measure_gain(
    releases: Sequence[Release], models: Mapping[str, Mapping[str, np.ndarray]], replay: Mapping[str, np.ndarray],
    *, seed: int = 0,
) -> Gain:
    """models: refit_only and after -> take -> (T, 3, 3) [m]; replay: take -> (T, 3, 3) [m]."""  # fmt: skip
    squares: dict[str, list[np.ndarray]] = {}
    lateral = []
    for r in releases:
        late = r.time > READ
        first = int(np.flatnonzero(late)[0])
        shown = {
            "no_change": np.broadcast_to(r.w[0], r.w.shape), "quasi_static": np.zeros_like(r.w),
            "hold_residual": np.broadcast_to(r.w[first - 1], r.w.shape), "replay": replay[r.name],
            **{name: model[r.name] for name, model in models.items()},
        }  # fmt: skip
        for name, w in shown.items():
            squares.setdefault(name, []).append(((r.w - w)[late] ** 2).mean(axis=(1, 2)))
        lateral.append((r.w[late, :, 1] ** 2).mean(axis=1))
    rms = {name: 1e3 * float(np.sqrt(np.concatenate(s).mean())) for name, s in squares.items()}
    low, high = interval(squares["refit_only"], squares["after"], _frames(releases), seed)
    return Gain(**rms, lateral=1e3 * float(np.sqrt(np.concatenate(lateral).mean())),
                gained=(rms["refit_only"] - rms["after"], low, high))  # fmt: skip


def interval(
    before: Sequence[np.ndarray], after: Sequence[np.ndarray], length: int, seed: int = 0
) -> tuple[float, float]:
    """95 % of rms(before) - rms(after) [mm], blocks of `length` frames drawn again; squares (T,) [m2] of each take."""
    blocks = [
        np.stack([b[i : i + length], a[i : i + length]])
        for b, a in zip(before, after, strict=True) for i in range(0, len(b) - length + 1, length)
    ]  # fmt: skip
    means, random = np.stack(blocks).mean(axis=2), np.random.default_rng(seed)
    drawn = means[random.integers(len(means), size=(DRAWS, len(means)))].mean(axis=1)
    gained = 1e3 * (np.sqrt(drawn[:, 0]) - np.sqrt(drawn[:, 1]))
    low, high = np.quantile(gained, [0.025, 0.975])
    return float(low), float(high)


def cause_gain(
    data: Data, best: Fit, without: Fit, releases: Sequence[Release], seed: int = 0
) -> tuple[float, float, float]:
    """How much further off the unseen takes are without a cause [mm], with a 95 % interval, by the shapes."""
    squares = [
        [((r.w - predicted(data, fit, r))[r.time > READ] ** 2).mean(axis=(1, 2)) for r in releases]
        for fit in (without, best)
    ]
    mm = [1e3 * float(np.sqrt(np.concatenate(s).mean())) for s in squares]
    return (mm[0] - mm[1], *interval(squares[0], squares[1], _frames(releases), seed))


def _frames(releases: Sequence[Release]) -> int:
    return max(1, round(BLOCK / float(np.diff(releases[0].time).mean())))


@dataclass(frozen=True, kw_only=True)
class Ringing:
    """Frequency and damping ratio of a take after READ: measured and predicted, with standard deviations."""

    measured: RingDown
    predicted: RingDown
    frequency_sd: float  # [Hz] of the prediction
    ratio_sd: float


def ringing(data: Data, fit: Fit, release: Release, w: np.ndarray, *, draws: int = 24, seed: int = 0) -> Ringing:
    """The same damped sinusoid on the measured heights and on a prediction w (T, 3, 3) [m].

    The prediction's uncertainty is the spread over draws of the parameters, by the shapes.
    """
    late, random = release.time > READ, np.random.default_rng(seed)
    start, shared = read_start(data, fit, release), len(fit.setup.shared)
    root = np.linalg.cholesky(fit.covariance(fit.effective)[:shared, :shared])
    found = []
    for _ in range(draws):
        theta = fit.theta.copy()
        theta[:shared] += root @ random.normal(size=shared)
        shown = data.one(fit.setup.physics(theta, release), start, release)
        found.append(ring_down(release.time[late], shown[late, :, 2].mean(axis=1)))
    return Ringing(
        measured=ring_down(release.time[late], release.tip[late]),
        predicted=ring_down(release.time[late], w[late, :, 2].mean(axis=1)),
        frequency_sd=float(np.std([f.frequency for f in found])), ratio_sd=float(np.std([f.ratio for f in found])),
    )  # fmt: skip
