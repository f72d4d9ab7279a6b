"""What may be wrong with the incompressible Neo-Hookean law: each cause in the forms that people write it in.

The baseline is `W = mu/2 (I1 - 3)`. A law adds the slope dW/ds_i by the principal stretches, in units of mu, and
nothing at its null, zero. With `I = I1 - 3`, `dI1/ds_i = 2 s_i`, `dI2/ds_i = 2 s_i (I1 - s_i^2)`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.curves import Curve, first_invariant, principal
from veo_ti.diagnosis.causes.base import Parameter

BEYOND = (
    "The energy depends on more than the first invariant: it matters how the material is stretched, not only how far."
)
_LARGE = 50.0  # exponents beyond it are as good as infinite


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How far the training curves go, by which the widths of the priors are set."""

    modes: tuple[str, ...]
    invariant: float  # largest I = I1 - 3
    stretch: float  # largest
    stress: float  # largest [Pa]
    crosshead: bool = False

    @classmethod
    def of(cls, curves: Sequence[Curve], crosshead: bool = False) -> "Reach":
        """The reach of some curves."""
        largest = max(float(first_invariant(principal(c.mode, c.stretch)).max()) for c in curves)
        return cls(
            modes=tuple(c.mode for c in curves), invariant=largest, crosshead=crosshead,
            stretch=max(float(np.abs(c.stretch).max()) for c in curves),
            stress=max(float(np.abs(c.stress).max()) for c in curves),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Cause:
    """A cause in one form. limit: a parameter at and beyond which the law has no finite stress in reach."""

    name: str
    form: str
    sentence: str
    parameters: tuple[Parameter, ...]
    limit: float = np.inf  # of the first parameter

    def slope(self, s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """dW/ds_i over mu that the cause adds, (n, 3)."""
        return np.zeros_like(s)

    def strained(self, mode: str, stretch: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """The specimen's stretch where the machine shows `stretch`."""
        return stretch

    def shown(self, mode: str, stress: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """The stress that the machine shows where the specimen carries `stress`."""
        return stress

    @property
    def width(self) -> np.ndarray:
        """Prior standard deviations, (d,)."""
        return np.array([p.sd for p in self.parameters])


@dataclass(frozen=True, kw_only=True, eq=False)
class StrainStiffening(Cause):
    """`dW/dI1 = mu/2 f(I)`, so `slope = (f - 1) s_i`; f(0) = 1."""

    name: str = "strain_stiffening"
    sentence: str = "The material grows stiffer the more it is stretched."
    factor: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def slope(self, s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(f(I) - 1) s_i."""
        return (self.factor(first_invariant(s), theta) - 1)[:, None] * s


@dataclass(frozen=True, kw_only=True, eq=False)
class StrainSoftening(Cause):
    """Knowles' power law (1977), `f(I) = (1 + e^k I)^-m`: `slope = (f - 1) s_i`.

    In one mode it imitates the second invariant: any single curve is that of some law of I alone.
    """

    name: str = "strain_softening"
    sentence: str = "The material grows softer the more it is stretched."

    def slope(self, s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(f(I) - 1) s_i."""
        grown = np.log1p(np.exp(min(theta[1], _LARGE)) * np.maximum(first_invariant(s), 0.0))
        return (np.exp(np.minimum(-theta[0] * grown, _LARGE)) - 1)[:, None] * s


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondInvariant(Cause):
    """`dW/dI2 = mu c/2 (3 / I2)^power`, so `slope = c (3 / I2)^power s_i (I1 - s_i^2)`.

    power 0: Mooney-Rivlin, C2 = mu c/2; 1/2: Carroll (2011), sqrt(I2); 1: Gent and Thomas (1958), ln I2. The modulus at
    small strain is mu (1 + c).
    """

    name: str = "second_invariant"
    sentence: str = BEYOND
    power: float

    def slope(self, s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """c (3 / I2)^power s_i (I1 - s_i^2)."""
        square = s**2
        I1 = square.sum(axis=1, keepdims=True)
        I2 = (I1**2 - (square**2).sum(axis=1, keepdims=True)) / 2
        return theta[0] * (3 / I2) ** self.power * s * (I1 - square)


@dataclass(frozen=True, kw_only=True, eq=False)
class StretchExponent(Cause):
    """Ogden's law of one term, `W = 2 mu/alpha^2 sum (s_i^alpha - 1)`, alpha = 2 + a.

    `slope = 2/alpha s_i^(alpha - 1) - s_i`. At alpha = -2 it is the second invariant's; its effect differs between
    modes at equal I, as that one's does.
    """

    name: str = "second_invariant"
    sentence: str = BEYOND

    def slope(self, s: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """2/alpha s_i^(alpha - 1) - s_i; alpha = 0, where W is mu sum ln^2 s_i, by its neighbour."""
        alpha = 2 + theta[0]
        alpha = alpha if abs(alpha) > 1e-6 else 1e-6
        return 2 / alpha * s ** (alpha - 1) - s


def _yeoh(I: np.ndarray, theta: np.ndarray) -> np.ndarray:  # noqa: E741 - the literature's letter
    """1 + 2 beta I + 3 gamma I^2: `sim.laws.extra.YeohStiffening`'s beta; C2 = mu beta/2, C3 = mu gamma/2."""
    return 1 + 2 * theta[0] * I + (3 * theta[1] * I**2 if len(theta) > 1 else 0.0)


def _gent(I: np.ndarray, theta: np.ndarray) -> np.ndarray:  # noqa: E741
    """1 / (1 - g I): infinite at and beyond I = 1/g."""
    return _pole(1 - theta[0] * I)


def _eight_chain(I: np.ndarray, theta: np.ndarray) -> np.ndarray:  # noqa: E741
    """Arruda and Boyce (1993), Cohen's inverse Langevin function: `(3 - x)/(1 - x)`, `x = g I1 / 3`, over its rest."""
    x, rest = theta[0] * (I + 3) / 3, theta[0]
    return (3 - x) * _pole(1 - x) * (1 - rest) / (3 - rest)


def _pole(gap: np.ndarray) -> np.ndarray:
    return np.where(gap > 0, 1 / np.where(gap > 0, gap, 1.0), np.inf)


def laws(reach: Reach) -> tuple[Cause, ...]:
    """The constitutive causes, with priors under which the stress changes by its own size where I is largest."""
    big = reach.invariant
    beta = Parameter(name="beta", unit="-", sd=1 / big, positive=True)
    mixed = (Parameter(name="beta", unit="-", sd=1 / big), Parameter(name="gamma", unit="-", sd=big**-2, positive=True))
    g, n = (Parameter(name=name, unit="-", sd=sd, positive=True) for name, sd in (("g", 1 / big), ("g", 3 / (big + 3))))
    c = Parameter(name="c", unit="-", sd=1.0, positive=True)
    power = (Parameter(name="m", unit="-", sd=0.3, positive=True), Parameter(name="k", unit="-", sd=1.5))
    return (
        StrainStiffening(form="yeoh", parameters=(beta,), factor=_yeoh),
        StrainStiffening(form="yeoh_cubic", parameters=mixed, factor=_yeoh),
        StrainStiffening(form="gent", parameters=(g,), factor=_gent, limit=1 / big),
        StrainStiffening(form="eight_chain", parameters=(n,), factor=_eight_chain, limit=3 / (big + 3)),
        StrainSoftening(form="knowles", parameters=power),
        SecondInvariant(form="mooney_rivlin", parameters=(c,), power=0.0),
        SecondInvariant(form="carroll", parameters=(c,), power=0.5),
        SecondInvariant(form="gent_thomas", parameters=(c,), power=1.0),
        StretchExponent(form="ogden", parameters=(Parameter(name="a", unit="-", sd=2.0),)),
    )
