"""The virtual elastic object: a rest shape with a learnt material, to push, load, press and store."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from sim.checks import as_array, require
from sim.cloud import CloudOptions, RestCloud
from sim.elastic import Elastic
from sim.energy import Energy
from sim.gradual import equilibrate_gradually
from sim.lame import Lame
from sim.newton import Equilibrium, NewtonOptions, equilibrate
from sim.terms.base import Term
from sim.terms.loads import AppliedForce, gravity_change
from veo_ti.store import Sequence as StoredSequence
from veo_ti.store import read_sequence, write_sequence


@dataclass(frozen=True, kw_only=True, eq=False)
class VirtualElasticObject:
    """Everything a simulation needs of an object, in SI units.

    determined (N,): share of the uncertainty of log mu that data removed, 0 where the value is a guess.
    With force_scale_known False the moduli are right up to one common factor only. footprint [m]: of an air stream
    that nobody measured, as identified with the material. up: direction that pictures show upwards.
    """

    x: np.ndarray  # (N, 3) [m]
    lame: Lame
    volume: np.ndarray  # (N,) [m3]
    fixed: np.ndarray  # (N,) bool
    surface: np.ndarray  # (N,) bool
    determined: np.ndarray | None = None  # (N,)
    mass: float | None = None  # [kg]
    gravity: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) [m/s2] in the rest pose
    force_scale_known: bool = True
    footprint: float | None = None
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    options: CloudOptions = field(default_factory=CloudOptions)
    name: str = ""

    @cached_property
    def cloud(self) -> RestCloud:
        """The discretised rest shape."""
        return RestCloud.build(self.x, volume=self.volume, surface=self.surface, options=self.options)

    @cached_property
    def elastic(self) -> Elastic:
        """The object's elastic energy."""
        return Elastic.neo_hookean(self.cloud, self.lame)

    def energy(self, terms: Sequence[Term] = ()) -> Energy:
        """The object under the given terms, held at its fixed points."""
        return Energy.of(self.elastic, terms, self.fixed)

    def push(self, force: np.ndarray) -> AppliedForce:
        """A load term from forces (T, N, 3) or (N, 3) [N] on the points."""
        force = np.asarray(force, float)
        return AppliedForce(force=as_array("force", force if force.ndim == 3 else force[None], (None, len(self.x), 3)))

    def push_at(self, place: np.ndarray, force: np.ndarray, radius: float) -> AppliedForce:
        """A total force (3,) or (T, 3) [N] on the surface around `place` (3,) [m], a Gaussian of `radius` [m].

        Raises ValueError when no surface point is within three radii.
        """
        distance = np.linalg.norm(self.x - as_array("place", place, (3,)), axis=1)
        weight = np.exp(-0.5 * (distance / radius) ** 2) * (self.surface & (distance < 3 * radius))
        nearest = float(distance[self.surface].min())
        require(weight.sum() > 0, "place", "lie near the surface", f"a place {nearest:.3g} m away from it")
        return AppliedForce(force=(weight / weight.sum())[None, :, None] * np.atleast_2d(force)[:, None, :])

    def under_gravity(self, gravity: np.ndarray) -> AppliedForce:
        """The load of another gravity (3,) or (T, 3) [m/s2] than the rest pose's; needs the mass."""
        require(self.mass is not None, "mass", "be known to change gravity", "none")
        share = self.mass * self.volume / self.volume.sum()
        return gravity_change(share, np.atleast_2d(gravity) - self.gravity)

    def simulate(
        self,
        *terms: Term,
        start: np.ndarray | None = None,
        frames: int | None = None,
        options: NewtonOptions | None = None,
        gradual: bool = False,
    ) -> Equilibrium:
        """The equilibrium under the terms; as many frames as `start` (T, N, 3), `frames`, or the longest term has.

        gradual: every frame begins where the one before ended, the first at its start (`equilibrate_gradually`).
        """
        count = frames or max([len(getattr(t, "force", getattr(t, "targets", [0]))) for t in terms], default=1)
        rest = np.repeat(self.x[None], count, axis=0) if start is None else start
        if gradual:
            return equilibrate_gradually(self.energy(terms), rest[0], count, options=options)
        return equilibrate(self.energy(terms), rest, options=options)

    @cached_property
    def static(self) -> dict[str, np.ndarray]:
        """Per-point arrays as they are stored and coloured."""
        determined = np.zeros(len(self.x)) if self.determined is None else self.determined
        return {
            "x": self.x, "mu": self.lame.mu, "lam": self.lame.lam, "volume": self.volume, "fixed": self.fixed,
            "surface": self.surface, "sensitivity": determined,
        }  # fmt: skip

    @property
    def attributes(self) -> dict[str, object]:
        """What is stored of the object besides arrays."""
        return {
            "mass": self.mass, "gravity": self.gravity.tolist(), "force_scale_known": self.force_scale_known,
            "footprint": self.footprint, "up": self.up.tolist(), "name": self.name, "options": asdict(self.options),
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write the object in its rest pose as .vtkhdf."""
        stored = StoredSequence(
            time=np.zeros(1), points=self.x[None], static=self.static, attributes=self.attributes
        )
        return write_sequence(path, stored)

    @staticmethod
    def load(path: str | Path) -> "VirtualElasticObject":
        """Read an object from a .vtkhdf that `save` or a veo command wrote, or a folder with an object.vtkhdf.

        Raises ValueError in one sentence when the file is not there, damaged, or holds no object.
        """
        path = Path(path)
        stored = read_sequence(path / "object.vtkhdf" if path.is_dir() else path)
        missing = {"x", "mu", "lam", "volume", "fixed", "surface"} - stored.static.keys()
        require(not missing, "file", "hold an identified object", f"{path.name!r} without {sorted(missing)}")
        s, a = stored.static, stored.attributes
        return VirtualElasticObject(
            x=s["x"], lame=Lame(mu=s["mu"], lam=s["lam"]), volume=s["volume"], fixed=s["fixed"].astype(bool),
            surface=s["surface"].astype(bool), determined=s.get("sensitivity"), mass=a.get("mass"),
            gravity=np.asarray(a.get("gravity", [0.0, 0.0, 0.0])), force_scale_known=a.get("force_scale_known", True),
            footprint=a.get("footprint"), up=np.asarray(a.get("up", [0.0, 0.0, 1.0])),
            options=CloudOptions(**a.get("options", {})), name=a.get("name", ""),
        )  # fmt: skip
