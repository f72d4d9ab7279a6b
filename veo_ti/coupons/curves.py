"""Stress-stretch curves in SI units, and the kinds of loading they come from."""

from dataclasses import dataclass

import numpy as np

from sim.checks import as_array, require

NAMES = {"UT": "uniaxial", "ET": "equibiaxial", "PS": "pure shear"}
MOST = 120  # points of a curve that are kept: neighbours of a densely sampled curve say the same
FEWEST = 4
_REST = 1e-9  # stretches nearer to one say nothing about the law
_FLOOR = 0.1  # of the median stress: below it errors are absolute, above it relative to the stress


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """One test of an incompressible specimen in monotonic loading.

    mode UT: principal stretches (l, l^-1/2, l^-1/2); ET: (l, l, l^-2); PS: (l, 1, 1/l). stretch l (n,) [-], sorted;
    stress (n,): force over the undeformed cross section [Pa].
    """

    mode: str
    stretch: np.ndarray
    stress: np.ndarray

    @classmethod
    def of(cls, mode: str, stretch: np.ndarray, stress: np.ndarray) -> "Curve":
        """A checked curve: sorted by stretch, without its points at rest. Raises ValueError in one sentence."""
        require(mode in NAMES, "mode", f"be one of {', '.join(NAMES)}", mode)
        stretch = as_array(f"{mode} stretch", stretch, (None,))
        stress = as_array(f"{mode} stress", stress, stretch.shape)
        require(bool((stretch > 0).all()), f"{mode} stretch", "be positive", stretch.min() if len(stretch) else "none")
        order = np.lexsort((stress, stretch))
        order = order[np.abs(stretch[order] - 1) > _REST]
        pulls = float(stress @ (stretch - 1)) > 0
        require(pulls, f"{mode} stress", "be positive in tension and negative in compression", "the opposite or zeros")
        require(len(order) >= FEWEST, f"{mode} curve", f"have at least {FEWEST} points off rest", len(order))
        return cls(mode=mode, stretch=stretch[order], stress=stress[order])

    def __len__(self) -> int:
        return len(self.stretch)

    def part(self, keep: np.ndarray) -> "Curve":
        """The points where keep (n,) is true, or at these indices."""
        return Curve(mode=self.mode, stretch=self.stretch[keep], stress=self.stress[keep])

    def thinned(self, most: int = MOST) -> "Curve":
        """At most so many points, evenly taken from the curve, its ends among them."""
        if len(self) <= most:
            return self
        return self.part(np.unique(np.linspace(0, len(self) - 1, most).round().astype(int)))

    @property
    def scale(self) -> np.ndarray:
        """What errors are counted in, (n,) [Pa]: the stress, but at small stress a tenth of its median."""
        return np.hypot(self.stress, _FLOOR * np.median(np.abs(self.stress)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupon:
    """The curves of one material, one of a mode; crosshead: the stretch is the machine's, not the specimen's."""

    name: str
    curves: tuple[Curve, ...]
    crosshead: bool = False

    def __post_init__(self) -> None:
        modes = self.modes
        require(bool(modes), "coupon", "hold at least one curve", "none")
        require(len(set(modes)) == len(modes), "coupon", "hold one curve of a mode", ", ".join(modes))

    @property
    def modes(self) -> tuple[str, ...]:
        """The modes in the order of the curves."""
        return tuple(curve.mode for curve in self.curves)


def principal(mode: str, stretch: np.ndarray) -> np.ndarray:
    """Principal stretches (n, 3) of unit product; the third direction is free of stress."""
    one = np.ones_like(stretch)
    if mode == "UT":
        return np.stack([stretch, stretch**-0.5, stretch**-0.5], axis=1)
    return np.stack([stretch, stretch, stretch**-2] if mode == "ET" else [stretch, one, 1 / stretch], axis=1)


def first_invariant(s: np.ndarray) -> np.ndarray:
    """I = s1^2 + s2^2 + s3^2 - 3, (n,): `sim.laws.extra`'s I at unit volume."""
    return (s**2).sum(axis=1) - 3


def free_of_pressure(s: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The nominal stress along the first direction, (n,): `P1 = W_1 - (s3 / s1) W_3`.

    W_i = dW/ds_i, (n, 3). Stresses of an incompressible solid are known up to a pressure, which the free third
    direction fixes (Ogden 1972, Eq. 3); for ET both pulled directions carry this stress, for PS the first.
    """
    return slope[:, 0] - s[:, 2] / s[:, 0] * slope[:, 2]
