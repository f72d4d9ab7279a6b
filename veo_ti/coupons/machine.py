"""What may be wrong with a stress-stretch measurement rather than with the law, and what such a test cannot tell."""

from dataclasses import dataclass

import numpy as np

from veo_ti.coupons.laws import Cause, Reach
from veo_ti.diagnosis.causes.base import Parameter

SLACK = (0.01, 0.05)  # plausible strain lost before the specimen pulls: measured on it, or by the crosshead
CUT = 0.05  # plausible relative error of a cross section

UNTESTABLE = {
    "viscoelasticity": "the test has one rate and no hold or unloading; pull at two rates, or hold",
    "damping": "the test has one rate",
    "softening": "nothing is loaded twice; unload and load again",
    "permanent_set": "nothing is unloaded",
    "stiffness_drift": "nothing is loaded twice",
    "fibre_anisotropy": "one direction of the sheet was pulled; cut another specimen across",
    "volumetric_law": "no lateral stretch was measured; volume is taken as constant",
    "inertia": "the speed is not resolved",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class StrainOffset(Cause):
    """Slack: the specimen's stretch is the one shown less e, one e for each mode."""

    name: str = "strain_offset"
    form: str = "slack"
    sentence: str = "The specimen begins to pull at another stretch than the one called rest."
    modes: tuple[str, ...]

    def strained(self, mode: str, stretch: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """l - e, but not below one in tension, where a slack specimen hangs; a mode that taught no e has none."""
        own = stretch - _own(self.modes, mode, theta)
        return np.where(stretch > 1, np.maximum(own, 1.0), np.maximum(own, 1e-3))


@dataclass(frozen=True, kw_only=True, eq=False)
class StressOffset(Cause):
    """The load cell's zero, one for each mode."""

    name: str = "stress_offset"
    form: str = "load_cell_zero"
    sentence: str = "The load cell shows a load where there is none."
    modes: tuple[str, ...]

    def shown(self, mode: str, stress: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """P + p."""
        return stress + _own(self.modes, mode, theta)


@dataclass(frozen=True, kw_only=True, eq=False)
class SpecimenScale(Cause):
    """A wrong cross section, one relative error for each mode: a rival of every law that tells modes apart."""

    name: str = "specimen_scale"
    form: str = "cross_section"
    sentence: str = "The specimens' cross sections are off, each by another factor."
    modes: tuple[str, ...]

    def shown(self, mode: str, stress: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """P (1 + s)."""
        return stress * (1 + _own(self.modes, mode, theta))


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineCompliance(Cause):
    """Grips and frame give: the specimen's stretch is the one shown less c P, so that `s + c P(s) = l`."""

    name: str = "machine_compliance"
    form: str = "series_spring"
    sentence: str = "Grips and frame give under the load, so the specimen is stretched less than shown."


def _own(modes: tuple[str, ...], mode: str, theta: np.ndarray) -> float:
    return float(theta[modes.index(mode)]) if mode in modes else 0.0


def machine(reach: Reach) -> tuple[Cause, ...]:
    """The causes in the measurement that these curves could show."""
    own = {"modes": reach.modes}
    give = 0.05 * abs(reach.stretch - 1) / reach.stress
    slack = SLACK[reach.crosshead]
    found = (
        StrainOffset(parameters=_each("e", "-", slack, reach), **own),
        StressOffset(parameters=_each("p", "Pa", 0.02 * reach.stress, reach), **own),
        MachineCompliance(parameters=(Parameter(name="c", unit="1/Pa", sd=give, positive=True),)),
    )
    return found if len(reach.modes) == 1 else (*found, SpecimenScale(parameters=_each("s", "-", CUT, reach), **own))


def _each(stem: str, unit: str, sd: float, reach: Reach) -> tuple[Parameter, ...]:
    return tuple(Parameter(name=f"{stem}_{mode}", unit=unit, sd=sd) for mode in reach.modes)
