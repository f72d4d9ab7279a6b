"""Print the tables of docs/coupons.md.

    python tests/make_coupon_tables.py

Measured data are read from $VEO_DATA (default ../shared/data).
"""

import os
from pathlib import Path

from veo_ti.coupons.predict import mooney_rivlin, r_squared, relative, rms, usual_mooney_rivlin
from veo_ti.coupons.reading import read_coupon
from veo_ti.coupons.run import diagnose_coupon
from veo_ti.coupons.sentence import words

DATA = Path(__file__).parents[1] / os.environ.get("VEO_DATA", "../shared/data")
KAWABATA, SKIN, ECO = (
    str(DATA / name)
    for name in (
        "rubber/Kawabata_1981.npz", "silicone_tensile/Dragon_Skin_10_MEDIUM.csv", "silicone_tensile/Ecoflex_00-30.csv",
    )
)  # fmt: skip
RUNS = (
    ("treloar", None, None), ("treloar", ["UT"], None), ("treloar", ["UT", "PS"], None), ("treloar", None, 3.0),
    (KAWABATA, None, None), (KAWABATA, ["UT"], None), (SKIN, None, None), (SKIN, None, 3.0), (ECO, None, None),
    (ECO, None, 8.0),
)  # fmt: skip


def main() -> None:
    """Both tables, in markdown."""
    verdicts, held = [], []
    for source, modes, up_to in RUNS:
        found = diagnose_coupon(read_coupon(source), modes=modes, up_to=up_to)
        fitted = ", ".join(modes) if modes else f"up to {up_to:g}" if up_to else "all"
        name = found.coupon.name.replace(" MEDIUM", "")
        verdicts.append(f"| {name} | {fitted} | {_verdict(found)} |")
        held += [f"| {name} | {_held(fold, curve)} |" for fold in found.folds for curve in fold.held]
    print("| data | fitted | verdict | law | Neo-Hookean leaves | law leaves | advice |\n" + "|---" * 7 + "|")
    print("\n".join(verdicts))
    head = "fitted | predicted | verdict | hold residual | refit only | named causes | R² | R² of Mooney-Rivlin"
    print(f"\n| data | {head} |\n" + "|---" * 9 + "|")
    print("\n".join(held))


def _verdict(found) -> str:
    kind, best = found.found.kind, found.found.best
    sets = [words(sorted(c.names - set(found.found.named))) for c in (best, *found.found.rivals)]
    told = words(found.found.named)
    beside = " or ".join(dict.fromkeys(s for s in sets if s)) if found.found.rivals or kind == "ambiguous" else ""
    cause = f"{kind}: {told}" if told else kind
    cause += (f"; beside it {beside}" if told else f": {beside}") if beside else ""
    advice = found.experiment.sentence if found.experiment else "-"
    left = [f"{c.fit.left:.1%}" for c in (found.found.baseline, best)]
    return f"{cause} | {best.name} | {left[0]} | {left[1]} | {advice}"


def _held(fold, curve) -> str:
    errors = {key: rms(relative(curve, p)) for key, p in fold.predicted(curve).items()}
    named = fold.found.kind == "named"
    after = f"{errors['after']:.1%}" if named else "none named"
    r2 = f"{r_squared(curve, fold.predicted(curve)['after']):.3f}" if named else "-"
    usual = r_squared(curve, mooney_rivlin(curve, *usual_mooney_rivlin(fold.train)))
    taught = ", ".join(f"{c.mode} to {c.stretch.max():.3g}" for c in fold.train)
    predicted = f"{curve.mode} {curve.stretch.min():.3g} to {curve.stretch.max():.3g}"
    shares = f"{errors['hold_residual']:.1%} | {errors['refit_only']:.1%} | {after}"
    return f"{taught} | {predicted} | {fold.found.kind} | {shares} | {r2} | {usual:.4g}"


if __name__ == "__main__":
    main()
