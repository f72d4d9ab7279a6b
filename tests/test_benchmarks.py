"""The benchmarks' peers compute the same as the simulator, and what is measured ends in one well-formed table."""

import numpy as np
import pytest
import sim_cases

from benchmarks import scene
from benchmarks.__main__ import FULL, QUICK
from benchmarks.fitting import problem
from benchmarks.hessian import hessian_rows, peers
from benchmarks.linear import linear_rows
from benchmarks.table import Row, markdown, report, skipped
from benchmarks.timing import interleaved, ratio
from sim.adam import fit_adam
from sim.basis import FitOptions
from sim.direct import DirectFactors, Layout
from sim.energy import Energy
from sim.newton import equilibrate

FRAMES = 5  # not a multiple of the floor's eight, more than the slow peers' four


@pytest.fixture(scope="module")
def energy() -> Energy:
    return scene.bar(200, FRAMES, contrast=10.0)


@pytest.fixture(scope="module")
def states(energy) -> np.ndarray:
    return scene.twisted(energy, FRAMES)


def test_every_peer_computes_the_same_hessian_product(energy, states):
    tangent = energy.elastic.tangent(states)
    p = np.random.default_rng(0).standard_normal(states.shape)
    ours, found = tangent.product(p), peers(tangent, p)
    assert {"numpy einsum", "scipy assembled"} <= set(found)
    for name, (job, result, count) in found.items():
        job()
        assert result().shape == (count, *p.shape[1:])
        assert np.abs(result() - ours[:count]).max() <= 1e-9 * np.abs(ours).max(), name


@pytest.mark.parametrize("name", ["Cholmod", "Superlu"])
def test_newton_with_a_direct_peer_reaches_our_equilibrium(energy, name):
    if name == "Cholmod":
        pytest.importorskip("cvxopt")
    from benchmarks import direct

    part, rest = energy.frames(np.array([1])), scene.at_rest(energy, 1)
    found = equilibrate(part, rest, solver=getattr(direct, name).of(energy)).require_converged()
    ours = equilibrate(part, rest).require_converged()
    assert sim_cases.relative(found.y - rest, ours.y - rest) < 1e-6
    assert found.iterations == ours.iterations


def test_cholmod_is_the_inverse_of_one_frame_after_another(energy, states):
    pytest.importorskip("cvxopt")
    from benchmarks.direct import Cholmod

    peer = Cholmod.of(energy)
    right = energy.free(np.random.default_rng(0).standard_normal(states.shape))
    for t in range(2):
        part = energy.frames(np.array([t])).tangent(states[t : t + 1])
        x = peer.preconditioner(part)(right[t : t + 1])
        exact = DirectFactors.of(part, Layout.of(energy.elastic))(right[t : t + 1])
        assert sim_cases.relative(x, exact) < 1e-8


def test_cholmod_gives_way_where_the_hessian_is_not_positive_definite(energy):
    pytest.importorskip("cvxopt")
    from benchmarks.direct import Cholmod

    part = energy.frames(np.array([0])).tangent((energy.elastic.cloud.x * [0.45, 1.0, 1.0])[None])
    assert isinstance(Cholmod.of(energy).preconditioner(part), DirectFactors)


def test_states_are_far_from_rest_and_their_hessians_positive_definite(energy, states):
    tangent = energy.tangent(states)
    for blocks in tangent.assembled(slice(0, FRAMES)):
        np.linalg.cholesky(Layout.of(energy.elastic).matrix(blocks).toarray())  # raises where it is not
    assert (np.abs(states - energy.elastic.cloud.x).max(axis=(1, 2)) > scene.SIZE[0] / 2).all()


def test_adam_goes_down_and_stops_when_told():
    energy, target = problem(150, 2)
    losses = []

    def proceed(loss: float) -> bool:
        losses.append(loss)
        return len(losses) < 5

    start = scene.at_rest(energy, 2)
    a = fit_adam(energy, target, start, rate=0.1, newton=FitOptions().newton, proceed=proceed)
    assert len(losses) == 5
    assert losses[-1] < 0.8 * losses[0]
    assert a.mu.shape == (energy.elastic.cloud.count,)


def test_peers_take_turns_and_warm_rounds_do_not_count():
    order = []
    seconds = interleaved({name: lambda name=name: order.append(name) for name in "ab"}, 3, warm=2)
    assert order == ["a", "b"] * 5
    assert all(len(s) == 3 for s in seconds.values())
    assert ratio(np.array([4.0, 6.0, 90.0]), np.array([2.0, 2.0, 2.0])) == 3.0


def test_rows_become_a_table_under_a_sentence_and_the_machine():
    rows = [Row(what="a", figure="2 x", target=">= 1 x", reached=True), skipped("b", "no g++", "<= 3 x")]
    text = report("How fast.", {"first": lambda: rows[:1], "second": lambda: rows[1:]}, note="small")
    sentence, note, machine, table = text.split("\n\n")
    assert note == "small"
    assert "cores" in machine and "numpy" in machine
    assert table == markdown(rows)
    assert table.splitlines()[2:] == ["| a | 2 x | >= 1 x | yes |", "| b | not measured: no g++ | <= 3 x |  |"]
    assert sentence == "How fast."


def test_measured_rows_fit_the_table():
    rows = hessian_rows(150, 2, 1) + linear_rows(150, 2, 1)
    assert [row.target for row in rows] == ["<= 3 x", ">= 8 x", ">= 5 x", "", "", ">= 2 x", ">= 15 x"]
    assert all(line.count("|") == 5 for line in markdown(rows).splitlines())
    assert all((row.reached is None) == ("not measured" in row.figure or not row.target) for row in rows)


def test_quick_run_measures_what_the_full_one_does():
    assert list(QUICK) == list(FULL)
