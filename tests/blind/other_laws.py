"""Hidden effects of the catalogue in the material, by laws that no other mix hides, and that no cause of the toolkit
had when they were written: the name is right all the same."""

import numpy as np

from blind import laws
from blind.hidden import SHORT, Hidden, sign, unit
from blind.history import Healed, Set, SoonDone, Viscous
from blind.of_material import RAW
from blind.scenes import Model, Scene


def fung_stiffening(rng: np.random.Generator, scene: Scene) -> Hidden:
    """mu/(2b) (exp(b (I - 3)) - 1) in place of mu/2 (I - 3)."""
    return Hidden(
        name="strain_stiffening", start=1 / scene.strain, most=10 / scene.strain, goal=RAW,
        change=lambda model, b: model.with_part(laws.fung(scene.mu, max(b, 1e-9))),
    )  # fmt: skip


def cords(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Fibres that pull and do not push: psi += mu k/2 <I4 - 1>^2."""
    axis, mu = unit(rng), scene.mu

    def change(model: Model, k: float) -> Model:
        def density(I4: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            x = np.maximum(I4 - 1, 0)
            return mu * k / 2 * x**2, mu * k * x, mu * k * (x > 0)

        return model.with_part(laws.Fibre(axis, density))

    return Hidden(name="fibre_anisotropy", start=1.0, most=6.0, change=change, goal=RAW)


def two_branches(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Two Maxwell branches as strong as each other, whose time constants are six times apart."""
    tau = float(np.exp(rng.uniform(np.log(0.5 * scene.interval), np.log(2 * scene.interval))))

    def change(model: Model, g: float) -> Model:
        return model.with_part(Viscous(g * scene.mu, tau), Viscous(g * scene.mu, 6 * tau), steps=4)

    return Hidden(
        name="viscoelasticity", start=0.2, most=1.5, change=change, goal=(3.0, 20.0), details={"tau": [tau, 6 * tau]}
    )  # fmt: skip


def yielded_set(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share of what the largest strain so far was beyond a yield strain stays."""
    least = 0.5 * float(np.sqrt(scene.strain / 2))
    return Hidden(
        name="permanent_set", start=0.2, most=0.6, goal=(3.0, 20.0), details={"yield_strain": least},
        change=lambda model, share: model.with_part(Set(scene.mu, share, False, least=least), steps=SHORT),
    )  # fmt: skip


def healed_softening(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Mullins softening below the largest energy so far only, which the first loading does not show."""
    base, m = laws.neo_hookean(scene.mu, scene.lam), scene.mu / 2 * scene.strain * rng.uniform(0.3, 1.5)
    return Hidden(
        name="softening", start=0.3, most=0.8, goal=RAW,
        change=lambda model, d: model.with_part(Healed(base, d, m), steps=2 * SHORT),
    )  # fmt: skip


def soon_soft(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Mullins damage D = d (1 - exp(-w/w0)), which is done sooner than by w/(w + w0)."""
    base, w0 = laws.neo_hookean(scene.mu, scene.lam), scene.mu / 2 * scene.strain * rng.uniform(0.3, 1.5)
    return Hidden(
        name="softening", start=0.3, most=0.75, goal=RAW,
        change=lambda model, d: model.with_part(SoonDone(base, d, w0), steps=SHORT),
    )  # fmt: skip


def settling_shear(rng: np.random.Generator, scene: Scene) -> Hidden:
    """The shear modulus alone drifts, with the root of time."""
    base, last, way = laws.neo_hookean(scene.mu, 0 * scene.lam), float(scene.time[-1]), sign(rng)

    def change(model: Model, d: float) -> Model:
        return model.with_part(laws.Scaled(base, lambda t: way * d * np.sqrt(t / last) * np.ones_like(scene.mu)))

    return Hidden(name="stiffness_drift", start=0.2, most=0.6, change=change, details={"sign": way})


DRAWS = (fung_stiffening, cords, two_branches, yielded_set, healed_softening, soon_soft,
         settling_shear)  # fmt: skip
