# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Touch it, and look
#
# A reconstructed object gets a material, is pushed and pressed in ways nobody filmed, and is rendered in those states
# by its own radiance field: rays are bent by the moved points instead of a network (the paper's section "Rendering").
# `veo run RECORDING --out DIR` does all of this, learns the material from the filmed motion, and writes one page.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from recon.cameras import Camera, look_at
from recon.radiance.extraction import ExtractOptions
from recon.radiance.options import TrainOptions
from recon.radiance.storage import load_trained
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import lend_mattes
from veo_ti import Contact, Lame, Sphere, VirtualElasticObject, contact_alpha
from veo_ti.reconstruction.collider import collider_picture
from veo_ti.reconstruction.rerender import Rerenderer
from veo_ti.reconstruction.run import ReconstructChoice, reconstruct_folder
from veo_ti.store import read_sequence

# %% [markdown]
# ## A reconstruction of two frames
#
# Small and quick; the fourth notebook tells how it is made.

# %%
place = Path(tempfile.mkdtemp())
recording = place / "bunny"
make_rig(recording, RigOptions(cameras=10, frames=2, size=128, greys=False), lambda text: None)
lend_mattes(recording)
choice = ReconstructChoice(
    resolution=96,
    test=("cam0003",),
    train=TrainOptions(canonical_steps=350, motion_steps=50, samples=8192),
    extract=ExtractOptions(points=2000),
)
print(reconstruct_folder(recording, place / "out", choice)["sentence"])

# %% [markdown]
# ## A body of points with a material
#
# Here one stiffness for all of it. The push and the ball are terms of the energy.

# %%
cloud = read_sequence(place / "out/cloud.vtkhdf")
x = cloud.points[0]
spacing = np.median(np.sort(np.linalg.norm(x[:300, None] - x, axis=2))[:, 1])
thing = VirtualElasticObject(
    x=x,
    lame=Lame.from_young(2e4, 0.35).spread(len(x)),
    volume=np.full(len(x), spacing**3),
    fixed=cloud.static["fixed"].astype(bool),
    surface=cloud.static["surface"].astype(bool),
)
height = np.ptp(x[:, 1])
top = x[x[:, 1].argmax()]
pushed = thing.simulate(thing.push_at(top, np.array([[0.0, 0, 0], [1.0, 0, 0]]), 0.1 * height), frames=2)
radius = 0.14 * height
centre = top + np.array([0.0, 0.6 * radius, 0.0])
press = Contact(
    shape=Sphere(radius=radius),
    volume=thing.volume,
    alpha=contact_alpha(float(np.median(thing.lame.mu)), thing.cloud.spacing),
    position=top + np.array([[0, 1.05 * radius, 0], [0, 0.8 * radius, 0], [0, 0.6 * radius, 0]]),
)
pressed = thing.simulate(press, frames=3)
print(pushed.sentence, "|", pressed.sentence)

# %% [markdown]
# ## The same states as pictures
#
# The ball is drawn by tracing its signed distance; rays through the object end on it.

# %%
renderer = Rerenderer(trained=load_trained(place / "out/field.pt"), rest=x, spacing=thing.cloud.spacing)
middle = (x.min(axis=0) + x.max(axis=0)) / 2
eye = middle + height * np.array([0.8, 0.6, 2.4])
K = np.array([[190.0, 0, 64], [0, 190.0, 64], [0, 0, 1]])
camera = Camera(name="view", K=K, T_camera_world=look_at(eye, middle, np.array([0, 1.0, 0])), size=(128, 128))
blue = collider_picture(Sphere(radius=radius), centre, camera, (0.2, 0.45, 0.85))
pictures = {
    "as filmed": renderer.picture(x, camera),
    "pushed": renderer.picture(pushed.y[-1], camera),
    "pressed": renderer.picture(pressed.y[-1], camera, blue),
}
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6))
for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
    axis.imshow(picture.colour.clip(0, 1))
    axis.set_title(name)
    axis.axis("off")
plt.show()
