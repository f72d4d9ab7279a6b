"""Where cameras and boards stand at first, by chains of cameras that saw the board at the same moments."""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from recon.calibration.bodies import fitted_bodies
from recon.calibration.sightings import Sightings, lenses, residuals
from recon.cameras import Camera
from recon.rigid import inverse, turn_of
from sim.checks import require

_LOOSE = 2.0  # [px], beyond which a corner no longer pulls by its square


def view_poses(cameras: Sequence[Camera], sightings: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Views (V, 2) of camera and shot, and the board's pose (V, 4, 4) in each one's camera frame [m].

    A flat board has two likely poses (IPPE; Collins and Bartoli 2014): both are refined, the better one is taken.
    """
    views, which = np.unique(np.stack([sightings.camera, sightings.body], axis=1), axis=0, return_inverse=True)
    which = np.ravel(which)
    starts = np.array([_both(cameras[c], sightings.chosen(which == v)) for v, (c, _) in enumerate(views)])
    still = np.tile(np.eye(4), (len(cameras), 1, 1))
    seen = Sightings(camera=sightings.camera, body=which, point=sightings.point, pixel=sightings.pixel)
    fits = [fitted_bodies(lenses(cameras), still, starts[:, k], seen, loose=_LOOSE) for k in (0, 1)]
    second = fits[1].cost < fits[0].cost
    return views, np.where(second[:, None, None], fits[1].T_world_body, fits[0].T_world_body)


def chained(cameras: Sequence[Camera], views: np.ndarray, T_camera_board: np.ndarray) -> np.ndarray:
    """T_camera_world (C, 4, 4) of all cameras, the first one staying where it is.

    Two cameras' relative pose is, of those that their common shots give, the one nearest to all others, so that a
    board that moved between two exposures does no harm; cameras are joined along the tree with most common shots.
    Raises ValueError naming the cameras that no chain of common shots links to the first.
    """
    pairs = {(a, b): _relative(views, T_camera_board, a, b) for a in range(len(cameras)) for b in range(a)}
    common = {pair: relative for pair, relative in pairs.items() if len(relative)}
    first, second = (np.array([pair[k] for pair in common], int) for k in (0, 1))
    cost = csr_matrix(([1 / len(r) for r in common.values()], (first, second)), (len(cameras),) * 2)
    tree = minimum_spanning_tree(cost)
    order, parent = breadth_first_order(tree, 0, directed=False)
    lost = [camera.name for c, camera in enumerate(cameras) if c not in order]
    rule = f"see the board together with one that is linked to {cameras[0].name}"
    require(not lost, ", ".join(lost), rule, "no common picture")
    T = np.array([camera.T_camera_world for camera in cameras])
    for c in order[1:]:
        p = parent[c]
        relative = _middle(common[c, p]) if (c, p) in common else inverse(_middle(common[p, c]))
        T[c] = relative @ T[p]
    return T


def board_poses(cameras: Sequence[Camera], sightings: Sightings, views: np.ndarray, T: np.ndarray) -> np.ndarray:
    """T_world_board (S, 4, 4) of every shot: of the poses T (V, 4, 4) that its cameras give, the best for all."""
    boards = np.tile(np.eye(4), (int(sightings.body.max()) + 1, 1, 1))
    lens, T_camera = lenses(cameras), np.array([camera.T_camera_world for camera in cameras])
    for shot in np.unique(sightings.body):
        seen = sightings.chosen(sightings.body == shot)
        at = np.flatnonzero(views[:, 1] == shot)
        guesses = inverse(T_camera[views[at, 0]]) @ T[at]
        cost = []
        for guess in guesses:
            boards[shot] = guess
            cost.append(np.linalg.norm(residuals(lens, T_camera, boards, seen), axis=1).sum())
        boards[shot] = guesses[int(np.argmin(cost))]
    return boards


def _both(camera: Camera, seen: Sightings) -> np.ndarray:
    """The two poses (2, 4, 4) of a flat board in the camera's frame."""
    rays = camera.rays(seen.pixel) @ camera.T_camera_world[:3, :3].T
    plane = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
    _, turns, shifts, _ = cv2.solvePnPGeneric(seen.point, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    T = np.tile(np.eye(4), (2, 1, 1))
    for k in (0, 1):
        T[k, :3, :3], T[k, :3, 3] = cv2.Rodrigues(turns[k % len(turns)])[0], np.ravel(shifts[k % len(shifts)])
    return T


def _relative(views: np.ndarray, T: np.ndarray, a: int, b: int) -> np.ndarray:
    """T_a_b (n, 4, 4) by each shot that cameras a and b share."""
    at_a, at_b = (np.flatnonzero(views[:, 0] == c) for c in (a, b))
    _, i, j = np.intersect1d(views[at_a, 1], views[at_b, 1], return_indices=True)
    return T[at_a[i]] @ inverse(T[at_b[j]])


def _middle(T: np.ndarray) -> np.ndarray:
    """The motion (4, 4) with the least median distance to the others: turn [rad] and shift over its usual length."""
    step = inverse(T)[:, None] @ T
    turn = np.linalg.norm(turn_of(step), axis=-1)
    shift = np.linalg.norm(T[:, None, :3, 3] - T[:, :3, 3], axis=-1)
    length = np.median(np.linalg.norm(T[:, :3, 3], axis=-1)) + np.finfo(float).tiny
    return T[int(np.argmin(np.median(turn + shift / length, axis=1)))]
