"""What may be missing from the quasi-static beam: hypotheses that share nuisances, and the physics each one implies."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from veo_ti.beam_dynamics.ritz import Physics, Start
from veo_ti.beam_dynamics.takes import Release

MODULUS = 0.04  # sd of log E: what the static identification leaves
REACH = 0.03  # sd of log (held minus settled pose over the model's): the two loads want moduli 4 % apart


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A parameter with its prior: normal, or normal in its logarithm where it must be positive."""

    name: str
    unit: str
    centre: float
    width: float  # sd, of the logarithm where `positive`
    positive: bool = True

    @property
    def mean(self) -> float:
        """In the coordinate that the fit sees."""
        return float(np.log(self.centre)) if self.positive else self.centre

    def value(self, coordinate: float) -> float:
        """The parameter itself."""
        return float(np.exp(coordinate)) if self.positive else float(coordinate)

    def coordinate(self, value: float) -> float:
        """Where the fit sees a value."""
        return float(np.log(value)) if self.positive else float(value)


DAMPING = {  # what takes the ringing's energy
    "stiffness": (Unknown(name="stiffness_damping", unit="s", centre=3e-3, width=1.5),),
    "mass": (Unknown(name="mass_damping", unit="1/s", centre=3.0, width=1.5),),
    "relaxation": (
        Unknown(name="relaxing_share", unit="-", centre=0.1, width=1.2),
        Unknown(name="relaxation_time", unit="s", centre=0.02, width=1.5),
    ),
}
CREEP = (
    Unknown(name="creeping_share", unit="-", centre=0.1, width=1.2),
    Unknown(name="creep_time", unit="s", centre=0.4, width=1.5),
)
HUNG = Unknown(name="hung_mass", unit="kg", centre=0.03, width=1.0)
FITTINGS = Unknown(name="fittings", unit="kg", centre=2e-3, width=1.0)
LATENCY = Unknown(name="latency", unit="s", centre=0.0, width=0.02, positive=False)
RISE = Unknown(name="rise", unit="s", centre=0.02, width=1.0)
WEIGHTS = {"force": "as a force alone", "mass": "as a mass fixed to the edge", "string": "as a mass on a string"}
KINDS = {
    ("stiffness",): "in proportion to stiffness", ("mass",): "in proportion to mass",
    ("stiffness", "mass"): "in proportion to stiffness and mass together",
    ("relaxation",): "by a fast relaxation of the material",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """A set of effects; without any, the beam takes every equilibrium at once."""

    inertia: bool = False
    weight: str = "force"  # how the hung weight acts: a key of WEIGHTS
    damping: tuple[str, ...] = ()  # keys of DAMPING
    creep: bool = False  # a standard linear solid that is slow compared with the ringing
    fittings: bool = False  # a small mass at the tip in every take: the markers and what holds them
    fitted: bool = False  # the hung mass is a parameter instead of what the scales say

    @property
    def label(self) -> str:
        """As it is read."""
        parts = ["inertia"] if self.inertia else []
        parts += [f"damping by {' and '.join(self.damping)}"] if self.damping else []
        parts += ["creep"] if self.creep else []
        weight = {"force": "", "mass": "weight as mass", "string": "weight on a string"}[self.weight]
        parts += [f"{weight}{', fitted' * self.fitted}"] if self.inertia and weight else []
        return " + ".join(parts + ["fittings"] * self.fittings) or "late or slow release"

    @property
    def native(self) -> bool:
        """Whether `sim.dynamics.simulate` has its damping: a fast relaxation comes to it as a load, from the shapes."""
        return "relaxation" not in self.damping

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The parameters of the effects."""
        found = [unknown for kind in self.damping for unknown in DAMPING[kind]]
        return (*found, *CREEP * self.creep, *(HUNG,) * self.fitted, *(FITTINGS,) * self.fittings)


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """A hypothesis on some takes: which coordinate of the fit means what."""

    hypothesis: Hypothesis
    releases: tuple[Release, ...]

    @property
    def kinds(self) -> list[str]:
        """The loadings in order."""
        return list(dict.fromkeys(r.kind for r in self.releases))

    @property
    def nuisances(self) -> tuple[Unknown, ...]:
        """The modulus and each loading's reach."""
        modulus = Unknown(name="modulus", unit="-", centre=1.0, width=MODULUS)
        return (modulus, *(Unknown(name=f"reach_{k}", unit="-", centre=1.0, width=REACH) for k in self.kinds))

    @property
    def shared(self) -> tuple[Unknown, ...]:
        """Of the effects, then the nuisances: what other takes have as well."""
        return (*self.hypothesis.unknowns, *self.nuisances)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The shared ones, then each take's own release."""
        return (*self.shared, *(LATENCY, RISE) * len(self.releases))

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """The shared parameters by name."""
        return {u.name: u.value(v) for u, v in zip(self.shared, theta, strict=False)}

    def physics(self, theta: np.ndarray, release: Release) -> Physics:
        """The physics of a take, whether the fit saw it or not."""
        h, value = self.hypothesis, self.values(theta)
        hung = value.get("hung_mass", release.weight) if release.load > 0 and h.weight != "force" else 0.0
        branches = [("relaxing_share", "relaxation_time"), ("creeping_share", "creep_time")]
        return Physics(
            modulus=value["modulus"], inertia=h.inertia, hung=hung, on_string=h.weight == "string",
            fittings=value.get("fittings", 0.0), mass_damping=value.get("mass_damping", 0.0),
            stiffness_damping=value.get("stiffness_damping", 0.0),
            branches=tuple((value[g], value[tau]) for g, tau in branches if g in value),
        )  # fmt: skip

    def start(self, theta: np.ndarray, number: int) -> Start:
        """How take `number` of the fit began."""
        latency, rise = theta[len(self.shared) + 2 * number :][:2]
        kind = self.releases[number].kind
        return Start(latency=float(latency), rise=float(np.exp(rise)), reach=self.values(theta)[f"reach_{kind}"])


QUASI_STATIC = Hypothesis()
# The richest that `sim.dynamics.simulate` integrates without help: the full simulation is compared with it first.
REFERENCE = Hypothesis(inertia=True, weight="mass", damping=("stiffness", "mass"), creep=True, fittings=True)


def grid(loaded: bool = True) -> tuple[Hypothesis, ...]:
    """Those to begin with: without mass, then every damping, with and without creep, fittings, the hung weight's mass.

    loaded: whether a weight hangs in some take.
    """
    kinds: Sequence[tuple[str, ...]] = ((), ("stiffness",), ("mass",), ("stiffness", "mass"), ("relaxation",))
    still = [Hypothesis(damping=damping, creep=creep) for damping in kinds[:2] for creep in (False, True)]
    weights = ("force", "mass") if loaded else ("force",)
    swinging = [
        Hypothesis(inertia=True, weight=weight, damping=damping, creep=creep, fittings=fittings)
        for weight, fittings, creep, damping in product(weights, (False, True), (False, True), kinds)
    ]
    return (*still, *swinging)
