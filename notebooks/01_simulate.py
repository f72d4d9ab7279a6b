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
# # Simulate a soft body
#
# A soft bar is filled with points, clamped at one end, and then loaded in three ways: its own weight, a push, and a
# ball that presses on it. Everything is in SI units. The simulator minimises the Neo-Hookean energy of the points plus
# the energy of each load; a new interaction is one more term in the list.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from veo_ti import Contact, Lame, Sphere, VirtualElasticObject, contact_alpha, frames_strip, sample_box, save_picture

# %% [markdown]
# ## The body
#
# `sample_box` spreads points evenly; `sample_mesh` does the same for a closed mesh file. The reference pose is free of
# stress and of gravity.

# %%
LENGTH, WIDTH = 0.12, 0.03  # m
YOUNG, POISSON, DENSITY = 1e5, 0.1, 1000.0  # Pa, -, kg/m3

body = sample_box((LENGTH, WIDTH, WIDTH), 2000)
bar = VirtualElasticObject(
    x=body.x,
    lame=Lame.from_young(YOUNG, POISSON).spread(len(body.x)),
    volume=body.volume,
    surface=body.surface,
    fixed=body.x[:, 0] < 1e-9,
    mass=DENSITY * LENGTH * WIDTH**2,
)
tip = np.linalg.norm(bar.x - [LENGTH, WIDTH / 2, WIDTH / 2], axis=1).argsort()[:12]
print(f"{len(bar.x)} points, spacing {1e3 * body.spacing:.1f} mm, {bar.fixed.sum()} of them clamped")

# %% [markdown]
# ## Gravity, in growing strength, solved together
#
# Terms carry one row for each frame. Four strengths of gravity are four frames of one batch.

# %%
strength = np.array([0.1, 1.0, 2.0, 3.0])
gravity = bar.under_gravity(strength[:, None] * [0, 0, -9.81])
sagged = bar.simulate(gravity).require_converged()
drop = (bar.x - sagged.y)[:, tip, 2].mean(axis=1)
print(sagged.sentence)
for g, d in zip(strength, drop, strict=True):
    print(f"gravity x {g:4.2f}: the tip drops {1e3 * d:6.2f} mm, {100 * d / LENGTH:4.1f} % of the length")

# %%
FOLDER = Path(tempfile.mkdtemp())


def show(plotter):
    """Draw without a display and put the picture into the notebook."""
    picture = plt.imread(save_picture(plotter, FOLDER / "picture.png"))
    plt.figure(figsize=(12, 12 * picture.shape[0] / picture.shape[1]), layout="tight")
    plt.imshow(picture)
    plt.axis("off")
    plt.show()


def displacement_strip(y, captions):
    """Poses side by side, coloured by how far each point moved."""
    moved = 1e3 * np.linalg.norm(y - bar.x, axis=2)
    return frames_strip(y, moved, label="mm", captions=captions, title="Displacement")


show(displacement_strip(sagged.y, [f"gravity x {g:g}" for g in strength]))

# %% [markdown]
# ## A push
#
# Some tens of millinewtons at the tip, from the side, added to gravity.

# %%
push = bar.push_at(np.array([LENGTH, 0.0, WIDTH / 2]), np.array([[0, 0.05, 0], [0, 0.15, 0]]), radius=0.006)
weight = bar.under_gravity(np.tile([0, 0, -9.81], (2, 1)))
pushed = bar.simulate(weight, push, start=sagged.y[[1, 1]]).require_converged()
show(displacement_strip(pushed.y, ["50 mN", "150 mN"]))

# %% [markdown]
# ## A ball presses on it
#
# The ball goes where it is told; the bar gives way. Its force on the bar is minus the gradient of its energy.

# %%
RADIUS = 0.015
depth = np.array([0.002, 0.006, 0.012])
ball = Contact(
    shape=Sphere(radius=RADIUS),
    volume=bar.volume,
    alpha=contact_alpha(float(bar.lame.mu.mean()), bar.cloud.spacing),
    position=np.stack([np.full(3, 0.8 * LENGTH), np.full(3, WIDTH / 2), WIDTH + RADIUS - depth], axis=1),
)
pressed = bar.simulate(ball, frames=3).require_converged()
show(displacement_strip(pressed.y, [f"pressed {1e3 * d:.0f} mm" for d in depth]))

# %% [markdown]
# The clamp must push back with what the ball presses with. Nothing in the solver asks for this: it follows from the
# energy not changing when everything is shifted.

# %%
press = -ball.gradient(pressed.y).sum(axis=1)
hold = bar.elastic.gradient(pressed.y)[:, bar.fixed].sum(axis=1)
for d, p, h in zip(depth, press, hold, strict=True):
    print(f"pressed {1e3 * d:4.1f} mm: ball {p[2]:+.4f} N, clamp {h[2]:+.4f} N")
assert np.allclose(press + hold, 0, atol=1e-4 * np.abs(press).max())

# %% [markdown]
# ## Is the number right?
#
# For a small load, beam theory (Timoshenko) gives the drop of the tip of a bar under its weight in closed form:
# $q L^4 / 8 E I + q L^2 / (2 \cdot \tfrac56 G A)$ with $q = \rho g A$.

# %%
area, inertia, shear = WIDTH**2, WIDTH**4 / 12, YOUNG / (2 * (1 + POISSON))
q = DENSITY * 9.81 * strength[0] * area
theory = q * LENGTH**4 / (8 * YOUNG * inertia) + q * LENGTH**2 / (2 * 5 / 6 * shear * area)
print(f"simulated {1e3 * drop[0]:.4f} mm, beam theory {1e3 * theory:.4f} mm, ratio {drop[0] / theory:.3f}")
assert abs(drop[0] / theory - 1) < 0.05
