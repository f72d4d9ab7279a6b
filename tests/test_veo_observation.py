"""Observations: what is read is what was written, and every bad input is named in one sentence."""

import numpy as np
import pytest

from veo_ti.observation import Jet, Observation


def measured(frames: int = 5, points: int = 8) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    rest = rng.random((points, 3)) * 0.1
    moved = rest + 0.001 * rng.standard_normal((frames, points, 3))
    moved[0] = rest
    forces = rng.standard_normal((frames, points, 3))
    forces[0] = 0
    return {"points": moved, "forces": forces, "time": np.arange(frames) / 40, "fixed": np.arange(points) < 2}


def loaded(folder, keys):
    np.savez(folder / "take.npz", **keys)
    return Observation.load(folder / "take.npz")


def jet_keys(frames: int = 5) -> dict[str, np.ndarray]:
    push = np.where(np.arange(frames) > 0, 0.3, 0.0)
    direction = np.tile([0.0, 0.0, -1.0], (frames, 1))
    position = np.random.default_rng(1).random((frames, 3))
    names = ("nozzle_position", "nozzle_direction", "nozzle_force", "nozzle_footprint")
    return dict(zip(names, (position, direction, push, 0.01), strict=True))


def test_defaults_follow_the_format(tmp_path):
    o = loaded(tmp_path, measured())
    assert o.surface.all() and o.observed.all() and not o.handles.any() and not o.gravity.any()
    assert o.jet is None and o.volume is None and o.mass is None and o.sigma is None and o.held_out is None
    assert o.force_scale_known and o.name == "take"


@pytest.mark.parametrize("suffix", ["npz", "vtkhdf"])
def test_saving_and_loading_returns_every_field(tmp_path, suffix):
    rng = np.random.default_rng(2)
    extra = {
        "volume": rng.random(8) + 1, "mass": 0.2, "gravity": [0, 0, -9.81], "handles": np.arange(8) == 5,
        "surface": np.arange(8) > 2, "observed": rng.random((5, 8)) > 0.2, "sigma": rng.random((5, 8)) + 1,
    }  # fmt: skip
    before = loaded(tmp_path, measured() | extra | jet_keys())
    before.save(tmp_path / f"again.{suffix}")
    after = Observation.load(tmp_path / f"again.{suffix}")
    for name in (*measured(), *extra):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name, strict=True)
    for name in ("position", "direction", "force", "footprint"):
        np.testing.assert_array_equal(getattr(after.jet, name), getattr(before.jet, name))


def test_only_the_native_file_keeps_what_the_npz_format_lacks(tmp_path):
    held = np.array([False, False, True, False, False])
    o = Observation(**measured(), force_scale_known=False, held_out=held, name="leaf")
    back = Observation.load(o.save(tmp_path / "a.vtkhdf"))
    assert not back.force_scale_known and back.name == "leaf"
    np.testing.assert_array_equal(back.held_out, held)
    with pytest.raises(ValueError, match=r"path must end in \.vtkhdf"):
        o.save(tmp_path / "a.npz")


def test_the_npz_format_may_say_that_forces_are_known_to_scale_only(tmp_path):
    for known in (True, False):
        path = Observation(**measured(), force_scale_known=known).save(tmp_path / f"{known}.npz")
        assert Observation.load(path).force_scale_known is known
        assert ("force_scale_known" in np.load(path)) is not known  # silence means known, as in files of others
    with pytest.raises(ValueError, match="force_scale_known must have shape"):
        Observation(**measured(), force_scale_known=np.ones(2, bool))


def test_forces_may_come_from_the_jet_alone(tmp_path):
    keys = measured() | jet_keys()
    del keys["forces"]
    o = loaded(tmp_path, keys)
    assert o.forces is None and o.jet.force[1] == 0.3


def test_lost_points_take_their_reference_place_and_need_a_flag(tmp_path):
    keys = measured()
    keys["points"][2, 3] = np.nan
    with pytest.raises(ValueError, match=r"points must be finite wherever `observed` is true; got 1 NaN .*\(2, 3\)"):
        loaded(tmp_path, keys)
    o = loaded(tmp_path, keys | {"observed": np.arange(40).reshape(5, 8) != 2 * 8 + 3})
    np.testing.assert_array_equal(o.points[2, 3], keys["points"][0, 3])
    keys["points"][0, 3] = np.nan
    with pytest.raises(ValueError, match=r"points\[0\] must be finite"):
        loaded(tmp_path, keys | {"observed": np.zeros((5, 8), bool)})


def changed(**values):
    return lambda keys: keys | values


def without(*names):
    return lambda keys: {name: value for name, value in keys.items() if name not in names}


def scaled(name, factor):
    return lambda keys: keys | {name: factor * keys[name]}


BAD = {
    "unknown key": (changed(pionts=1), r"keys must be among points, time, .*; got pionts"),
    "missing key": (without("fixed"), "keys must include fixed; got forces, points"),
    "no load": (without("forces"), "forces must be given where no jet"),
    "half a jet": (changed(nozzle_force=np.zeros(5)), "jet whole or not at all; got no nozzle_position"),
    "rank 2": (changed(points=np.ones((8, 3))), r"points must have shape \(frames, points, 3\); got \(8, 3\)"),
    "wrong shape": (changed(forces=np.ones((5, 4, 3))), r"forces must have shape \(5, 8, 3\); got \(5, 4, 3\)"),
    "NaN force": (scaled("forces", np.nan), "forces must be finite; got 120 NaN"),
    "millimetres": (scaled("points", 1e3), r"got an object 9[\d.]+ m across, which looks like millimetres"),
    "all fixed": (changed(fixed=np.ones(8, bool)), "fixed must leave some points free; got all 8"),
    "nothing held": (changed(fixed=np.zeros(8, bool)), "rigid motion; got no fixed point and no handle"),
    "time stands still": (changed(time=[0, 1, 1, 2, 3]), "time must increase .*; got no increase at frame 2"),
    "frame 0 loaded": (changed(forces=np.ones((5, 8, 3))), "forces must be zero in frame 0.*at points 0, 1, 2, 3, 4"),
    "no force at all": (scaled("forces", 0), "forces must be non-zero in some frame"),
    "one frame": (lambda k: {n: v if n == "fixed" else v[:1] for n, v in k.items()}, "at least 2 frames"),
    "twins": (lambda k: k | {"points": k["points"][:, [0, 1, 2, 3, 4, 5, 6, 2]]}, "duplicates at points 2, 7"),
    "nothing compared": (changed(surface=np.arange(8) < 2), "surface must include at least one free point"),
    "negative volume": (changed(volume=np.arange(8) - 1.0), r"volume must be positive; got -1\.0"),
    "zero mass": (changed(mass=0.0), r"mass must be positive; got 0\.0"),
    "two masses": (changed(mass=np.ones(2)), r"mass must have shape \(1\); got \(2,\)"),
    "slanted": (changed(**jet_keys() | {"nozzle_direction": np.ones((5, 3))}), "nozzle_direction must have length 1"),
    "words": (changed(points=np.full((5, 8, 3), "x")), "points must be an array of numbers"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_sentence(tmp_path, case):
    change, sentence = BAD[case]
    with pytest.raises(ValueError, match=sentence) as caught:
        loaded(tmp_path, change(measured()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("keep", [0, 3, 200, 0.5, 0.99])
def test_truncated_file_is_named(tmp_path, keep):
    np.savez(tmp_path / "a.npz", **measured())
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(whole[: int(keep * len(whole)) if keep < 1 else keep])
    with pytest.raises(ValueError, match=r"file must be a complete \.npz of plain arrays; got .*a\.npz"):
        Observation.load(tmp_path / "a.npz")


def test_flipped_bytes_and_pickles_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", **measured())
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[600:640] = bytes(40)
    (tmp_path / "a.npz").write_bytes(data)
    np.savez(tmp_path / "b.npz", **measured() | {"mass": np.array([{}], dtype=object)})
    for name in ("a.npz", "b.npz"):
        with pytest.raises(ValueError, match=r"file must be a complete \.npz of plain arrays"):
            Observation.load(tmp_path / name)


def test_inputs_that_are_no_observation_are_named(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.csv").write_text("1,2")
    (tmp_path / "a.vtkhdf").write_text("not hdf5")
    cases = {
        "nowhere.npz": "input must exist",
        "empty": "input must be a PLUSH object folder",
        "a.csv": "input must be .npz",
    }
    for name, sentence in (cases | {"a.vtkhdf": r"file must be a complete \.vtkhdf"}).items():
        with pytest.raises(ValueError, match=sentence):
            Observation.load(tmp_path / name)


def test_frames_pick_every_changing_array():
    sigma = np.random.default_rng(3).random((5, 8)) + 1
    position, direction, force, footprint = jet_keys().values()
    jet = Jet(position=position, direction=direction, force=force, footprint=footprint)
    o = Observation(**measured(), sigma=sigma, jet=jet, held_out=np.arange(5) == 4)
    chosen = o.frames([3, 4])
    for name in ("points", "forces", "time", "observed", "sigma", "held_out"):
        np.testing.assert_array_equal(getattr(chosen, name), getattr(o, name)[3:])
    np.testing.assert_array_equal(chosen.jet.position, position[3:])
    assert chosen.fixed is o.fixed or (chosen.fixed == o.fixed).all()
    assert len(o.frames(o.time > 0.05).time) == 2 and len(o.frames(slice(2)).time) == 2
    with pytest.raises(ValueError, match="index must choose among 5 frames"):
        o.frames([7])


@pytest.mark.parametrize("frames", [2, 3, 4, 5, 9, 17, 49, 50, 200])
@pytest.mark.parametrize("every", [2, 4, 7])
def test_split_holds_out_blocks_and_keeps_the_reference(frames, every):
    train, held = Observation(**measured(frames)).split(every)
    assert train[0] == 0 and sorted([*train, *held]) == list(range(frames))
    assert abs(len(held) - (frames - 1) / every) <= 1
    assert len(held) >= 1 or frames == 2
    blocks = np.count_nonzero(np.diff(held) > 1) + 1
    assert blocks <= 4 and (frames < 17 or every > 4 or blocks == 4 or every == 2)


def test_split_uses_the_measurements_own_choice():
    o = Observation(**measured(), held_out=np.array([True, False, True, True, False]))
    np.testing.assert_array_equal(o.split()[1], [2, 3])
