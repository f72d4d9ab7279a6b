"""Hidden effects of the catalogue in the material: its law, its memory, its age."""

import numpy as np

from blind import laws
from blind.hidden import SHORT, Hidden, sign, unit
from blind.history import Convolved, Damaged, Set, Viscous
from blind.scenes import Model, Scene

RAW = (6.0, 40.0)  # a change of stiffness swallows most of these


def strain_stiffening(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Yeoh's C2 (I - 3)^2 with C2 = mu beta/2, or Gent's law with J_m = 1/(2 beta), which begins alike."""
    form, mu = str(rng.choice(["yeoh", "gent"])), scene.mu

    def change(model: Model, beta: float) -> Model:
        part = laws.yeoh(mu * beta / 2) if form == "yeoh" else laws.gent(mu, 1 / max(2 * beta, 1e-9))
        return model.with_part(part)

    tells = (lambda beta: {"beta": beta}) if form == "yeoh" else (lambda beta: {})
    return Hidden(
        name="strain_stiffening", start=0.5 / scene.strain, most=8 / scene.strain, change=change, goal=RAW,
        details={"form": form}, tells=tells,
    )  # fmt: skip


def volumetric_law(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share w of another volume law."""
    form = str(rng.choice(["log", "simo"]))
    tells = (lambda w: {"share": w}) if form == "log" else (lambda w: {})
    return Hidden(
        name="volumetric_law", start=1.0, most=2.0, goal=RAW, details={"form": form}, tells=tells,
        change=lambda model, w: model.with_part(laws.volumetric(w * scene.lam, form)),
    )  # fmt: skip


def fibre_anisotropy(rng: np.random.Generator, scene: Scene) -> Hidden:
    """psi += mu k/2 (I4 - 1)^2 along any axis."""
    axis, mu = unit(rng), scene.mu

    def change(model: Model, k: float) -> Model:
        return model.with_part(laws.Fibre(axis, lambda I4, t: (mu * k / 2 * (I4 - 1) ** 2, mu * k * (I4 - 1), mu * k)))

    return Hidden(
        name="fibre_anisotropy", start=0.5, most=3.0, change=change, goal=RAW, details={"axis": axis.tolist()},
        tells=lambda k: {"stiffness": k},
    )  # fmt: skip


def viscoelasticity(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A Maxwell branch of the Green strain, or of the elastic shear stress, share g and any time constant."""
    form, mu = str(rng.choice(["strain", "stress"])), scene.mu
    tau = float(np.exp(rng.uniform(np.log(0.7 * scene.interval), np.log(0.25 * scene.time[-1]))))

    def change(model: Model, g: float) -> Model:
        branch = Viscous(g * mu, tau) if form == "strain" else Convolved(laws.neo_hookean(g * mu, 0 * mu), tau)
        return model.with_part(branch, steps=3)

    return Hidden(
        name="viscoelasticity", start=0.3, most=2.0, change=change, goal=(3.0, 20.0),
        details={"form": form, "tau": tau}, tells=lambda g: {"share": g, "time_constant": tau},
    )  # fmt: skip


def permanent_set(rng: np.random.Generator, scene: Scene) -> Hidden:
    """A share of the largest strain so far (or of its deviator) stays."""
    deviatoric = bool(rng.random() < 0.5)
    return Hidden(
        name="permanent_set", start=0.1, most=0.45, goal=(3.0, 20.0), details={"deviatoric": deviatoric},
        change=lambda model, share: model.with_part(Set(scene.mu, share, deviatoric), steps=SHORT),
        tells=(lambda share: {}) if deviatoric else (lambda share: {"share": share}),
    )  # fmt: skip


def softening(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Mullins damage up to the share d, half of it done at the energy of a typical large strain."""
    base = laws.neo_hookean(scene.mu, scene.lam)
    w0 = scene.mu / 2 * scene.strain * rng.uniform(0.3, 1.5)
    return Hidden(
        name="softening", start=0.3, most=0.75, goal=RAW,
        change=lambda model, d: model.with_part(Damaged(base, d, w0), steps=SHORT),
    )  # fmt: skip


def stiffness_drift(rng: np.random.Generator, scene: Scene) -> Hidden:
    """Everything stiffer or softer with time, evenly or settling."""
    base, last = laws.neo_hookean(scene.mu, scene.lam), float(scene.time[-1])
    form, way = str(rng.choice(["even", "settling"], p=[0.7, 0.3])), sign(rng)

    def grown(t: float) -> float:
        return t / last if form == "even" else float(np.expm1(-3 * t / last) / np.expm1(-3))

    def change(model: Model, d: float) -> Model:
        return model.with_part(laws.Scaled(base, lambda t: way * d * grown(t) * np.ones_like(scene.mu)))

    return Hidden(
        name="stiffness_drift", start=0.2, most=0.6, change=change, details={"form": form, "sign": way},
        tells=(lambda d: {"drift": way * d}) if form == "even" else (lambda d: {}),
    )  # fmt: skip


DRAWS = (strain_stiffening, volumetric_law, fibre_anisotropy, viscoelasticity, permanent_set, softening,
         stiffness_drift)  # fmt: skip
