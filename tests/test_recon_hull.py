"""The visual hull of an ellipsoid whose silhouettes are exact: nothing inside is lost, little outside is kept."""

from dataclasses import replace

import numpy as np
import pytest
from ellipsoid_scene import RADII, inside, ring, silhouette
from scipy.ndimage import binary_erosion

from recon.cameras import look_at
from recon.hull import Hull, HullOptions, visual_hull

MIDDLE = np.array([0.03, -0.02, 0.01])
TRUE = 4 / 3 * np.pi * RADII.prod()


def filmed(count: int, **options):
    cameras = ring(count, **options)
    return cameras, [silhouette(camera, MIDDLE) for camera in cameras]


@pytest.mark.parametrize(("count", "cells"), [(3, 24), (6, 48), (19, 64)])
def test_interior_is_kept(count, cells):
    hull = visual_hull(*filmed(count), HullOptions(cells=cells))
    assert hull.contains(inside(50_000, MIDDLE)).mean() >= 0.999
    assert max(hull.occupied.shape) == cells


def test_hull_is_tight_where_pixels_are_fine():
    hull = visual_hull(*filmed(12, size=(288, 384), focal=440.0), HullOptions(cells=60))
    assert hull.contains(inside(50_000, MIDDLE)).mean() >= 0.999
    # half a cube's diagonal and two pixels of 1.8 mm on every side of 60 to 100 mm
    assert 1.0 < hull.volume / TRUE < 1.45
    grown = MIDDLE + (inside(50_000, MIDDLE) - MIDDLE) * 1.3
    shell = grown[(((grown - MIDDLE) / RADII) ** 2).sum(axis=1) > 1.25**2]
    assert hull.contains(shell).mean() < 0.05
    np.testing.assert_allclose(hull.points.mean(axis=0), MIDDLE, atol=2e-3)


@pytest.mark.parametrize("fault", ["empty", "holes", "thin", "stain"])
def test_faulty_mattes_lose_nothing(fault):
    cameras, mattes = filmed(8)
    rng = np.random.default_rng(0)
    if fault == "empty":
        mattes[3] = np.zeros_like(mattes[3])
    elif fault == "holes":
        mattes = [matte & ~(binary_erosion(matte, iterations=3) & (rng.random(matte.shape) < 0.3)) for matte in mattes]
    elif fault == "thin":
        mattes = [binary_erosion(matte) for matte in mattes]
    else:
        mattes[2][:12, :20] = mattes[5][-9:, -30:] = True
    hull = visual_hull(cameras, mattes, HullOptions(cells=40))
    assert hull.contains(inside(50_000, MIDDLE)).mean() >= 0.999
    assert hull.volume < 4 * TRUE


def test_what_stands_before_the_object_costs_nothing_where_it_is_said():
    """A bar across the middle of three mattes: as unclear pixels it loses nothing and adds little."""
    cameras, mattes = filmed(8)
    bars = [np.zeros_like(matte) for matte in mattes]
    for bar in bars[:3]:
        bar[:, 30:42] = True
    cut = [matte & ~bar for matte, bar in zip(mattes, bars, strict=True)]
    points, options = inside(50_000, MIDDLE), HullOptions(cells=40)
    assert visual_hull(cameras, cut, options).contains(points).mean() < 0.95
    hull = visual_hull(cameras, cut, options, unclear=bars)
    assert hull.contains(points).mean() >= 0.999
    assert hull.volume < 1.25 * visual_hull(cameras, mattes, options).volume


def test_nothing_is_beside_the_picture_of_a_whole_matte():
    """Three cameras look the other way, past the first three, and all see a second thing there."""
    cameras, mattes = filmed(8)
    thing = MIDDLE + 3.0 * (cameras[0].centre - MIDDLE)
    mattes = mattes[:5]
    for way in (np.array([0.3, 0.1, 0]), np.array([-0.3, 0, 0.2]), np.array([0, 0.3, 0.3])):
        T = look_at(thing + 2.5 * way, thing, np.array([0, 1.0, 0.1]))
        cameras[len(mattes)] = replace(cameras[len(mattes)], T_camera_world=T)
        mattes.append(silhouette(cameras[len(mattes)], thing))
    both = np.stack([np.minimum(MIDDLE, thing) - 0.15, np.maximum(MIDDLE, thing) + 0.15])
    with pytest.raises(ValueError, match="have a part of space in common"):
        visual_hull(cameras, mattes, HullOptions(cells=50), both)
    for matte in mattes[:5]:
        matte[:, 0] = True  # the edge cuts it: what is beside the picture is open again
    hull = visual_hull(cameras, mattes, HullOptions(cells=50), both)
    assert hull.contains(thing[None]).all()


def test_bounds_choose_the_part_that_is_carved():
    cameras, mattes = filmed(8)
    bounds = np.array([MIDDLE, MIDDLE + 0.12])
    hull = visual_hull(cameras, mattes, HullOptions(cells=30), bounds)
    points = inside(50_000, MIDDLE)
    here = (points > bounds[0]).all(axis=1)
    assert hull.contains(points[here]).mean() >= 0.999 and not hull.contains(points[~here]).any()
    np.testing.assert_allclose(hull.spacing, 0.12 / 30)


def test_cubes_points_and_surface_agree():
    occupied = np.zeros((4, 5, 6), bool)
    occupied[1:4, 1:4, 1:4] = True
    hull = Hull(occupied=occupied, origin=np.array([1.0, 2.0, 3.0]), spacing=0.5)
    assert hull.contains(hull.points).all() and len(hull.points) == 27 and len(hull.surface) == 26
    assert hull.volume == pytest.approx(27 / 8)
    np.testing.assert_array_equal(hull.points[0], [1.75, 2.75, 3.75])
    np.testing.assert_array_equal(hull.contains(np.array([[0, 0, 0], [2.4, 3.1, 4.4], [1.2, 2.2, 3.2]])), [0, 1, 0])


def test_specks_beside_the_object_go():
    occupied = np.zeros((12, 9, 9), bool)
    occupied[:6, :6, :6] = occupied[8:11, :3, :3] = occupied[11, 8, 8] = True
    hull = Hull(occupied=occupied, origin=np.zeros(3), spacing=1.0)
    clean = hull.without_specks()
    assert clean.occupied.sum() == 216 + 27 and not clean.occupied[11, 8, 8]
    assert hull.without_specks(0.2).occupied.sum() == 216 and hull.without_specks(0).occupied.sum() == 216 + 28


def test_what_cannot_be_carved_is_one_sentence():
    cameras, mattes = filmed(4)
    with pytest.raises(ValueError, match=r"cam0002 matte must be 72 x 96 pixels; got \(72, 90\)"):
        visual_hull(cameras, [mattes[0], mattes[1][:90], *mattes[2:]])
    with pytest.raises(ValueError, match="mattes must show the object; got 2 of 4 that do"):
        visual_hull(cameras, [mattes[0], mattes[1], *(np.zeros_like(m) for m in mattes[2:])])
    with pytest.raises(ValueError, match="mattes must belong to at least two cameras, one each; got 1"):
        visual_hull(cameras[:1], mattes[:1])
    apart = [np.zeros_like(matte) for matte in mattes]
    for matte, corner in zip(apart, (np.s_[:4, :4], np.s_[-4:, -4:], np.s_[:4, -4:], np.s_[-4:, :4]), strict=True):
        matte[corner] = True
    with pytest.raises(ValueError, match="mattes must have a part of space in common; got none"):
        visual_hull(cameras, apart, HullOptions(misses=0))
