"""A diagnosis in one plain sentence: what is wrong, how big it is, and what knowing it gained."""

import numpy as np

from veo_ti.diagnosis.causes.base import Cause
from veo_ti.diagnosis.fitted import Refit
from veo_ti.diagnosis.rounds import SHORT, Round
from veo_ti.diagnosis.run import Diagnosis

_STRAY = 0.002  # share of stray positions from which they are mentioned
_READABLE = {"m": (1e3, "mm"), "rad": (180 / np.pi, "degrees"), "s": (1e3, "ms"), "-": (1.0, "")}


def sentence(diagnosis: Diagnosis) -> str:
    """What `diagnosis.json` and the page begin with."""
    told = {"named": _named, "ambiguous": _ambiguous, "unexplained": _unexplained, "no_misfit": _nothing}
    text = told[diagnosis.verdict.kind](diagnosis)
    if diagnosis.noise.outlier_share > _STRAY:
        text += f" Of the tracked positions {diagnosis.noise.outlier_share:.1%} are stray and were left out."
    if not diagnosis.finished:
        text += " What else may be wrong was not looked for to the end."
    known = diagnosis.identification.object.force_scale_known
    return text if known else f"{text} Forces are known up to scale only, so their sizes are relative."


def words(name: str) -> str:
    """A cause's name as it is read."""
    return name.replace("_", " ")


def amount(value: float, unit: str) -> str:
    """A value with its unit, both as people read them; SI in."""
    scale, readable = _READABLE.get(unit, (1.0, unit))
    return f"{scale * value:.3g} {readable}".strip()


def size(cause: Cause, theta: np.ndarray, ends: tuple[np.ndarray, np.ndarray]) -> str:
    """How big a cause is: the length of a vector of parameters, else each parameter with its 95 % interval."""
    names, units = [p.name for p in cause.parameters], [p.unit for p in cause.parameters]
    stems = {name.rpartition("_")[0] for name in names}
    if len(names) == 3 and len(set(units)) == len(stems) == 1:
        return f"{stems.pop()} {amount(float(np.linalg.norm(theta)), units[0])}"
    parts = zip(names, units, theta, *ends, strict=True)
    return ", ".join(f"{n} {_between(t, low, high, u)}" for n, u, t, low, high in parts)


def _between(value: float, low: float, high: float, unit: str) -> str:
    """A value with the ends of its interval."""
    bare, lowest = (amount(v, unit).split(" ")[0] for v in (value, low))
    if np.isclose(value - low, high - value):
        return f"{bare} ± {amount(high - value, unit)}"
    return f"{bare} ({lowest} to {amount(high, unit)})"


def place(refit: Refit) -> str:
    """Where, or along which axis, or with which time constant; nothing for causes that are everywhere."""
    return refit.cause.describe(refit.scene, refit.place)


def present(diagnosis: Diagnosis) -> tuple[Refit, ...]:
    """The named causes with the parameters that they have together, in order."""
    parts = {refit.cause.name: refit for refit in diagnosis.final.apart()} if diagnosis.named else {}
    return tuple(parts[candidate.name] for candidate in diagnosis.named)


def _of(refit: Refit) -> str:
    where = place(refit)
    return f"{', ' + where if where else ''} ({size(refit.cause, refit.theta, refit.interval)})"


def _named(diagnosis: Diagnosis) -> str:
    told = [refit.cause.sentence.rstrip(".") + _of(refit) for refit in present(diagnosis)]
    last, them = diagnosis.rounds[-1].verdict, "it" if len(told) == 1 else "them"
    if last.kind == "ambiguous":
        told.append(" or ".join(words(c.name) for c in last.causes) + ", which this measurement cannot tell apart")
        them = f"{them} and the first of these"
    left = "; something else is still wrong, and no known cause explains it" if last.kind == "unexplained" else ""
    short = " and ".join(words(c.name) for c in diagnosis.named if c.promised > SHORT * c.gained)
    unsure = f" The fit of {short} still promised more: how large it is, is less sure than said." if short else ""
    return f"{'; besides: '.join(told)}; {_gained(diagnosis, them)}{left}.{unsure}{_to_tell(diagnosis.rounds[-1])}"


def _gained(diagnosis: Diagnosis, them: str) -> str:
    g = diagnosis.gain
    if g is None:
        return "no frames were held out, so what knowing it gains was not measured"
    change = f"from {g.before_mm:.2g} to {g.after_mm:.2g} mm (noise: {g.noise_mm:.2g} mm)"
    if g.confirmed:
        return f"with {them}, the error on held-out frames falls {change}"
    return f"with {them}, the error on held-out frames goes {change}, which may be chance"


def _ambiguous(diagnosis: Diagnosis) -> str:
    told = [", or ".join(words(c.name) + _of(c.refit) for c in r.verdict.causes) for r in diagnosis.rounds]
    them = "the cause" if len(told) == 1 else "the causes, which are two"
    said = f"The simulation is wrong beyond noise, and this measurement cannot tell {them}: {'; besides: '.join(told)}."
    return said + "".join(map(_to_tell, diagnosis.rounds))


def _to_tell(found: Round) -> str:
    if found.experiment is None:
        return ""
    first, second = (words(c.name) for c in found.verdict.causes[:2])
    return f" To tell {first} from {second}, measure {found.experiment.description}."


def _unexplained(diagnosis: Diagnosis) -> str:
    tried = diagnosis.rounds[0].candidates
    nearest = max(tried, key=lambda c: c.explained, default=None)
    if nearest is None or nearest.explained <= 0:
        return "The simulation is wrong beyond noise, and no known cause explains it."
    return (
        "The simulation is wrong beyond noise, and no known cause explains it well enough; the nearest is "
        f"{words(nearest.name)}, with {nearest.explained:.0%} of what is wrong."
    )


def _nothing(diagnosis: Diagnosis) -> str:
    """With how far off it is: less than noise and the simulation's own error is not always as little as noise."""
    g = diagnosis.gain
    if g is None:
        return f"{diagnosis.verdict.sentence} The noise is {1e3 * diagnosis.noise.sigma:.2g} mm per coordinate."
    off = f"On held-out frames the simulation is off by {g.before_mm:.2g} mm (noise: {g.noise_mm:.2g} mm)."
    return f"{diagnosis.verdict.sentence} {off}"
