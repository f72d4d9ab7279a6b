"""The diagnosis of the beam's motion in one plain sentence."""

from veo_ti.beam_dynamics.hypotheses import CREEP, FITTINGS, HUNG
from veo_ti.beam_dynamics.run import BeamDiagnosis


def sentence(d: BeamDiagnosis) -> str:
    """What `diagnosis.json` and the page begin with."""
    j = d.judgement
    if j.kind == "no_misfit":
        return (
            "Nothing is wrong that these takes could show: the quasi-static beam is as close to the motion "
            f"({1e3 * j.baseline.sigma:.2g} mm) as to the settled poses ({1e3 * d.setting.tolerance:.2g} mm)."
        )
    if j.kind == "unexplained":
        return (
            f"The quasi-static beam is {1e3 * j.baseline.sigma:.2g} mm off, and no hypothesis explains most of it; "
            f"the nearest is {j.best.hypothesis.label}, with {j.explained:.0%}."
        )
    if j.kind == "ambiguous":
        return (
            f"The quasi-static beam is {1e3 * j.baseline.sigma:.2g} mm off; no single cause is beyond doubt, the "
            f"nearest hypothesis is {j.best.hypothesis.label}."
        )
    return f"{_told(d)}; {_gained(d)}{_left(d)}."


def _told(d: BeamDiagnosis) -> str:
    names = [e.name for e in d.judgement.named]
    parts = []
    if "inertia" in names:
        parts.append("what the quasi-static beam lacks is inertia" + (" with damping" if "damping" in names else ""))
    elif "damping" in names:
        parts.append("what the quasi-static beam lacks is damping")
    if "added_mass" in names and d.hung is not None:
        value, low, high = (1e3 * m for m in d.hung.bounds(HUNG.name))
        weighed = 1e3 * max(r.weight for r in d.data.releases)
        parts.append(
            f"the hung weight is a mass too, {value:.0f} g (95 %: {low:.0f} to {high:.0f}; weighed: {weighed:.0f})"
        )
    if "viscoelasticity" in names:
        g, tau = (d.judgement.best.values()[u.name] for u in CREEP)
        parts.append(f"the silicone creeps by {g:.0%} with a time constant of {tau:.2g} s")
    if "fittings" in names:
        parts.append(f"the tip carries {1e3 * d.judgement.best.values()[FITTINGS.name]:.2g} g more")
    text = "; ".join(parts)
    return text[0].upper() + text[1:]


def _gained(d: BeamDiagnosis) -> str:
    g = d.gain
    if g is None:
        return "no take was held out, so what knowing it gains was not measured"
    change = f"from {g.refit_only:.2g} to {g.after:.2g} mm"
    chance = "" if g.confirmed else ", which may be chance"
    return f"with it, the error on takes that no fit saw falls {change}{chance}"


def _left(d: BeamDiagnosis) -> str:
    open_ones = [q for q in d.judgement.questions if len(q.open) > 1]
    if not open_ones:
        return ""
    words = {"damping": "whether the damping works {}", "added_mass": "whether the weight acts {}"}
    return "; these takes cannot tell " + ", nor ".join(words[q.cause].format(" or ".join(q.open)) for q in open_ones)
