"""A recording as training wants it: the same directions, the object whole, one picture in memory, work done once."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from ellipsoid_scene import LENS, Scene, ring, silhouette, swaying

from recon.cameras import Camera
from recon.capture import Capture
from recon.crop import object_box, rough_matte, spread_images
from recon.images import Pictures
from recon.views import ViewOptions, training_views

FRAMES = 5


@pytest.fixture(scope="module")
def filmed() -> tuple[Scene, Capture]:
    """Three cameras and the ellipsoid, as arrays: no codec between truth and test."""
    scene, cameras = Scene(swaying(FRAMES)), ring(3)
    stacks = {camera.name: np.stack(list(scene.frames(camera))) for camera in cameras}
    sources = {name: Pictures(stack, f"{name}.mp4 ({name})") for name, stack in stacks.items()}
    return scene, Capture(cameras=cameras, times=np.arange(FRAMES) / 40, sources=sources)


def with_mattes(scene: Scene, capture: Capture) -> Capture:
    masks = {c.name: np.stack([255 * silhouette(c, m).astype(np.uint8) for m in scene.middle]) for c in capture.cameras}
    return replace(capture, mattes={name: Pictures(mask, f"mattes/{name}") for name, mask in masks.items()})


def of_directions(camera: Camera, rays: np.ndarray) -> np.ndarray:
    """A picture (height, width, 3) that is a smooth, bright function of where its pixels look."""
    local = rays @ camera.T_camera_world[:3, :3].T
    x, y = local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]
    return np.stack([120 + 150 * x, 120 + 120 * y, 130 + 100 * x * y], axis=-1).clip(50, 255)


def test_every_pixel_keeps_its_direction(tmp_path):
    camera = replace(ring(1, size=(160, 200), focal=260.0)[0], distortion=np.concatenate([LENS, [0.01, -0.02]]))
    picture = of_directions(camera, camera.rays(camera.grid())).round().astype(np.uint8)
    capture = Capture(cameras=(camera,), times=np.zeros(1), sources={camera.name: Pictures(picture[None], "a")})
    for resolution in (500, 100, 61):
        views = training_views(capture, tmp_path / str(resolution), ViewOptions(resolution=resolution))
        view, image, inside = views.cameras[0], views.images[0][0].astype(float), views.inside[0]
        assert len(view.distortion) == 0 and max(view.size) == min(resolution, 200)
        off = np.abs(image - of_directions(view, view.rays(view.grid())))[inside]
        assert inside.mean() > 0.9 and off.mean() < 0.5 and off.max() < 2


def test_inside_is_where_the_lens_showed_something(tmp_path):
    camera = replace(ring(1)[0], distortion=np.array([0.9, 0.3, 0, 0]))
    white = np.full((1, 96, 72, 3), 200, np.uint8)
    capture = Capture(cameras=(camera,), times=np.zeros(1), sources={camera.name: Pictures(white, "a")})
    views = training_views(capture, tmp_path, ViewOptions(resolution=96))
    view = views.cameras[0]
    shown = camera.project(view.centre + view.rays(view.grid()))[0]
    expected = ((shown >= 0) & (shown <= np.array(camera.size) - 1)).all(axis=-1)
    assert 0.5 < expected.mean() < 0.98
    assert (views.inside[0] == expected).mean() > 0.99
    assert (views.images[0][0][views.inside[0]] == 200).all()


@pytest.mark.parametrize("own", [False, True])
def test_the_object_is_whole_in_every_frame(tmp_path, filmed, own):
    scene, capture = filmed
    capture = with_mattes(scene, capture) if own else capture
    views = training_views(capture, tmp_path, ViewOptions(resolution=40))
    for view, stack in zip(views.cameras, views.images, strict=True):
        assert stack.shape == (FRAMES, view.size[1], view.size[0], 3) and max(view.size) <= 40
        wide = view.cropped(-20, -20, (view.size[0] + 40, view.size[1] + 40))
        for middle, image in zip(scene.middle, stack, strict=True):
            whole, shown = silhouette(wide, middle), silhouette(view, middle)
            assert whole.sum() == shown.sum() > 0.1 * shown.size
            assert (shown == (image.max(axis=2) > 40)).mean() > 0.97
    assert len(views.mattes) == (3 if own else 0)
    for matte, view in zip(views.mattes, views.cameras, strict=False):
        assert (silhouette(view, scene.middle[2]) == (matte[2] > 127)).mean() > 0.98


class Counted:
    """A source that knows how many of its pictures are alive, and can break."""

    def __init__(self, source: Pictures, stop: int | None = None):
        self.source, self.stop, self.alive, self.most, self.given = source, stop, 0, 0, 0
        self.count, self.size, self.fps, self.label = source.count, source.size, source.fps, source.label
        self.identity = source.identity

    def frames(self, start=0, stop=None):
        for number, image in enumerate(self.source.frames(start, stop)):
            if number == self.stop:
                raise ValueError(f"{self.label} must be a complete video; got no frame {number}")
            self.alive, self.given = self.alive + 1, self.given + 1
            self.most = max(self.most, self.alive)
            own = image.copy()
            weakref.finalize(own, self._gone)
            yield own
            del own

    def _gone(self):
        self.alive -= 1


def test_memory_holds_three_pictures_of_however_many(tmp_path, filmed):
    _, capture = filmed
    camera = capture.cameras[0]
    long = Counted(Pictures(np.repeat(capture.sources[camera.name].array, 30, axis=0), "a"))
    gc.collect()
    training_views(Capture(cameras=(camera,), times=np.arange(150.0), sources={camera.name: long}), tmp_path)
    assert long.most <= 3 and long.given <= 2 * 150


def test_work_is_done_once_and_goes_on_after_an_interruption(tmp_path, filmed):
    _, capture = filmed
    good = {name: Counted(source) for name, source in capture.sources.items()}
    bad = good | {"cam0002": Counted(capture.sources["cam0002"], stop=3)}
    with pytest.raises(ValueError, match=r"cam0002\.mp4 \(cam0002\) must be a complete video; got no frame 3"):
        training_views(replace(capture, sources=bad), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cam0001.json", "cam0001.npy"]
    first = good["cam0001"].given
    told = []
    views = training_views(replace(capture, sources=good), tmp_path, progress=told.append)
    assert good["cam0001"].given == first and good["cam0002"].given > 0 and told == ["cam0001", "cam0002", "cam0003"]
    given = {name: source.given for name, source in good.items()}
    again = training_views(replace(capture, sources=good), tmp_path)
    assert {name: source.given for name, source in good.items()} == given
    for a, b in zip(views.cameras, again.cameras, strict=True):
        np.testing.assert_array_equal(a.K, b.K)
    training_views(replace(capture, sources=good), tmp_path, ViewOptions(resolution=20))
    assert all(source.given > given[name] for name, source in good.items())
    smaller = training_views(replace(capture, sources=good), tmp_path, ViewOptions(resolution=20))
    assert max(smaller.cameras[0].size) == 20 == max(smaller.images[0].shape[1:3])


def test_box_follows_what_moves_and_stays_on_the_sensor():
    camera = replace(ring(1)[0], distortion=np.zeros(0))
    stack = np.zeros((100, 96, 72), np.uint8)
    stack[0, 5:15, 2:12], stack[99, 60:70, 30:40], stack[:, 90, 70] = 200, 200, 255  # the last is a dead pixel
    capture = Capture(cameras=(camera,), times=np.arange(100.0), sources={camera.name: Pictures(stack, "a")})
    box = object_box(capture, camera, margin=0.1)
    # 2..39 by 5..69 and a margin of 10 % of 65 pixels: 7; the left is cut off at 0
    assert (box.column, box.row) == (0, 0) and (box.width, box.height) == (47, 77)


def test_a_plate_replaces_black_cloth():
    plate = np.random.default_rng(0).integers(60, 200, (96, 72, 3), dtype=np.uint8)
    image = plate.copy()
    image[30:60, 20:50] = 255 - image[30:60, 20:50] // 2 * 2
    assert rough_matte(image).all()
    matte = rough_matte(image, plate)
    assert matte[32:58, 22:48].mean() > 0.6 and not matte[:27].any() and not matte[63:].any()


def test_few_pictures_are_taken_evenly_whichever_way_is_quicker():
    for count in (7, 1000):
        stack = np.arange(count).repeat(4).reshape(count, 2, 2)
        taken = [int(image[0, 0]) for image in spread_images(Pictures(stack, "a"), 4)]
        assert taken == [0, (count - 1) // 3, 2 * (count - 1) // 3, count - 1]


def test_faults_are_one_sentence_naming_file_and_camera(tmp_path, filmed):
    scene, capture = filmed
    stack = capture.sources["cam0002"].array
    cases = {
        r"b\.mp4 \(cam0002\) must have 5 frames as the others have; got 4": Pictures(stack[:4], "b.mp4 (cam0002)"),
        r"b\.mp4 \(cam0002\) must show cam0002 with 72 x 96 pixels as calibrated; got 70 x 96": Pictures(
            stack[:, :, 2:], "b.mp4 (cam0002)"
        ),
    }
    for words, source in cases.items():
        with pytest.raises(ValueError, match=words):
            replace(capture, sources={**capture.sources, "cam0002": source})
    black = {**capture.sources, "cam0002": Pictures(np.full_like(stack, 9), "b.mp4 (cam0002)")}
    with pytest.raises(ValueError, match=r"b\.mp4 \(cam0002\) must show something brighter than 32 of 255; got noth"):
        training_views(replace(capture, sources=black), tmp_path)
    own = with_mattes(scene, capture)
    empty = {**own.mattes, "cam0003": Pictures(np.zeros_like(own.mattes["cam0003"].array), "mattes/cam0003")}
    with pytest.raises(ValueError, match="mattes/cam0003 must show the object; got nothing"):
        training_views(replace(own, mattes=empty), tmp_path)
    del empty["cam0003"]
    with pytest.raises(ValueError, match="mattes must be there for all cameras or none; got cam0001, cam0002"):
        training_views(replace(own, mattes=empty), tmp_path)
    with pytest.raises(ValueError, match=r"cameras must include one of \('test',\)"):
        training_views(capture, tmp_path, ViewOptions(roles=("test",)))
    with pytest.raises(ValueError, match="camera must be one of the recording's 3; got cam9"):
        capture.image("cam9", 0)
