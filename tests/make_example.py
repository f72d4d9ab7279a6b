"""Make the stored finite-element measurements: `python tests/make_example.py plush | two-region [--out FILE]`."""

import argparse
import time
from pathlib import Path

import fem
import fem_scenes
import numpy as np
from skfem import MeshHex

ROOT = Path(__file__).parent.parent
DENSITY = 120.0  # [kg/m3] stuffed fabric
CELL = 0.0175  # [m] edge of the plush's cells
NOISE = 0.3e-3  # [m]


def plush_mesh() -> MeshHex:
    """A sitting toy 24 cm high: wide body, narrower head, two ears; a grid with cells removed, then rounded."""
    mesh = fem.box_mesh((-5, -3, 0), (5, 3, 14), (10, 6, 14))
    x, _, z = np.abs(mesh.p[:, mesh.t].mean(axis=1))
    y = np.abs(mesh.p[1, mesh.t].mean(axis=0))
    ear = (x > 1) & (x < 4) & (y < 2) & (z < 14)
    keep = (z < 6) | ((z < 10) & (x < 4)) | ear
    mesh = mesh.restrict(np.flatnonzero(keep)).remove_unused_nodes()
    return MeshHex(np.stack(rounded(*mesh.p)) * CELL, mesh.t)


def rounded(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grid coordinates to a softer outline: elliptic cross-sections, a bulging body, ears that splay."""
    bulge = 1 + 0.1 * np.sin(np.pi * np.clip(z / 6, 0, 1)) - 0.08 * np.clip(z - 10, 0, 6) / 6
    splay = 0.25 * np.sign(x) * np.clip(z - 10, 0, None)
    return (
        bulge * x * np.sqrt(1 - 0.3 * (y / 3) ** 2) + splay,
        bulge * y * np.sqrt(1 - 0.3 * (x / 5) ** 2),
        z,
    )


def blend(z: np.ndarray, *, at: float, width: float) -> np.ndarray:
    """0 below the height `at` [m], 1 above, over a few `width` [m]."""
    return 1 / (1 + np.exp(-(z - at) / width))


def plush_mu(x: np.ndarray) -> np.ndarray:
    """Shear modulus [Pa]: body 9 kPa, head 24 kPa, ears 4 kPa, blended in log mu over about a cell."""
    head, ears = blend(x[:, 2], at=6 * CELL, width=0.006), blend(x[:, 2], at=10 * CELL, width=0.006)
    return np.exp(np.log(9e3) + head * np.log(24 / 9) + ears * np.log(4 / 24))


def plush_lam(x: np.ndarray) -> np.ndarray:
    """lam = 2 nu mu / (1 - 2 nu) [Pa], nu .36 in the body rising to .39 in head and ears."""
    nu = 0.36 + 0.03 * blend(x[:, 2], at=6 * CELL, width=0.006)
    return 2 * nu / (1 - 2 * nu) * plush_mu(x)


def jet_along(position: np.ndarray, direction: np.ndarray, pressure: np.ndarray, footprint: float) -> fem_scenes.Jet:
    """A jet whose axis passes `position` and whose frame 0 is switched off, with the nozzle 30 cm upstream."""
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    pressure = np.concatenate([[0.0], pressure])
    position, direction = np.vstack([position[:1], position]), np.vstack([direction[:1], direction])
    return fem_scenes.Jet(
        position=position - 0.3 * direction, direction=direction, pressure=pressure, footprint=footprint
    )


def plush_jet() -> fem_scenes.Jet:
    """Three sweeps of nine frames: from the left going up, from the right coming down, from front to back across."""
    up, across = np.linspace(0.04, 0.23, 9), np.linspace(-0.07, 0.07, 9)
    heights = np.array([0.06, 0.10, 0.14, 0.21, 0.23, 0.21, 0.14, 0.10, 0.06])
    z, zero, one = np.concatenate([up, up[::-1], heights]), np.zeros(9), np.ones(9)
    target = np.stack([np.concatenate([zero, zero, across]), np.concatenate([zero, zero, zero]), z], axis=1)
    way = np.concatenate([[[1, 0.3, 0]] * 9, [[-1, 0.3, 0.2]] * 9, np.stack([0.5 * across / 0.07, -one, zero], axis=1)])
    # The ears are thin and soft: the jet is throttled as it climbs.
    pressure = 2000 * np.exp(-np.clip(z - 0.08, 0, None) / 0.055)
    return jet_along(target, way, pressure, 0.035)


def make_plush(out: Path, truth: Path, seed: int) -> fem_scenes.Sequence:
    """Solve the plush, add tracking noise, save the measurement and, apart from it, the true material."""
    body = fem.FemBody.build(plush_mesh(), plush_mu, plush_lam, lambda x: x[:, 2] < 1e-6)
    sequence = fem_scenes.with_noise(fem_scenes.record(body, plush_jet(), plush_mu, plush_lam), NOISE, seed)
    np.savez_compressed(
        out,
        points=sequence.points.astype(np.float32),
        forces=sequence.forces.astype(np.float32),
        time=sequence.time,
        fixed=sequence.fixed,
        surface=sequence.surface,
        volume=sequence.volume,
        mass=DENSITY * sequence.volume.sum(),
        gravity=np.zeros(3),
        nozzle_position=sequence.nozzle_position,
        nozzle_direction=sequence.nozzle_direction,
        nozzle_force=sequence.nozzle_force,
        nozzle_footprint=sequence.nozzle_footprint,
    )
    np.savez_compressed(truth, mu=sequence.mu_true, lam=sequence.lam_true)
    return sequence


def two_region_mu(x: np.ndarray) -> np.ndarray:
    """Shear modulus [Pa] of the beam: 25 kPa towards the clamp, 5 kPa towards the tip."""
    return np.where(x[:, 0] < 0.12, 25e3, 5e3)


def two_region_jet() -> fem_scenes.Jet:
    """24 shots: six stations along the beam, there and back, from four sides, off the axis so that it twists too."""
    along = np.linspace(0.04, 0.22, 6)
    station = np.concatenate([along, along[::-1], along, along[::-1]])
    side = np.repeat(np.array([[0, 1, 0], [0, 0, -1], [0, -1, 0], [0, 0, 1.0]]), 6, axis=0)
    offset = 0.02 * np.roll(side, 1, axis=1) * [0, 1, 1]
    target = np.stack([station, 0 * station, 0 * station], axis=1) + offset
    pressure = np.interp(station, [0.04, 0.12, 0.22], [4000, 1500, 500])
    return jet_along(target, side - np.array([0.3, 0, 0]), pressure, 0.03)


def make_two_region(out: Path) -> fem_scenes.Sequence:
    """Solve the two-region beam and store it noise-free."""
    mesh = fem.box_mesh((0, -0.045, -0.045), (0.24, 0.045, 0.045), (16, 6, 6))

    def lam(x: np.ndarray) -> np.ndarray:
        return 3 * two_region_mu(x)

    body = fem.FemBody.build(mesh, two_region_mu, lam, lambda x: x[:, 0] < 1e-6)
    sequence = fem_scenes.record(body, two_region_jet(), two_region_mu, lam)
    stored = {key: np.asarray(value) for key, value in vars(sequence).items()}
    # Single precision resolves 1e-8 m here, a thousandth of the least noise a test adds.
    small = {key: stored[key].astype(np.float32) for key in ("points", "forces")}
    np.savez_compressed(out, **{**stored, **small})
    return sequence


def summary(sequence: fem_scenes.Sequence, seconds: float, out: Path) -> str:
    """What was made, in a few lines."""
    moved = np.linalg.norm(sequence.points[1:] - sequence.points[0], axis=-1).max(axis=1)
    mu, size = sequence.mu_true / 1e3, np.ptp(sequence.points[0], axis=0) * 100
    return "\n".join(
        [
            f"{out}: {out.stat().st_size / 1e3:.0f} kB, {seconds:.0f} s",
            f"{sequence.points.shape[1]} points, {len(sequence.points)} frames, size {size.round(1)} cm",
            f"spacing {sequence.spacing * 1e3:.1f} mm, noise {sequence.sigma * 1e3:.2f} mm",
            f"mu {mu.min():.1f} to {mu.max():.1f} kPa",
            f"largest displacement per frame {np.array2string(moved * 1e3, precision=0, max_line_width=100)} mm",
        ]
    )


def main() -> None:
    """Parse the arguments, make one file and say what it holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", choices=["plush", "two-region"])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--truth", type=Path, default=ROOT / "tests" / "data" / "plush_truth.npz")
    parser.add_argument("--seed", type=int, default=7)
    given, began = parser.parse_args(), time.perf_counter()
    if given.scene == "plush":
        out = given.out or ROOT / "veo_ti" / "examples" / "plush.npz"
        sequence = make_plush(out, given.truth, given.seed)
    else:
        out = given.out or fem_scenes.TWO_REGION
        sequence = make_two_region(out)
    print(summary(sequence, time.perf_counter() - began, out))


if __name__ == "__main__":
    main()
