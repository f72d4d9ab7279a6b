"""The canonical stage: what several frames of an object at rest teach, beside the painted ellipsoid of the others."""

from dataclasses import replace

import numpy as np
from ellipsoid_scene import drawn, silhouette
from test_recon_radiance import MIDDLE, OPTIONS, TRAIN, cameras, views  # noqa: F401

from recon.quality.similarity import psnr
from recon.radiance.rendering import render
from recon.radiance.training import train


def test_several_frames_at_rest_teach_the_canonical_field_what_a_dim_first_one_hides(cameras, views, tmp_path):  # noqa: F811
    still = [np.repeat(v[:1], 4, axis=0) for v in views.images]
    for images in still:
        images[0] //= 2
    mattes = tuple(np.repeat(m[:1], 4, axis=0) for m in views.mattes)
    filmed = replace(views, times=np.arange(4) * 0.025, images=tuple(still), mattes=mattes)
    matte = silhouette(cameras[TRAIN], MIDDLE[0])
    target = drawn(cameras[TRAIN], MIDDLE[0], cameras[TRAIN].rays(cameras[TRAIN].grid())) / 255
    quality = []
    for frames in (1, 4):
        options = replace(OPTIONS, motion_steps=0, canonical_frames=frames)
        made = train(filmed, tmp_path / str(frames), options)
        quality.append(psnr(render(made.field, made.occupancy, cameras[TRAIN]).colour, target, matte))
    assert quality[1] > quality[0] + 2
