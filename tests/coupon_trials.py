"""Hidden-effect trials for coupons: textbook stresses with an effect drawn at random, noise, and a smooth error.

    python tests/coupon_trials.py 120 --seed 1000

prints what was planted against what was said. Stresses are written here mode by mode from textbooks and share no code
with the package; besides noise every curve has a wrong cross section and a slow wave, so that no law is exact.
"""

import argparse
from collections import Counter

import numpy as np

from veo_ti.coupons.curves import Coupon, Curve
from veo_ti.coupons.data import Data
from veo_ti.coupons.fit import fit
from veo_ti.coupons.laws import Reach, laws
from veo_ti.coupons.model import Model
from veo_ti.coupons.run import diagnose_coupon

LARGEST = {"UT": 5.0, "ET": 3.2, "PS": 4.0}
STRETCHED = {"UT": lambda x: x - x**-2, "ET": lambda x: x - x**-5, "PS": lambda x: x - x**-3}
I1 = {"UT": lambda x: x**2 + 2 / x, "ET": lambda x: 2 * x**2 + x**-4, "PS": lambda x: x**2 + 1 + x**-2}
I2 = {"UT": lambda x: 2 * x + x**-2, "ET": lambda x: x**4 + 2 * x**-2, "PS": lambda x: x**2 + 1 + x**-2}
BY_I2 = {"UT": lambda x: 1 / x, "ET": lambda x: x**2, "PS": lambda x: np.ones_like(x)}


def stress(mode, stretch, mu, by_I1=None, by_I2=None):
    """2 (x - x^-n) (W1 + q W2) for W1 = mu/2 f(I1 - 3), W2 = mu/2 g(I2), (n,) [Pa]."""
    first = 1.0 if by_I1 is None else by_I1(I1[mode](stretch) - 3)
    second = 0.0 if by_I2 is None else by_I2(I2[mode](stretch)) * BY_I2[mode](stretch)
    return mu * STRETCHED[mode](stretch) * (first + second)


def plant(effect, mode, stretch, mu, size):
    """The stress of a mode with an effect of a size between 0 (none) and 1 (large)."""
    if effect == "yeoh":
        return stress(mode, stretch, mu, lambda i: 1 + 0.08 * size * i)
    if effect == "gent":
        return stress(mode, stretch, mu, lambda i: 1 / (1 - (0.018 + 0.017 * size) * i))
    if effect == "fung":  # exponential: a stiffening that the catalogue does not hold
        return stress(mode, stretch, mu, lambda i: np.exp(0.06 * size * i))
    if effect == "mooney_rivlin":
        return stress(mode, stretch, mu, None, lambda i: 0.02 + 0.3 * size + 0 * i)
    if effect == "gent_thomas":
        return stress(mode, stretch, mu, None, lambda i: (0.3 + size) * 3 / i)
    if effect == "machine_compliance":
        give = 0.5 * size * (LARGEST[mode] - 1) / stress(mode, np.array(LARGEST[mode]), mu)
        own = np.linspace(1, LARGEST[mode], 4000)
        return np.interp(stretch, own + give * stress(mode, own, mu), stress(mode, own, mu))
    if effect == "gent_and_gent_thomas":
        return stress(mode, stretch, mu, lambda i: 1 / (1 - (0.018 + 0.017 * size) * i), lambda i: (0.3 + size) * 3 / i)
    if effect == "grip_slip":  # outside the catalogue: part of the specimen leaves the grip at once
        middle = 1 + 0.5 * (LARGEST[mode] - 1)
        return stress(mode, np.where(stretch > middle, 1 + (stretch - 1) * (1 - 0.4 * size), stretch), mu)
    if effect == "strain_offset":
        return stress(mode, np.maximum(stretch - 0.12 * size, 1.0), mu)
    return stress(mode, stretch, mu)


STIFF, SECOND = "strain_stiffening", "second_invariant"
TRUTH = {
    "nothing": (), "yeoh": (STIFF,), "gent": (STIFF,), "fung": (STIFF,), "mooney_rivlin": (SECOND,),
    "gent_thomas": (SECOND,), "machine_compliance": ("machine_compliance",), "strain_offset": ("strain_offset",),
    "gent_and_gent_thomas": (STIFF, SECOND), "grip_slip": ("outside",),
}  # fmt: skip


FORMS = {  # the parameter of the package's law that an effect of a size has
    "yeoh": lambda size: 0.04 * size, "gent": lambda size: 0.018 + 0.017 * size,
    "mooney_rivlin": lambda size: 0.02 + 0.3 * size, "gent_thomas": lambda size: 0.3 + size,
}  # fmt: skip


def draw(seed, effect=None, modes=None):
    """(effect, its size, noisy curves) of a seed."""
    random = np.random.default_rng(seed)
    effect = effect or random.choice([*TRUTH, "nothing"])
    drawn = [("UT",), ("UT", "PS"), ("UT", "ET", "PS")][random.integers(3)]
    size, mu, noise = random.uniform(0.4, 1.0), 10 ** random.uniform(4, 6), random.uniform(0.003, 0.02)
    curves = []
    for mode in modes or drawn:
        x = np.linspace(1.03, LARGEST[mode], random.integers(14, 40))
        P = plant(effect, mode, x, mu, size)
        wave = 0.01 * np.sin(random.uniform(0, 6) + 4 * np.log(x)) + 0.01 * random.normal()
        curves.append(Curve.of(mode, x, P * (1 + wave + noise * random.normal(size=len(x)))))
    return effect, size, curves


def trial(seed, effect=None, modes=None):
    """One hidden effect: (planted causes, effect, verdict, named causes, all names told, modes)."""
    effect, _, curves = draw(seed, effect, modes)
    modes = tuple(curve.mode for curve in curves)
    found = diagnose_coupon(Coupon(name="trial", curves=tuple(curves), crosshead=True), modes=modes).found
    told = [c.names for c in (found.best, *found.rivals)] if found.kind in ("named", "ambiguous") else []
    return TRUTH[effect], effect, found.kind, set(found.named), set().union(*told), modes


def covered(seed):
    """Whether the 95 % interval of a planted parameter, fitted with its own law, holds it."""
    effect, size, curves = draw(seed, list(FORMS)[seed % len(FORMS)])
    law = next(law for law in laws(Reach.of(curves)) if law.form == effect)
    found = fit(Model(causes=(law,)), Data.of(curves))
    return abs(found.theta[0] - FORMS[effect](size)) < 1.96 * found.sd[0]


def outcome(planted, kind, named, told):
    """What a verdict is worth; wrong is any name that was not planted."""
    if kind == "no_misfit":
        return "right" if not planted else "missed"
    if kind == "unexplained":
        return "unexplained"
    if named - set(planted):
        return "wrong"
    if named:
        return "right" if named == set(planted) else "one of two"
    return "ambiguous, truth inside" if told & set(planted) else "ambiguous, truth outside"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("trials", type=int)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    table: dict[str, Counter] = {}
    for seed in range(options.seed, options.seed + options.trials):
        planted, effect, kind, named, told, modes = trial(seed)
        result = outcome(planted, kind, named, told)
        table.setdefault(effect, Counter())[result] += 1
        if result in ("wrong", "ambiguous, truth outside"):
            print(f"seed {seed}: {effect} in {','.join(modes)}: {kind} {sorted(named)} of {sorted(told)}", flush=True)
    columns = [
        "right",
        "one of two",
        "ambiguous, truth inside",
        "unexplained",
        "missed",
        "ambiguous, truth outside",
        "wrong",
    ]
    print("| planted | trials | " + " | ".join(columns) + " |\n" + "|---" * (len(columns) + 2) + "|")
    for effect in TRUTH:
        row = table.get(effect, Counter())
        print(f"| {effect} | {sum(row.values())} | " + " | ".join(str(row[c]) for c in columns) + " |")
    inside = np.mean([covered(seed) for seed in range(options.seed, options.seed + options.trials)])
    total = sum(table.values(), Counter())
    print(f"| all | {sum(total.values())} | " + " | ".join(str(total[c]) for c in columns) + " |")
    print(f"95 % intervals of planted parameters hold them in {inside:.0%} of {options.trials}")


if __name__ == "__main__":
    main()
