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
# # From pixels to a cloud in correspondence
#
# A synthetic rig films a soft bunny under an air jet; a radiance field learns what it looks like and how it moves;
# points are taken from it that can be followed through all frames. Everything here is small, so that it runs in a
# minute on a laptop: `veo rig`, `veo matte` and `veo reconstruct` do the same at full size.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from recon.radiance.extraction import ExtractOptions
from recon.radiance.options import TrainOptions
from recon.rig.make import make_rig
from recon.rig.options import RigOptions
from recon.rig.truth import lend_mattes, read_truth
from veo_ti.reconstruction.run import ReconstructChoice, reconstruct_folder
from veo_ti.store import read_sequence

# %% [markdown]
# ## The recording
#
# In the layout of the paper's dataset, with the truth beside it, which no reader but this notebook's last cell opens.
# We take the true mattes; `veo matte` would cut them out of the pictures.

# %%
place = Path(tempfile.mkdtemp())
recording = place / "bunny"
make_rig(recording, RigOptions(cameras=9, frames=4, size=112, greys=False), lambda text: None)
lend_mattes(recording)

# %% [markdown]
# ## Field and motion
#
# First the canonical state, then all frames; one camera judges and never teaches.

# %%
choice = ReconstructChoice(
    resolution=64,
    test=("cam0003",),
    train=TrainOptions(canonical_steps=200, motion_steps=250, samples=8192),
    extract=ExtractOptions(points=1500),
)
facts = reconstruct_folder(recording, place / "out", choice)
print(facts["sentence"])

# %%
plt.figure(figsize=(6, 8))
plt.imshow(plt.imread(place / "out/held_out.png"))
plt.title("held-out camera: rendered, filmed, difference x 4")
plt.axis("off")
plt.show()

# %% [markdown]
# ## The cloud against the truth
#
# The nearest true point at frame 0 tells where each point of the cloud should be when the object has moved most.

# %%
cloud, truth = read_sequence(place / "out/cloud.vtkhdf"), read_truth(recording)
gap = np.linalg.norm(cloud.points[0][:, None] - truth.points[0][None], axis=2)
near = gap.argmin(axis=1)
late = np.linalg.norm(truth.points - truth.points[0], axis=2).mean(axis=1).argmax()
moved, should = cloud.points[late] - cloud.points[0], truth.points[late][near] - truth.points[0][near]
diagonal = np.linalg.norm(np.ptp(truth.points[0], axis=0))
error = np.linalg.norm(moved - should, axis=1)
print(f"points follow the motion to {100 * error.mean() / diagonal:.2f} % of the diagonal on average;")
print(f"without any motion it would be {100 * np.linalg.norm(should, axis=1).mean() / diagonal:.2f} %")

# %%
plt.figure(figsize=(9, 3.5))
plt.imshow(plt.imread(place / "out/cloud.png"))
plt.title("the cloud from two sides, coloured and by how far it moves")
plt.axis("off")
plt.show()
