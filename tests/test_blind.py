"""The blind trials' own simulator: laws against their energies, limits, an eigenvalue, another solver; and secrecy."""

import ast
from dataclasses import replace
from pathlib import Path

import fem
import numpy as np
import pytest
from blind import laws, world
from blind.body import Body
from blind.history import Viscous
from blind.jets import lumped, volumes
from blind.judging import outcome
from blind.of_setting import slowest_vibration
from blind.report import OUTCOMES, clopper_pearson, report
from blind.scenes import Model, Scene, draw_scene
from blind.solver import System, march, pattern_of
from blind.ties import Inertia
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh

from veo_ti.observation import Observation
from veo_ti.observation_files import OPTIONAL, REQUIRED


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The first sweep of a tiny scene."""
    drawn = draw_scene(np.random.default_rng(5), "tiny")
    return replace(drawn, time=drawn.time[:6])


@pytest.fixture(scope="module")
def made() -> world.Trial:
    """A tiny measurement with lost points."""
    return world.trial(12, "camera_scale", size="tiny", setting="missing")


def hidden(name: str, scene: Scene):
    return world.EFFECTS[name](np.random.default_rng(1), scene)


def strained(scene: Scene, seed: int, size: float) -> np.ndarray:
    return np.eye(3) + size * np.random.default_rng(seed).normal(size=(*scene.mu.shape, 3, 3))


def assert_slope(value, slope, step: float) -> None:
    """value(h) a number, slope its derivative at 0."""
    found = (value(step) - value(-step)) / (2 * step)
    assert found == pytest.approx(slope, rel=1e-5, abs=1e-7 * abs(value(0)) + 1e-12)


@pytest.mark.parametrize("name", world.EFFECTS)
def test_every_law_and_spring_derives_from_its_energy(name, scene):
    h = hidden(name, scene)
    model, t = h.change(Model.plain(scene), h.start), 0.37 * float(scene.time[-1])
    F, W = strained(scene, 0, 0.04), strained(scene, 1, 1.0) - np.eye(3)
    for part in model.parts:
        now = part.after(strained(scene, 2, 0.03), t / 2)
        assert_slope(lambda s, p=now: p.stress(F + s * W, t)[0].sum(), (now.stress(F, t)[1] * W).sum(), 1e-6)
        slope = np.einsum("eqijkl,eqkl,eqij->", now.tangent(F, t), W, W)
        assert_slope(lambda s, p=now: (p.stress(F + s * W, t)[1] * W).sum(), slope, 1e-6)
    u = 0.01 * np.random.default_rng(3).normal(size=model.built.body.nodes.shape)
    w = np.random.default_rng(4).normal(size=u.shape)
    for tie in model.ties:
        now = tie.after(0.3 * u, t / 2)
        _, g, H = now.respond(u, t)
        assert_slope(lambda s, tie=now: tie.respond(u + s * w, t)[0], (g * w).sum(), 1e-7)
        slope = np.einsum("nij,nj,ni->", H, w, w)
        assert_slope(lambda s, tie=now: (tie.respond(u + s * w, t)[1] * w).sum(), slope, 1e-8)


@pytest.mark.parametrize("name", world.EFFECTS)
def test_an_effect_of_no_strength_changes_nothing(name, scene):
    shown = hidden(name, scene).change(Model.plain(scene), 0.0).seen(scene)[0]
    assert np.abs(shown - shown[0] - scene.plain_seen).max() < 2e-6 * np.abs(scene.plain_seen).max() + 1e-8


@pytest.mark.parametrize("name", world.EFFECTS)
def test_an_effect_at_its_start_is_seen(name, scene):
    h = hidden(name, scene)
    if name in ("gravity_direction", "hidden_force", "inertia", "dry_friction"):
        h = replace(h, start=h.most)  # they may be small at first, or slow
    shown = h.change(Model.plain(scene), h.start).seen(scene)[0]
    assert np.abs(shown - shown[0] - scene.plain_seen).max() > 1e-6


def box(cells: tuple[int, int, int] = (4, 1, 1)) -> tuple[fem.FemBody, System]:
    """The same clamped bar on the other solver and on this one, with no load."""
    mesh = fem.box_mesh((0, 0, 0), (0.2, 0.05, 0.05), cells)

    def field(value: float):
        return lambda x: value * (1 + 2 * x[:, 0] / 0.2)

    other = fem.FemBody.build(mesh, field(8e3), field(3e4), lambda x: x[:, 0] < 1e-9)
    body = Body.of(mesh, mesh.p[0] < 1e-9, np.zeros(1, int), np.zeros((1, 27)))
    material = laws.neo_hookean(*(f(body.points.reshape(-1, 3)).reshape(body.weights.shape) for f in (
        field(8e3), field(3e4))))  # fmt: skip
    return other, System(body=body, parts=(material,), force=lambda u, t: np.zeros_like(u))


def test_statics_agree_with_the_other_finite_element_solver():
    other, system = box()
    assert np.allclose(other.nodes, system.body.nodes)
    pull = np.zeros_like(other.nodes)
    pull[other.nodes[:, 0] > 0.2 - 1e-9] = [0.02, -0.03, 0.01]
    expected = fem.solve(other, nodal_force=pull, steps=2)
    found = march(replace(system, force=lambda u, t: t * pull), np.array([0.0, 0.5, 1.0]))[-1]
    assert np.abs(expected).max() > 0.02
    assert found == pytest.approx(expected, abs=1e-6)


def test_a_viscous_branch_is_stiff_at_first_and_gone_after_a_long_hold():
    _, system = box()
    pull = np.zeros_like(system.body.nodes)
    pull[system.body.nodes[:, 0] > 0.2 - 1e-9] = [0, 0, 0.01]
    loaded, tau, c = replace(system, force=lambda u, t: (t > 0) * pull), 0.3, np.full_like(system.body.weights, 4e3)
    elastic = march(loaded, np.array([0.0, 1.0]))[-1]
    with_spring = replace(loaded, parts=(*loaded.parts, laws.Strain(c, np.zeros((*c.shape, 3, 3)))))
    stiff = march(with_spring, np.array([0.0, 1.0]))[-1]
    viscous = replace(loaded, parts=(*loaded.parts, Viscous(c, tau)))
    quick = march(viscous, np.array([0.0, 1e-5 * tau]))[-1]
    held = march(viscous, np.linspace(0, 40 * tau, 30))[-1]
    assert quick == pytest.approx(stiff, abs=2e-4 * np.abs(stiff).max())
    assert held == pytest.approx(elastic, abs=2e-5 * np.abs(elastic).max())
    assert np.abs(elastic).max() > 1.1 * np.abs(stiff).max()


def test_a_released_bar_rings_at_its_eigenfrequency_and_keeps_its_energy(scene):
    _, system = box()
    m = 100 * system.body.volume
    K = system.stiffness(np.zeros_like(system.body.nodes), 0.0)
    free = pattern_of(system.body).free
    values, vectors = eigsh(K, k=1, M=diags_array(np.repeat(m, 3)[free]).tocsc(), sigma=0)
    period = 2 * np.pi / np.sqrt(values[0])
    start = np.zeros(3 * len(m))
    start[free] = 1e-4 * vectors[:, 0] / np.abs(vectors).max()
    start = start.reshape(-1, 3)
    tip = np.abs(start).max(axis=1).argmax()
    way = start[tip] / np.linalg.norm(start[tip])
    times = period * np.arange(121) / 40
    mass = Inertia(m, 0.0, a=-values[0] * start)
    moved = march(replace(system, ties=(mass,)), times, start=start)[:, tip] @ way
    expected = moved[0] * np.cos(2 * np.pi * times / period)
    # the trapezoidal rule lengthens a period by (omega h)^2 / 12 = 0.2 %, 4 % of the amplitude after three
    assert moved == pytest.approx(expected, abs=0.05 * moved[0])
    assert np.abs(moved[-40:]).max() == pytest.approx(moved[0], rel=0.01)
    fixed = slowest_vibration(scene, scene.built.body.volume)
    M = diags_array(np.repeat(scene.built.body.volume, 3)[pattern_of(scene.built.body).free]).tocsc()
    K = System(body=scene.built.body, parts=Model.plain(scene).parts, force=None).stiffness(scene.plain[0], 0.0)
    assert fixed == pytest.approx(np.sqrt(eigsh(K, k=1, M=M, sigma=0)[0][0]), rel=0.02)


def test_the_nominal_load_and_volume_are_those_of_the_body(scene):
    body, built, shot = scene.built.body, scene.built, scene.program.at(float(scene.time[3]))
    acting = body.spread @ shot.pull(*body.facet_geometry(np.zeros_like(body.nodes)))
    rest = body.seen @ body.nodes
    nominal = lumped(built.seen_mesh(rest), [shot])[0]
    size = np.linalg.norm(acting.sum(0))
    assert size > 0
    assert np.linalg.norm(acting.sum(0) - nominal.sum(0)) < 0.05 * size
    turning = [np.cross(x, f).sum(0) for x, f in ((body.nodes, acting), (rest, nominal))]
    assert np.linalg.norm(turning[0] - turning[1]) < 0.05 * size * built.size
    assert volumes(built.seen_mesh(rest)).sum() == pytest.approx(body.volume.sum(), rel=0.02)


def test_a_seed_is_one_trial_and_shows_one_scene_whatever_is_hidden(made):
    again = world.trial(12, "camera_scale", size="tiny", setting="missing")
    nothing = world.trial(12, "", size="tiny", setting="missing")
    for key in made.keys:
        assert np.array_equal(made.keys[key], again.keys[key], equal_nan=True), key
    for key in made.keys.keys() - {"points"}:
        assert np.array_equal(made.keys[key], nothing.keys[key]), key
    assert np.array_equal(made.keys["points"][0], nothing.keys["points"][0])
    assert made.truth == again.truth
    assert nothing.truth["raw_mm"] < 1e-9


def test_a_measurement_holds_no_truth_and_can_be_read(made, tmp_path):
    made.save(tmp_path / "seen.npz", tmp_path / "truth.npz")
    with np.load(tmp_path / "seen.npz") as keys:
        assert set(keys) <= {*REQUIRED, *OPTIONAL} - {"sigma"}
    observation = Observation.load(tmp_path / "seen.npz")
    assert np.abs(observation.points[0] - made.clean[0]).max() < 1e-7
    off = (observation.points - made.clean)[1:][observation.observed[1:]]
    assert off.std() == pytest.approx(1e-3 * made.truth["sigma_mm"], rel=0.03)


@pytest.mark.parametrize("setting", world.tracking.SETTINGS)
def test_noise_is_as_large_as_the_setting_says(setting, made):
    sigma = 2e-4
    seen = world.tracking.tracked(np.random.default_rng(0), made.clean, sigma, setting, 0.02)
    off = (seen.points - made.clean)[1:][seen.observed[1:]]
    assert 1.4826 * np.median(np.abs(off)) == pytest.approx(sigma, rel=0.1)
    assert np.array_equal(seen.points[0], made.clean[0])
    assert seen.observed.all() == (setting != "missing")
    assert (np.linalg.norm(off, axis=1).max() > 4e-3) == (setting == "outliers")
    near = np.clip(off / sigma, -4, 4)
    again = (near * np.roll(near, 1, axis=0)).mean()  # of neighbours, which are numbered one after the other
    assert (again > 0.2) == (setting == "correlated")


def test_what_makes_a_trial_does_not_know_the_toolkit():
    for path in (Path(__file__).parent / "blind").glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
        names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        known = {name.split(".")[0] for name in names} & {"sim", "veo_ti", "recon"}
        assert path.name == "judging.py" or not known, f"{path.name} imports {known}"


CASES = {
    "right": (["inertia"], "named", ["inertia"]),
    "wrong name": (["inertia"], "named", ["softening"]),
    "extra name": (["inertia"], "named", ["inertia", "softening"]),
    "one of two": (["inertia", "softening"], "named", ["softening"]),
    "one of two, other inside": (["inertia", "softening"], "named", ["softening"], ["damping", "inertia"]),
    "ambiguous, truth inside": (["inertia"], "ambiguous", ["softening", "inertia"]),
    "ambiguous, without": (["swelling"], "ambiguous", ["softening", "inertia"]),
    "unexplained": (["swelling"], "unexplained", []),
    "missed": (["inertia"], "no_misfit", []),
    "silent": ([], "no_misfit", []),
}


@pytest.mark.parametrize("expected", CASES)
def test_outcomes(expected):
    effects, verdict, names, *either = CASES[expected]
    said = {"verdict": verdict, "named": names if verdict == "named" else [], "causes": [{"name": n} for n in names]}
    said["rounds"] = [{"verdict": "ambiguous" if either else verdict, "causes": either[0] if either else names}]
    assert outcome({"effects": effects}, said) == expected and expected in OUTCOMES


def test_report_of_errors_only_and_exact_bounds():
    assert clopper_pearson(0, 100)[1] == pytest.approx(1 - 0.025 ** (1 / 100))
    assert clopper_pearson(100, 100)[0] == pytest.approx(0.025 ** (1 / 100))
    record = {"seed": 1, "effects": ["inertia"], "setting": "iid", "outcome": "error"}
    assert "1 of them errors" in report([record], command="x")
