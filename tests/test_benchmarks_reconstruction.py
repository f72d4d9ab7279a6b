"""The figures of a reconstruction: what is measured is what was planted, and both sizes measure the same."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction import FULL, QUICK, sections
from benchmarks.reconstruction_rows import (
    Filmed,
    Work,
    cloud_rows,
    correspondence_row,
    inside_of,
    judged,
    object_rows,
    stiffness_row,
    truth_row,
)
from recon.plush.reconstruction_writer import write_reconstruction
from recon.radiance.extraction import Cloud4D
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import lend_mattes
from sim.lame import Lame
from veo_ti.object import VirtualElasticObject
from veo_ti.observation_files import PLUSH_FRAME_RATE
from veo_ti.store import Sequence, writable_folder, write_sequence

OPTIONS = RigOptions(shape="pillow", cameras=7, frames=3, size=96, greys=False)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Filmed:
    folder = make_rig(tmp_path_factory.mktemp("rig") / "pillow", OPTIONS)
    lend_mattes(folder)
    return Filmed.of(folder, 48, ("cam0003",))


def worked(warped) -> Work:
    field = SimpleNamespace(warped=warped, from_first=lambda places: places)
    return Work(trained=SimpleNamespace(field=field), wall=1.0, cpu=2.0)


def percentages(figure: str) -> list[float]:
    return [float(v) for v in re.findall(r"\d+\.\d+", figure)]


def test_correspondence_is_measured_against_where_surface_points_truly_go(filmed):
    truth = filmed.truth
    still = correspondence_row(filmed, worked(lambda start, frames: start), "a", mean=1, median=None)
    off, _, moved, _ = percentages(still.figure)
    assert off == moved > 0

    def true(start, frames):
        return torch.from_numpy(truth.points[int(frames[0])][truth.surface].astype(np.float32))

    right = correspondence_row(filmed, worked(true), "a", mean=1e-6, median=1e-6)
    assert percentages(right.figure)[:2] == [0, 0]


def test_pictures_are_judged_on_the_objects_pixels(filmed):
    judges = filmed.judges
    exact = {c.name: i for c, i in zip(judges.cameras, judges.images, strict=True)}
    assert judged(filmed, lambda camera, frame: exact[camera.name][frame] / 255) == np.inf
    off = judged(filmed, lambda camera, frame: exact[camera.name][frame] / 255 + 0.1)
    assert off == pytest.approx(20)


def test_points_outside_the_body_are_counted_as_such(filmed):
    rest = filmed.truth.rest
    middle, size = rest.mean(axis=0), np.ptp(rest, axis=0)
    points = np.stack([middle, middle + size, rest[filmed.truth.surface][0]])
    assert inside_of(filmed.truth, points, slack=1e-5).tolist() == [True, False, True]
    moved = np.stack([filmed.truth.warp(points[[0, 2]], f) for f in range(3)])
    moved = np.concatenate([moved, np.repeat(points[None, 1:2], 3, axis=0)], axis=1)
    cloud = Cloud4D(points=moved, colours=np.zeros((3, 3)), surface=np.ones(3, bool), normals=np.zeros((3, 3)),
                    times=np.arange(3.0), spacing=1e-4)  # fmt: skip
    within, error = cloud_rows(filmed, cloud, "a")
    assert percentages(within.figure)[0] == pytest.approx(66.7) and not within.reached
    assert percentages(error.figure)[0] == 0 and error.reached


def test_tables_are_read_from_what_the_loop_found(tmp_path):
    write_reconstruction(tmp_path / "reconstruction", vertices=np.random.default_rng(0).random((2, 600, 3)),
                         colors=np.zeros((600, 3)), object_index=np.arange(600), fixed=np.arange(5))  # fmt: skip
    errors = {"held_out": {"mean": 0.5, "p95": 1.0, "max": 2.0}}
    found = {
        "material": {"error_mm": errors, "error_mm_homogeneous": errors, "error_mm_no_change": errors},
        "table_2": {"reconstructed": {"masked": {"psnr": 32.0}}, "simulated": {"masked": {"psnr": 31.5}}},
    }
    first, second = object_rows("leaf", found, tmp_path)
    assert "0.50, 1.00, 2.00 mm" in first.figure and second.reached is False


def test_points_are_held_against_the_truth_of_their_own_frame(filmed, tmp_path):
    """Simulated as is true, reconstructed 1 mm off; a fixed point, which is 1 m off, does not count."""
    rest = filmed.truth.rest[filmed.truth.surface][:50]
    frames = np.array([0, 2])
    true = np.stack([filmed.truth.warp(rest, f) for f in frames])
    off = true + np.array([0.001, 0.0, 0.0])
    off[:, 0] += 1.0
    static = {"x": rest, "surface": np.ones(50, bool), "fixed": np.arange(50) == 0}
    stored = Sequence(time=frames / PLUSH_FRAME_RATE, points=true, point_data={"observed": off}, static=static)
    write_sequence(writable_folder(tmp_path / "material") / "object.vtkhdf", stored)
    found = {"material": {"frames": {"held_out": [1], "training": [0]}}}
    assert truth_row("leaf", found, tmp_path, filmed.truth).figure == "0.00 and 1.00 mm"


def test_stiffness_is_compared_up_to_a_factor(filmed, tmp_path):
    truth = filmed.truth
    x, mu = truth.rest[::3], 7 * truth.mu[::3]
    file = writable_folder(tmp_path / "material") / "object.vtkhdf"

    def told(mu: np.ndarray) -> list[float]:
        obj = VirtualElasticObject(
            x=x, lame=Lame(mu=mu, lam=mu), volume=np.ones(len(x)), fixed=np.zeros(len(x), bool),
            surface=np.ones(len(x), bool),
        )  # fmt: skip
        static = {**obj.static, "log_mu_sd": np.full(len(x), 0.1)}
        write_sequence(file, Sequence(time=np.zeros(1), points=x[None], static=static))
        return list(map(float, re.findall(r"[\d.]+", stiffness_row("leaf", tmp_path, truth).figure)))

    agree, spans, given, hold = told(mu)
    assert agree == 1 and spans == pytest.approx(given, abs=0.11) and hold == 100
    off = np.where(np.arange(len(x)) % 4 == 1, 2 * 0.1, 0.0)
    assert told(mu * np.exp(off))[3] == pytest.approx(75, abs=1)  # by two of its standard deviations, every fourth


def test_quick_and_full_measure_the_same(tmp_path):
    assert list(sections(tmp_path, QUICK)) == list(sections(tmp_path, FULL))[: len(sections(tmp_path, QUICK))]
