"""Training: the same from the same seed, also when it was interrupted; what it cannot do ends in a sentence."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_recon_radiance import OPTIONS, cameras, filmed, views  # noqa: F401

from recon.radiance.fields import Box, Dynamic
from recon.radiance.run_state import Run
from recon.radiance.training import fingerprint, train

SHORT = replace(OPTIONS, canonical_steps=12, motion_steps=12, samples=512, cells=16)
to_the_bit = pytest.mark.skipif("config.getoption('--device') == 'cuda'", reason="a GPU adds up in any order")


@to_the_bit
def test_the_same_seed_gives_the_same_field(views, tmp_path):  # noqa: F811
    first, second = (train(views, tmp_path / name, SHORT).field.state_dict() for name in "ab")
    assert all((second[name] == value).all() for name, value in first.items())


@pytest.fixture()
def one_thread():
    """Sums of several threads may be rounded otherwise from run to run."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@to_the_bit
@pytest.mark.parametrize(("every", "cut", "begun"), [(8, 20, 16), (11, 23, 22)])  # before the mean, and amid it
def test_training_that_was_interrupted_ends_where_it_would_have(
    every, cut, begun, views, tmp_path, monkeypatch, one_thread,  # noqa: F811
):
    monkeypatch.setattr("recon.radiance.training._EVERY", every)
    whole = train(views, tmp_path / "whole", SHORT)

    def stop(step, *_):
        if step == cut:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(views, tmp_path / "cut", SHORT, watch=stop, look=1)
    steps = []
    again = train(views, tmp_path / "cut", SHORT, watch=lambda step, *_: steps.append(step), look=1)
    assert steps == list(range(begun + 1, 25))  # it went on from the last checkpoint
    for name, value in whole.field.state_dict().items():
        alike = torch.isclose(again.field.state_dict()[name], value, rtol=1e-3, atol=1e-4)
        assert alike.float().mean() > 0.98, name


def test_what_is_learnt_is_the_mean_of_the_last_states(views, tmp_path, monkeypatch):  # noqa: F811
    states, taken = [], Run.take_in

    def noted(run):
        states.append(run.model.canonical.encoding.table.detach().clone())
        taken(run)

    monkeypatch.setattr(Run, "take_in", noted)
    learnt = train(views, tmp_path, SHORT).field.canonical.encoding.table
    assert len(states) == 5  # the last fifth of 24
    assert torch.allclose(learnt, torch.stack(states).mean(dim=0), atol=1e-6)
    assert not torch.allclose(learnt, states[-1], atol=1e-4)


def test_a_change_in_any_frame_is_another_input(views):  # noqa: F811
    changed = views.images[1].copy()
    changed[1, 3, 3, 0] ^= 1
    other = replace(views, images=(views.images[0], changed, *views.images[2:]))
    assert fingerprint(other, SHORT) != fingerprint(views, SHORT) == fingerprint(views, replace(SHORT))
    assert fingerprint(views, replace(SHORT, cells=17)) != fingerprint(views, SHORT)


def test_a_training_that_diverges_is_told_not_hidden(views, tmp_path):  # noqa: F811
    wild = replace(SHORT, field_rate=1e38, canonical_steps=40)
    found = train(views, tmp_path, wild)
    assert found.status == "diverged" and "diverged 4 times" in found.sentence
    assert all(torch.isfinite(v).all() for v in found.field.state_dict().values())


def test_what_cannot_be_reconstructed_ends_in_a_sentence(cameras, views, tmp_path):  # noqa: F811
    with pytest.raises(ValueError, match="mattes must be there for every camera; make them first"):
        train(filmed(cameras[:3], mattes=False), tmp_path, SHORT)
    with pytest.raises(ValueError, match="cameras must be at least two; one alone shows no depth; got 1"):
        train(filmed(cameras[:1]), tmp_path, SHORT)
    black = replace(views, mattes=tuple(np.zeros_like(m) for m in views.mattes))
    with pytest.raises(ValueError, match="frame 0: mattes must show the object"):
        train(black, tmp_path, SHORT)
    model = Dynamic(Box(origin=np.zeros(3), side=1.0), 2, OPTIONS.field)
    with pytest.raises(ValueError, match="frame must be 0 to 1"):
        model(torch.rand(1, 3), torch.tensor([2]))
