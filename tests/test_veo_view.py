"""Pictures: all is inside the window, colours say what the numbers say, both renderers agree, films are whole."""

import subprocess

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest

from veo_ti import stage, view
from veo_ti.offscreen import can_render
from veo_ti.viewpoint import LENS_DEG, look_at


@pytest.fixture(params=["as this machine can", "in software"])
def renderer(request, monkeypatch):
    if request.param == "in software":
        monkeypatch.setattr(stage, "can_render", lambda: False)
    return request.param


def block(seed: int = 0) -> np.ndarray:
    """A bar of 120 points, 5 mm apart but for a little noise, (120, 3) [m]."""
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(4), np.arange(3), indexing="ij"), axis=-1).reshape(-1, 3)
    return 5e-3 * (grid + 0.05 * np.random.default_rng(seed).standard_normal(grid.shape))


def seen(at, x: np.ndarray) -> np.ndarray:
    """Pixels (N, 2), from the lower left, by a pinhole camera worked out here."""
    away = (x - (at.focus + at.distance * at.toward)) @ at.axes().T
    focal = at.size[1] / 2 / np.tan(np.deg2rad(LENS_DEG / 2))
    return np.array(at.size) / 2 - focal * away[:, :2] / away[:, 2:]


def picture(plotter, path) -> np.ndarray:
    return iio.imread(view.save_picture(plotter, path)).astype(float)


def frames(path) -> np.ndarray:
    """All frames of a film, shrunk to (F, 64, 64, 3)."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", path, "-vf", "scale=64:64"]
    raw = subprocess.run([*command, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, 64, 64, 3).astype(float)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("around", [False, True])
def test_object_fits_between_margins_title_and_bar(seed, around):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((300, 3)) * 10.0 ** rng.uniform(-3, 1, 3) + rng.standard_normal(3)
    at = look_at(x, up=rng.standard_normal(3), around=around)
    middle = (x.min(axis=0) + x.max(axis=0)) / 2
    for angle in [0.0, 1.0, 2.5, 4.0] if around else [0.0]:
        pixels = seen(at.turned(angle, middle), x)
        assert pixels.min() > 0 and (pixels.max(axis=0) < np.array(at.size) - [150, 60]).all()


def test_object_fills_its_room():
    pixels = seen(look_at(block()), block())
    extent = pixels.max(axis=0) - pixels.min(axis=0)
    assert 0.85 < max(extent / [1040, 780]) <= 1.001


def test_window_sizes_suit_video_codecs():
    assert all(n % 16 == 0 for x in (block(), block() * [1, 1, 30], block() * [30, 1, 1]) for n in look_at(x).size)


@pytest.mark.parametrize("limits", [(3.1, 17.0), (0.9, 1.1), (1.0, 1e4), (87.0, 93.0), (1e-4, 2e-3)])
@pytest.mark.parametrize("log", [True, False])
def test_ticks_are_few_and_inside_the_limits(limits, log):
    ticks = stage.ticks_of(limits, log=log)
    assert 2 <= len(ticks) <= 7 and (np.diff(ticks) > 0).all()
    assert ticks[0] >= limits[0] * (1 - 1e-6) and ticks[-1] <= limits[1] * (1 + 1e-6)


def test_colour_limits_are_never_empty():
    same = np.full(10, 3.0)
    for low, high in (stage.limits_of(same), stage.limits_of(same, log=True), stage.limits_of(0 * same, zero=True)):
        assert low < high


def test_stiff_half_is_yellow_and_soft_half_is_violet(renderer, tmp_path):
    x = block()
    stiff = x[:, 0] > np.median(x[:, 0])
    shot = picture(view.lame_map(x, np.where(stiff, 1e5, 1e3)), tmp_path / "mu.png")
    pixels = seen(look_at(x, pad=view.RADIUS * stage.spacing_of(x)), x).round().astype(int)
    _, green, blue = (shot[shot.shape[0] - 1 - pixels[:, 1], pixels[:, 0]]).T
    inner = np.abs(x[:, 0] - np.median(x[:, 0])) > 0.01
    assert (green > 1.3 * blue)[stiff & inner].mean() > 0.9
    assert (blue > 1.3 * green)[~stiff & inner].mean() > 0.9


def test_software_picture_matches_opengl(tmp_path, monkeypatch):
    if not can_render():
        pytest.skip("this machine has no OpenGL to compare with")
    x = block()
    hardware = picture(view.error_map(x, 1e3 * x[:, 0]), tmp_path / "hardware.png")
    monkeypatch.setattr(stage, "can_render", lambda: False)
    software = picture(view.error_map(x, 1e3 * x[:, 0]), tmp_path / "software.png")
    assert hardware.shape == software.shape
    paper = [(abs(shot - shot[0, 0]).max(axis=-1) < 8) for shot in (hardware, software)]
    assert (paper[0] != paper[1]).mean() < 0.01  # the silhouettes: the fonts and the edges' smoothing differ
    assert abs(hardware - software)[~paper[0] & ~paper[1]].mean() < 20  # of 255: the lights differ a little


def test_cut_shows_what_is_inside(renderer, tmp_path):
    x = block() * [1, 1, 1.5]
    core = (abs(x - x.mean(axis=0)) < 0.6 * (x.max(axis=0) - x.mean(axis=0))).all(axis=1)
    values = np.where(core, 1e5, 1e3)
    yellow = [
        ((shot[..., 0] > 1.5 * shot[..., 2]) & (shot[..., 1] > 100))[:, : shot.shape[1] - 170].sum()
        for shot in (picture(view.lame_map(x, values, inside=cut), tmp_path / f"{cut}.png") for cut in (False, True))
    ]
    assert yellow[1] > 2 * yellow[0] + 500


def test_strip_keeps_poses_apart_and_sensitivity_draws(renderer, tmp_path):
    y = np.stack([block(), block(1), block(2)])
    shot = picture(view.frames_strip(y, np.ones((3, 120)), label="mm", captions=["a", "b", "c"]), tmp_path / "s.png")
    rows = shot[120:-80, : -170]  # without title, captions and colour bar
    empty = (abs(rows - shot[0, 0]).max(axis=-1) < 8).all(axis=0)
    assert (np.diff(empty.astype(int)) == -1).sum() == 3
    assert picture(view.sensitivity_map(y[0], np.linspace(0, 1, 120)), tmp_path / "w.png").std() > 5


def test_films_have_every_frame(tmp_path):
    y = block() + np.linspace(0, 5e-3, 4)[:, None, None]
    walk = view.turntable(y[0], np.ones(120), tmp_path / "turn.mp4", frames=6, label="kPa", log=True)
    move = view.animation(y, 1e3 * (y - y[0])[..., 0], tmp_path / "move.mp4", label="mm", time=np.arange(4) / 10)
    assert [len(frames(walk)), len(frames(move))] == [6, 4]
    assert abs(frames(move)[0] - frames(move)[3]).mean() > 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["move.mp4", "turn.mp4"]


def test_interrupted_film_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(view, "image", interrupt)
    with pytest.raises(KeyboardInterrupt):
        view.turntable(block(), np.ones(120), tmp_path / "turn.mp4", frames=3)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("x", "values", "words"), [
    (block(), np.zeros(120), "values_pa must be positive; got 0.0"),
    (block(), np.ones(7), "values_pa must have shape"),
    (block()[:, :2], np.ones(120), "points must have shape"),
    (np.full((120, 3), np.nan), np.ones(120), "points must be finite"),
])
def test_bad_input_is_named(x, values, words):
    with pytest.raises(ValueError, match=words):
        view.lame_map(x, values)
