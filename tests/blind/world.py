"""One blind trial from a seed: a measurement in the observation format, and apart from it the truth.

Seeds below 1000 are for development, from 1000 on for judgement. The scene, the effect, its strength and the noise
draw from streams of their own, so that the same seed shows the same scene with and without an effect.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from blind import jets, of_loads, of_material, of_setting, other_causes, other_forms, other_laws, outside, tracking
from blind.hidden import Draw, Hidden
from blind.scenes import Model, Scene, draw_scene

CATALOGUE: dict[str, Draw] = {d.__name__: d for m in (of_material, of_loads, of_setting) for d in m.DRAWS}
OTHER: dict[str, Draw] = {d.__name__: d for m in (other_laws, other_forms, other_causes) for d in m.DRAWS}
OUTSIDE: dict[str, Draw] = {d.__name__: d for d in outside.DRAWS}
EFFECTS = {**CATALOGUE, **OTHER, **OUTSIDE}
PLAN = ("one", "one", "none", "one", "one", "outside", "one", "two", "one", "one", "none", "one", "outside", "one",
        "one", "two", "one", "none", "one", "outside")  # fmt: skip
MIXES = ("default", "nulls", "harsh", "strong", "two", "clear", "other")
CLEAR = (8.0, 30.0)  # goals, in units of noise, of one strong effect, and of two, of which neither is to drown
AIMED = ("strong", "two", "clear", "other")  # mixes whose effects all aim there
FIRST_JUDGED = 1000
BRISK = ("inertia", "rubber_inertia")  # effects that need frames in quick succession
ALONE = ("disconnection", "prestress")  # effects that change what others would be drawn on
TAKEN_UP = ("strain_stiffening", "volumetric_law", "fibre_anisotropy", "stiffness_drift", "follower_load",
            "hidden_tether", "hidden_contact", "support_compliance", *ALONE)  # by another stiffness, nearly or in part
TRIES = 4
ROUGHLY = 3  # times longer steps serve to find the amount


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """What the toolkit sees, and what it must not."""

    keys: dict[str, np.ndarray]  # the observation format
    truth: dict[str, object]  # plain values
    clean: np.ndarray  # (T, M, 3) [m] without noise
    plain: np.ndarray  # (T, M, 3) [m] without noise or effect

    def save(self, measurement: Path, truth: Path) -> None:
        """Two files that share nothing but the number of frames and points."""
        np.savez_compressed(measurement, **self.keys)
        np.savez_compressed(truth, clean=self.clean, plain=self.plain)


def plan(seed: int, mix: str) -> tuple[tuple[str, ...], str]:
    """The effects that a seed hides and its setting: effects take turns, so that all are met equally often.

    "strong": one, large before the stiffness takes up its part; "two": two of them, likewise; "clear": two that show
    beside any stiffness; "other": one of the catalogue by another law than any that the toolkit has,
    or one that is in no catalogue, nor in the other mixes.
    """
    rng = np.random.default_rng([seed, 3])
    if mix == "other":
        return (list(OTHER)[7 * seed % len(OTHER)],), "iid"
    kind = {"nulls": "none", "strong": "one", "two": "two", "clear": "two"}.get(mix, PLAN[seed % len(PLAN)])
    harsh = {"nulls": 0.5, "harsh": 1.0}.get(mix, 0.2)
    setting = str(rng.choice(tracking.SETTINGS[1:])) if rng.random() < harsh else "iid"
    rank = seed // len(PLAN) * PLAN.count(kind) + PLAN[: seed % len(PLAN)].count(kind)
    if kind == "one":
        rank = seed if mix == "strong" else rank
        return (list(CATALOGUE)[7 * rank % len(CATALOGUE)],), setting
    if kind == "outside":
        return (list(OUTSIDE)[5 * rank % len(OUTSIDE)],), setting
    if kind == "two":
        kept_out = (*BRISK, *(TAKEN_UP if mix == "clear" else ALONE))
        free = [name for name in CATALOGUE if name not in kept_out]
        return tuple(str(n) for n in rng.choice(free, size=2, replace=False)), setting
    return (), setting


def trial(
    seed: int, effect: str | tuple[str, ...] | None = None, *, size: str = "small", setting: str = "iid",
    strength: float | None = None, goal: tuple[float, float] | None = None, only: int | None = None,
) -> Trial:  # fmt: skip
    """A trial with the named effects ("" or () for none; None: as `plan` has it, the setting too).

    strength: the raw effect to aim at, in units of noise; else drawn from goal, or from what suits the effect. only:
    of all that were drawn, hide the one of this index alone, at the amount drawn for it.
    """
    if effect is None:
        effects, setting = plan(seed, "default")
    else:
        effects = (effect,) if isinstance(effect, str) and effect else tuple(effect)
    streams = [np.random.default_rng([seed, i]) for i in range(3)]
    scene = draw_scene(streams[0], size, brisk=bool(set(effects) & set(BRISK)))
    sigma = float(streams[0].uniform(1e-4, 5e-4))
    hidden = [EFFECTS[name](streams[1], scene) for name in effects]
    goals = [strength or float(np.exp(streams[1].uniform(*np.log(goal or h.goal)))) for h in hidden]
    hidden, goals = (hidden, goals) if only is None else ([hidden[only]], [goals[only]])
    amounts = [_amount(scene, h, aim * sigma) for h, aim in zip(hidden, goals, strict=True)]
    clean, amounts = _simulated(scene, hidden, amounts)
    plain = clean[0] + scene.plain_seen
    seen = tracking.tracked(streams[2], clean, sigma, setting, scene.built.spacing)
    scene = replace(scene, density=next((a for h, a in zip(hidden, amounts, strict=True) if h.density), scene.density))
    scale = float(np.exp(streams[2].uniform(-0.7, 0.7))) if setting == "force_scale" else 1.0
    # That gravity is stated must not tell that it matters, nor may it be missing where it does.
    stated = bool({h.name for h in hidden} & {"gravity_direction", "prestress"}) or streams[2].random() < 0.5
    keys = _keys(scene, seen, scale, clean[0], gravity=-of_loads.GRAVITY if stated else 0.0)
    raw = _rms(clean - plain, scene)
    truth = {
        "seed": seed, "size": size, "effects": [h.name for h in hidden],
        "outside": any(h.name not in CATALOGUE for h in hidden),
        "setting": {"name": setting, "force_scale": scale, **seen.details}, "sigma_mm": 1e3 * sigma,
        "raw_mm": 1e3 * raw, "raw_in_noise": raw / sigma, "shape": scene.built.shape.name,
        "planted": [
            {"name": h.name, "amount": a, "details": h.details or {}, "tells": h.tells(a)}
            for h, a in zip(hidden, amounts, strict=True)
        ],
    }  # fmt: skip
    return Trial(keys=keys, truth=truth, clean=clean, plain=plain)


def _rms(difference: np.ndarray, scene: Scene) -> float:
    return float(np.sqrt(np.mean(difference[1:, scene.counted] ** 2)))


def _amount(scene: Scene, hidden: Hidden, goal: float) -> float:
    """The amount whose raw effect is about `goal` [m] RMS: one secant from nothing through the start."""
    if hidden.name == "disconnection":
        return hidden.start  # cracks come in whole cells
    (clean, (amount,)) = _simulated(scene, [hidden], [hidden.start], hurry=ROUGHLY)
    size = _rms(clean - clean[0] - scene.plain_seen, scene)
    return float(np.clip(amount * goal / max(size, 1e-9), 0.05 * amount, hidden.most))


def _simulated(
    scene: Scene, hidden: list[Hidden], amounts: list[float], hurry: int = 1
) -> tuple[np.ndarray, list[float]]:
    """What is seen without noise, (T, M, 3) [m]; amounts are lowered, and steps in time shortened, until an equilibrium
    is found.

    hurry: time steps longer by so much, for a first look.
    """
    for shorter in range(1, TRIES + 1):
        model = Model.plain(scene)
        for h, amount in zip(hidden, amounts, strict=True):
            model = h.change(model, amount)
        model = replace(model, steps=max(1, shorter * model.steps // hurry))
        try:
            return model.seen(scene)[0], amounts
        except RuntimeError as error:
            amounts, failed = [0.6 * a for a in amounts], error
    raise RuntimeError(f"no equilibrium with {[h.name for h in hidden]}: {failed}")


def _keys(
    scene: Scene, seen: tracking.Tracked, scale: float, rest: np.ndarray, *, gravity: float
) -> dict[str, np.ndarray]:
    """The measurement as the observation format has it; nothing in it tells the effect."""
    built, shots = scene.built, [scene.program.at(float(t)) for t in scene.time]
    mesh = built.seen_mesh(rest)
    volume, forces = jets.volumes(mesh), scale * jets.lumped(mesh, shots) * built.surface[:, None]
    keys = {
        "points": seen.points.astype(np.float32), "forces": forces.astype(np.float32), "time": scene.time,
        "fixed": built.fixed, "surface": built.surface, "volume": volume, "mass": np.float64(
            scene.density * built.body.volume.sum()),
        "gravity": np.array([0, 0, gravity]),
        "nozzle_position": np.stack([s.position for s in shots]),
        "nozzle_direction": np.stack([s.direction for s in shots]),
        "nozzle_force": scale * np.array([s.force for s in shots]),
        "nozzle_footprint": np.float64(scene.program.footprint),
    }  # fmt: skip
    told = {} if scale == 1 else {"force_scale_known": False}
    return keys | told | ({} if seen.observed.all() else {"observed": seen.observed})
