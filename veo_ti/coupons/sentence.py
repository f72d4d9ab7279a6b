"""A coupon's diagnosis in one plain sentence: what is wrong, what knowing it gained, what to measure next."""

from collections.abc import Sequence

from veo_ti.coupons.curves import NAMES, Curve, first_invariant, principal
from veo_ti.coupons.fit import SYSTEMATIC
from veo_ti.coupons.predict import Fold
from veo_ti.coupons.run import CouponDiagnosis

_BEYOND = 1.5  # times the I of the fit, beyond which a prediction is an extrapolation


def extrapolated(folds: Sequence[Fold]) -> bool:
    """Whether what was held out lies far beyond the strain of what was fitted."""

    def reach(curves: Sequence[Curve]) -> float:
        return max(float(first_invariant(principal(c.mode, c.stretch)).max()) for c in curves)

    return any(reach(f.held) > _BEYOND * reach(f.train) for f in folds)


def words(names: Sequence[str]) -> str:
    """Names as they are read."""
    return " and ".join(name.replace("_", " ") for name in names)


def sentence(diagnosis: CouponDiagnosis) -> str:
    """What `coupon.json` and the page begin with."""
    found = diagnosis.found
    if found.kind == "no_misfit":
        return (
            f"Nothing is wrong that these data could show: the Neo-Hookean law fits within their noise of "
            f"{max(found.data.level):.1%} and the {SYSTEMATIC:.1%} of the stress that such tests are off by."
        )
    if found.kind == "unexplained":
        left = found.baseline.fit.left
        return f"The Neo-Hookean law is off by about {left:.0%} of the stress, and no known cause explains most of it."
    if found.kind == "ambiguous":
        told = " or ".join(dict.fromkeys(words(sorted(c.names)) for c in (found.best, *found.rivals)))
        if not found.rivals:
            nearest = words(sorted(found.best.names))
            return (
                f"The Neo-Hookean law is wrong beyond noise; {nearest} would explain it, but {_modes(diagnosis)} are "
                "too few to prove it. Measure more points, or another mode."
            )
        wrong = f"The Neo-Hookean law is wrong beyond noise, and {_modes(diagnosis)} cannot tell the cause: {told}."
        return f"{wrong} {_next(diagnosis)}"
    return f"{_named(diagnosis)} {_gained(diagnosis)}{_besides(diagnosis)}"


def _modes(diagnosis: CouponDiagnosis) -> str:
    names = ", ".join(NAMES[c.mode] for c in diagnosis.train)
    return f"{names} data alone" if len(diagnosis.train) == 1 else f"{names} data"


def _named(diagnosis: CouponDiagnosis) -> str:
    found = diagnosis.found
    by_name = {c.name: c.sentence for c in found.best.fit.model.causes}
    left = found.best.fit.left
    rest = f"what is left is {left:.1%} of the stress"
    if left <= SYSTEMATIC:
        rest = f"no more is left than the {SYSTEMATIC:.1%} of the stress that such tests are off by"
    return f"{' '.join(by_name[name] for name in found.named)} With {found.best.name} {rest}."


def _gained(diagnosis: CouponDiagnosis) -> str:
    g = diagnosis.gain
    if g is None:
        return "Nothing was held out, so the gain was not measured."
    if not any(fold.found.kind == "named" for fold in diagnosis.folds):
        return "Without the held-out data no cause could be named, so none was judged on them."
    change = f"from {g.errors['refit_only']:.1%} (Neo-Hookean, refitted) to {g.errors['after']:.1%}"
    if g.confirmed:
        return f"On held-out data the error falls {change} of the stress."
    why = "; they lie far beyond the strain of the fit" if extrapolated(diagnosis.folds) else ""
    return f"On held-out data the error goes {change} of the stress, which is no proven gain{why}."


def _besides(diagnosis: CouponDiagnosis) -> str:
    found = diagnosis.found
    if not found.rivals:
        return ""
    open_names = [frozenset(c.names) - set(found.named) for c in (found.best, *found.rivals)]
    told = " or ".join(words(sorted(names)) for names in open_names if names)
    return f" What acts beside it, {told}, {_modes(diagnosis)} cannot tell. {_next(diagnosis)}"


def _next(diagnosis: CouponDiagnosis) -> str:
    e = diagnosis.experiment
    if e is None:
        return "No uniaxial, equibiaxial or pure shear test within the strain reached so far would tell them apart."
    return f"To tell them apart, {e.sentence}: the predictions differ there by {e.separation:.1f} standard deviations."
