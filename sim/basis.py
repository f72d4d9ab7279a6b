"""The coefficients that describe a material field, their prior, and the options of the fit that finds them."""

from dataclasses import dataclass, field, replace

import numpy as np

from sim.checks import require
from sim.cloud import RestCloud
from sim.elastic import Elastic
from sim.lame import Lame
from sim.newton import NewtonOptions
from sim.prior import FieldModes

_LENGTHS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the object's longest side, over which its stiffness may vary
_AMPLITUDES = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)  # standard deviations of log mu


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """modes and ratio_modes: fields for log mu and log(lam/mu), 0 for a homogeneous object.

    mean_sd is the prior's width of the mean of log mu about the first guess; poisson the centre, ratio_sd the width of
    log(lam/mu); ratio_field_sd how much that varies over the object. gain stops the iteration once a step lowers the
    objective by less, in nats per observed coordinate.
    """

    modes: int = 80
    ratio_modes: int = 8
    mean_sd: float = 5.0
    poisson: float = 0.4
    ratio_sd: float = 0.5
    ratio_field_sd: float = 0.2
    iterations: int = 12
    gain: float = 5e-3
    step: float = 1.5
    newton: NewtonOptions = field(default_factory=lambda: NewtonOptions(tolerance=1e-5))

    def __post_init__(self) -> None:
        require(0 < self.poisson < 0.5, "poisson", "lie between 0 and 0.5", self.poisson)
        require(self.modes >= 0, "modes", "not be negative", self.modes)
        require(self.iterations > 0, "iterations", "be positive", self.iterations)

    @property
    def homogeneous(self) -> "FitOptions":
        """The same options for one pair of Lame parameters: the baseline."""
        return replace(self, modes=0, ratio_modes=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """log mu = mean + modes, log(lam/mu) = mean + modes, as one linear map of the coefficients a (K,)."""

    log_mu: np.ndarray  # (N, K)
    log_ratio: np.ndarray  # (N, K)
    field: FieldModes
    options: FitOptions
    centre: float  # log mu where the coefficients vanish
    spacing: float  # of the cloud [m]
    size: float  # its longest side [m]

    @classmethod
    def of(cls, cloud: RestCloud, options: FitOptions, mu: float) -> "Basis":
        """The basis on a cloud, around a first guess mu [Pa]."""
        field_modes = FieldModes.of(cloud, max(options.modes, options.ratio_modes, 2) + 1)
        soft, ratio = field_modes.modes[:, 1 : options.modes + 1], field_modes.modes[:, 1 : options.ratio_modes + 1]
        ones, none = np.ones((cloud.count, 1)), np.zeros((cloud.count, 1))
        log_mu = np.concatenate([ones, none, soft, np.zeros_like(ratio)], axis=1)
        log_ratio = np.concatenate([none, ones, np.zeros_like(soft), ratio], axis=1)
        return cls(
            log_mu=log_mu,
            log_ratio=log_ratio,
            field=field_modes,
            options=options,
            centre=float(np.log(mu)),
            spacing=cloud.spacing,
            size=float(np.ptp(cloud.x, axis=0).max()),
        )

    def prior(self, length: float, amplitude: float) -> np.ndarray:
        """Prior variances of the coefficients, (K,)."""
        spectrum = self.field.spectrum(length)
        soft = amplitude**2 * spectrum[1 : self.options.modes + 1]
        ratio = self.options.ratio_field_sd**2 * spectrum[1 : self.options.ratio_modes + 1]
        return np.maximum(np.concatenate([[self.options.mean_sd**2, self.options.ratio_sd**2], soft, ratio]), 1e-12)

    def priors(self) -> list[np.ndarray]:
        """Prior variances (K,) of a range of lengths and amplitudes; none for a homogeneous object."""
        if not self.options.modes:
            return []
        lengths = sorted({max(share * self.size, 2 * self.spacing) for share in _LENGTHS})
        return [self.prior(length, amplitude) for length in lengths for amplitude in _AMPLITUDES]

    def lame(self, a: np.ndarray) -> Lame:
        """The material of coefficients a."""
        nu = self.options.poisson
        mu = np.exp(self.centre + self.log_mu @ a)
        return Lame(mu=mu, lam=mu * np.exp(np.log(2 * nu / (1 - 2 * nu)) + self.log_ratio @ a))

    def elastic(self, elastic: Elastic, a: np.ndarray) -> Elastic:
        """The elastic energy with the material of coefficients a."""
        lame = self.lame(a)
        return elastic.with_parameters(np.stack([lame.mu, lame.lam], axis=1))

    def stiffer(self, a: np.ndarray, nats: float) -> np.ndarray:
        """Coefficients (K + ...,) of an object whose mu and lam are exp(nats) times those of a, everywhere."""
        return a + nats * np.eye(len(a))[0]

    def directions(self, lame: Lame) -> np.ndarray:
        """d(mu, lam)/da, (K, N, 2)."""
        d_mu = lame.mu[:, None] * self.log_mu
        d_lam = lame.lam[:, None] * (self.log_mu + self.log_ratio)
        return np.stack([d_mu.T, d_lam.T], axis=2)
