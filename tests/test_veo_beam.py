"""The modulus of a marker-tracked body: recovered from finite elements, near incompressibility too, and real takes."""

import fem
import fem_scenes
import numpy as np
import pytest

from veo_ti.beam import DENSITY, GRAVITY, PUBLISHED, BeamModel, SettledTake, identify_beam, read_settled, settled_take
from veo_ti.beam_report import run_beam
from veo_ti.body import tie_markers
from veo_ti.markers import Interval, MarkedPose, identify_modulus, refined_limit, settle
from veo_ti.mocap import BeamTake, Markers

WEIGHT = 0.51012  # [N]
MIDDLE = np.array([[0.0, 0.015, 0.015]])  # of the free end [m]
# Displacement [m] of that point at E = 263 824 Pa, nu = .499 by mixed elements: python tests/make_beam_reference.py
MIXED = {0.0: (-0.2265e-3, 0.0, -6.7625e-3), WEIGHT: (-1.4623e-3, 0.0, -16.6269e-3)}


def finite_element_pose(model: BeamModel, young: float, poisson: float, markers: np.ndarray) -> MarkedPose:
    """The beam under gravity by quadratic hexahedra, seen through markers (M, 3) [m] inside it."""
    lower, size = np.array([-0.1, 0, 0]), (0.1, 0.03, 0.03)
    mu, lam = fem_scenes.lame_fields(fem_scenes.constant(young), poisson)
    body = fem.FemBody.build(fem.box_mesh(lower, lower + size, (8, 3, 3)), mu, lam, lambda x: x[:, 0] < -0.1 + 1e-9)
    u = fem.solve(body, body_force=(0, 0, -DENSITY * GRAVITY), steps=2)
    ties = tie_markers(model.cloud.x, markers)
    return MarkedPose(force=model.force(0.0), ties=ties, displacement=fem.displacement_at(body, u, markers))


def fitted(model: BeamModel, poses: list[MarkedPose], poisson: float) -> float:
    return identify_modulus(model.cloud, poses, fixed=model.fixed, poisson=poisson).young


def test_modulus_of_a_finite_element_beam_is_recovered():
    markers = np.array([[-0.002, 0.004, 0.026], [-0.003, 0.026, 0.015], [-0.03, 0.015, 0.004]])
    models = [BeamModel.of(count) for count in (500, 1000, 2000)]
    young = [fitted(m, [finite_element_pose(m, 2e5, 0.3, markers)], 0.3) for m in models]
    limit, sd = refined_limit([m.cloud.spacing for m in models], young)
    assert young[-1] == pytest.approx(2e5, rel=0.04)
    assert limit == pytest.approx(2e5, rel=0.025)
    assert sd < 0.03


def test_near_incompressibility_locks_coarse_clouds_and_refinement_undoes_it():
    models = [BeamModel.of(count, seed) for count, seed in ((1000, 0), (1000, 1), (2000, 0))]
    young = []
    for model in models:
        ties = tie_markers(model.cloud.x, MIDDLE)
        poses = [MarkedPose(force=model.force(w), ties=ties, displacement=np.array([u])) for w, u in MIXED.items()]
        young.append(fitted(model, poses, 0.499) / PUBLISHED)
    limit, sd = refined_limit([m.cloud.spacing for m in models], young)
    assert 0.85 < np.mean(young[:2]) < young[2] < 0.99
    assert limit == pytest.approx(1, abs=max(2 * sd, 0.03))


def test_modulus_of_the_models_own_motion_is_exact():
    model = BeamModel.of(300)
    force = np.stack([model.force(0.0), model.force(WEIGHT)])
    rest = np.repeat(model.cloud.x[None], 2, axis=0)
    y = settle(model.cloud, force, fixed=model.fixed, young=1.7e5, poisson=0.4, start=rest)
    ties = tie_markers(model.cloud.x, MIDDLE + np.array([0.006, 0, 0.02]))
    moved = [ties.positions(pose) - ties.positions(model.cloud.x) for pose in y]
    poses = [MarkedPose(force=f, ties=ties, displacement=u) for f, u in zip(force, moved, strict=True)]
    fit = identify_modulus(model.cloud, poses, fixed=model.fixed, poisson=0.4)
    assert fit.young == pytest.approx(1.7e5, rel=1e-4)
    assert fit.misfit < 1e-4


def test_influence_of_a_shift_is_what_a_refit_gives():
    model = BeamModel.of(300)
    ties = tie_markers(model.cloud.x, MIDDLE)
    seen, shift = np.array([[-0.3e-3, 0.0, -7e-3]]), np.array([[0.0, 0.0, -0.05e-3]])
    poses = [MarkedPose(force=model.force(0.0), ties=ties, displacement=seen + s * shift) for s in (-1, 0, 1)]
    below, fit, above = (
        identify_modulus(model.cloud, [pose], fixed=model.fixed, poisson=0.4) for pose in poses
    )
    assert np.log(above.young / below.young) / 2 == pytest.approx(fit.influence(shift), rel=0.03)
    assert fit.influence(shift) < 0  # a larger drop is a softer beam


def test_limit_of_a_quadratic_error_is_exact_and_interval_adds_squares():
    h = np.array([3e-3, 4e-3, 5e-3])
    limit, sd = refined_limit(h, 1e5 * np.exp(-2000 * h**2))
    assert limit == pytest.approx(1e5) and sd == pytest.approx(2000 * 9e-6 / 2)
    interval = Interval(value=100.0, parts={"a": 0.03, "b": 0.04})
    assert interval.bounds == pytest.approx((100 * np.exp(-0.1), 100 * np.exp(0.1)))
    with pytest.raises(ValueError, match="spacing must be of at least two clouds; got 1"):
        refined_limit([1e-3], [1e5])


def test_settled_take_overlooks_a_jump_at_the_start_and_the_motion_of_the_base():
    held = np.arange(18.0).reshape(6, 3) / 100
    p = np.repeat(held[None], 300, axis=0)
    p[:10, 3:] += 5e-4
    p[60:] += [1e-4, 0, -2e-4]
    p[60:, :3, 2] -= 7e-3
    p[60:, 4, 0] += 8e-4  # one base marker jumps
    markers = Markers(time=np.arange(300) / 100, positions=p, residual=np.zeros((300, 6)), labels=tuple("abcdef"))
    take = settled_take("gravity_V2_a", BeamTake(markers=markers, release_frame=50, rest_frames=40, tip_load=0.0))
    np.testing.assert_allclose(take.held, held[:3])
    np.testing.assert_allclose(take.displacement, np.tile([0, 0, -7e-3], (3, 1)), atol=1e-12)
    assert take.drop_mm == pytest.approx(-7) and take.kind == "gravity" and take.noise < 1e-12


def test_bad_input_is_one_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"folder must hold beam_\*\.npz takes"):
        read_settled(tmp_path)
    model = BeamModel.of(200)
    ties = tie_markers(model.cloud.x, MIDDLE)
    pose = MarkedPose(force=model.force(0.0), ties=ties, displacement=np.array([[0, 0, 1e-3]]))
    with pytest.raises(ValueError, match="displacement must follow the loads; got markers that move against them"):
        fitted(model, [pose], 0.4)
    with pytest.raises(ValueError, match="poses must hold at least one settled pose"):
        fitted(model, [], 0.4)


def test_weight_and_gravity_add_up():
    model = BeamModel.of(400)
    total = model.force(WEIGHT).sum(axis=0)
    assert total == pytest.approx([0, 0, -WEIGHT - DENSITY * GRAVITY * 9e-5], rel=1e-12)
    moment = (model.force(WEIGHT) - model.force(0.0))[:, 2] @ model.cloud.x
    assert moment == pytest.approx([0, -WEIGHT * 0.015, -WEIGHT * 0.03], abs=1e-12)


def test_real_beam_is_predicted_across_repeats_and_loads(measured):
    takes = read_settled(measured("beam_mocap"))
    result = identify_beam(takes, clouds={500: 2, 1000: 1, 1500: 1})
    low, high = result.young.bounds
    assert result.young.value == pytest.approx(PUBLISHED, rel=0.1)
    assert low < PUBLISHED < high and high / low < 1.4
    assert result.slope_error < 1e-3
    drop = {name: 1e3 * u[:, 2].mean() for name, u in result.predicted["all"].items()}
    for name in ("gravity_V2_b", "load52_V2_b"):  # repeats differ by 0.1 mm, the two loads want moduli 4 % apart
        assert drop[name] == pytest.approx(takes[name].drop_mm, abs=0.4)
    across = result.predicted["gravity_V2_a"]["load52_V2_a"], result.predicted["load52_V2_a"]["gravity_V2_a"]
    assert 1e3 * across[0][:, 2].mean() == pytest.approx(takes["load52_V2_a"].drop_mm, rel=0.07)
    assert 1e3 * across[1][:, 2].mean() == pytest.approx(takes["gravity_V2_a"].drop_mm, rel=0.07)


def test_run_on_the_beam_writes_numbers_pictures_and_a_page(measured, tmp_path):
    metrics = run_beam(measured("beam_mocap"), tmp_path / "out", clouds={150: 1, 300: 1})
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "metrics.json", "report.html", "tip_drop.png", "side_view.png", "refinement.png", "bent_beam.png"
    }  # fmt: skip
    assert metrics["tip_drop_mm"]["gravity_V2_a"]["measured"] == pytest.approx(-6.45, abs=0.01)
    assert metrics["error_mm"]["held_out"]["mean"] < 0.1 * metrics["error_mm_no_change"]["held_out"]["mean"]
    assert metrics["young_pa"]["published"] == PUBLISHED


def test_takes_of_one_loading_suffice(measured):
    takes: dict[str, SettledTake] = read_settled(measured("beam_mocap"))
    result = identify_beam({"gravity_V2_a": takes["gravity_V2_a"]}, clouds={150: 1, 300: 1})
    assert result.young.parts["repeats"] == 0 and result.young.parts["between loads"] == 0
