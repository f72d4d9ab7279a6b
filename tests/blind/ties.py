"""Springs, obstacles and masses that act on every node by itself (see `blind.solver.Tie`)."""

from dataclasses import dataclass, replace

import numpy as np

Response = tuple[float, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Springs:
    """E = sum_i k_i/2 |u_i - a_i|^2, k (N,) [N/m], a (N, 3) [m] or zero."""

    k: np.ndarray
    a: np.ndarray | float = 0.0

    def respond(self, u: np.ndarray, t: float) -> Response:
        d = u - self.a
        return float((self.k[:, None] / 2 * d**2).sum()), self.k[:, None] * d, self.k[:, None, None] * np.eye(3)

    def after(self, u: np.ndarray, t: float) -> "Springs":
        return self


@dataclass(frozen=True, eq=False)
class Friction:
    """Dry friction: springs k (N,) [N/m] that slip where they would pull with more than `most` (N,) [N].

    E = sum_i k_i/2 r_i^2 up to r_i = most_i/k_i, linear beyond; r_i = |u_i - a_i|. Ends a that slipped stay there.
    """

    k: np.ndarray
    most: np.ndarray
    a: np.ndarray | float = 0.0  # (N, 3) [m]

    def _stretch(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """u - a (N, 3), its length, and the length at which it slips, (N,)."""
        d = u - self.a
        allowed = np.divide(self.most, self.k, out=np.full(len(u), np.inf), where=self.k > 0)
        return d, np.maximum(np.linalg.norm(d, axis=1), 1e-15), allowed

    def respond(self, u: np.ndarray, t: float) -> Response:
        d, r, allowed = self._stretch(u)
        stuck = np.minimum(r, allowed)
        pull = self.k * stuck / r
        N = d[:, :, None] * d[:, None, :] / (r**2)[:, None, None]
        H = pull[:, None, None] * (np.eye(3) - (r > allowed)[:, None, None] * N)
        return float((self.k * (stuck * r - stuck**2 / 2)).sum()), pull[:, None] * d, H

    def after(self, u: np.ndarray, t: float) -> "Friction":
        d, r, allowed = self._stretch(u)
        return replace(self, a=u - d * np.minimum(1, allowed / r)[:, None])


@dataclass(frozen=True, eq=False)
class Obstacle:
    """E = sum_i k_i/2 <gap_i>^2 where a node at x_i + u_i is past a plane, or inside a sphere.

    centre: a point of the plane or the sphere's [m]; normal points away from the obstacle; radius None: a plane.
    """

    x: np.ndarray  # (N, 3) [m]
    k: np.ndarray  # (N,) [N/m]
    centre: np.ndarray
    normal: np.ndarray
    radius: float | None = None

    def respond(self, u: np.ndarray, t: float) -> Response:
        d = self.x + u - self.centre
        if self.radius is None:
            depth, n = np.maximum(0, -d @ self.normal), np.broadcast_to(self.normal, d.shape)
            bend = np.zeros(len(d))
        else:
            r = np.maximum(np.linalg.norm(d, axis=1), 1e-9)
            depth, n = np.maximum(0, self.radius - r), d / r[:, None]
            bend = depth / r
        N = n[:, :, None] * n[:, None, :]
        H = N * (depth > 0)[:, None, None] - bend[:, None, None] * (np.eye(3) - N)
        g = -(self.k * depth)[:, None] * n
        return float((self.k * depth**2 / 2).sum()), g, self.k[:, None, None] * H

    def after(self, u: np.ndarray, t: float) -> "Obstacle":
        return self


@dataclass(frozen=True, eq=False)
class Buckling:
    """E = sum_i w_i k/2 s_i^2 (s_i^2/(2 reach^2) - 1), s = n.u: pushes away from rest up to the reach, then back."""

    w: np.ndarray  # (N,) of sum 1
    k: float  # [N/m]
    n: np.ndarray  # (3,)
    reach: float  # [m]

    def respond(self, u: np.ndarray, t: float) -> Response:
        s, k = u @ self.n, self.w * self.k
        ratio = (s / self.reach) ** 2
        H = (k * (3 * ratio - 1))[:, None, None] * np.outer(self.n, self.n)
        return float((k / 2 * s**2 * (ratio / 2 - 1)).sum()), (k * s * (ratio - 1))[:, None] * self.n, H

    def after(self, u: np.ndarray, t: float) -> "Buckling":
        return self


@dataclass(frozen=True, eq=False)
class Magnet:
    """E = -sum_i w_i s / |x_i + u_i - p|, s [N m2]: a point p that pulls the more the nearer it is."""

    x: np.ndarray  # (N, 3) [m]
    w: np.ndarray  # (N,) of sum 1
    s: float
    p: np.ndarray  # (3,)

    def respond(self, u: np.ndarray, t: float) -> Response:
        d = self.x + u - self.p
        r = np.linalg.norm(d, axis=1)
        k = self.w * self.s
        D = d[:, :, None] * d[:, None, :] / (r**2)[:, None, None]
        H = (k / r**3)[:, None, None] * (np.eye(3) - 3 * D)
        return float(-(k / r).sum()), (k / r**3)[:, None] * d, H

    def after(self, u: np.ndarray, t: float) -> "Magnet":
        return self


@dataclass(frozen=True, eq=False)
class String:
    """E = sum_i k_i/2 <|x_i + u_i - p| - |x_i - p|>^2: strings to a point p, taut at rest, that only pull."""

    x: np.ndarray  # (N, 3) [m]
    k: np.ndarray  # (N,) [N/m]
    p: np.ndarray  # (3,)

    def respond(self, u: np.ndarray, t: float) -> Response:
        d = self.x + u - self.p
        r = np.linalg.norm(d, axis=1)
        longer = np.maximum(r - np.linalg.norm(self.x - self.p, axis=1), 0)
        N = d[:, :, None] * d[:, None, :] / (r**2)[:, None, None]
        H = (longer > 0)[:, None, None] * N + (longer / r)[:, None, None] * (np.eye(3) - N)
        return float((self.k / 2 * longer**2).sum()), (self.k * longer / r)[:, None] * d, self.k[:, None, None] * H

    def after(self, u: np.ndarray, t: float) -> "String":
        return self


@dataclass(frozen=True, eq=False)
class Drag:
    """A force -c_i u_i' with c (N,) [N s/m], the speed by backward differences of second order: a spring to a place
    that is known beforehand. The first step is from rest.

    `u' = ((1 + 2r)/(1 + r) u - (1 + r) u_1 + r^2/(1 + r) u_2) / h` with steps h and h/r (BDF2, Hairer & Wanner III.5).
    """

    c: np.ndarray
    t: float = 0.0
    u: np.ndarray | float = 0.0  # at t [m]
    h: float = np.inf  # the step to t [s]
    moved: np.ndarray | float = 0.0  # in it [m]

    def respond(self, u: np.ndarray, t: float) -> Response:
        rate, at_rest = self._speed(t)
        return Springs(self.c * rate, at_rest).respond(u, t)

    def _speed(self, t: float) -> tuple[float, np.ndarray]:
        """The speed is the first [1/s] times what u differs by from the second."""
        h = t - self.t
        r = h / self.h
        scale = (1 + 2 * r) / (1 + r)
        return scale / h, self.u + r**2 / (1 + r) / scale * self.moved

    def after(self, u: np.ndarray, t: float) -> "Drag":
        return self if t <= self.t else replace(self, t=t, u=u, h=t - self.t, moved=u - self.u)


@dataclass(frozen=True, eq=False)
class Wake(Drag):
    """A force -c_i |u_i'| u_i' with c (N,) [N s2/m2]."""

    def respond(self, u: np.ndarray, t: float) -> Response:
        rate, at_rest = self._speed(t)
        v = rate * (u - at_rest)
        speed = np.linalg.norm(v, axis=1)
        along = v[:, :, None] * v[:, None, :] / np.maximum(speed, 1e-300)[:, None, None]
        H = (self.c * rate)[:, None, None] * (speed[:, None, None] * np.eye(3) + along)
        return float((self.c / (3 * rate) * speed**3).sum()), (self.c * speed)[:, None] * v, H


@dataclass(frozen=True, eq=False)
class Inertia:
    """m u'' + c m u' by the trapezoidal rule (Newmark 1959, beta = 1/4, gamma = 1/2), m (N,) [kg], c [1/s].

    Over a step h the two are k (u - u*) with k = m (4/h^2 + 2 c/h): a spring to a place that is known beforehand.
    """

    m: np.ndarray
    c: float
    t: float = 0.0
    u: np.ndarray | float = 0.0  # at t [m]
    v: np.ndarray | float = 0.0  # [m/s]
    a: np.ndarray | float = 0.0  # [m/s2]

    def _spring(self, t: float) -> Springs:
        h = t - self.t
        scale = 4 / h**2 + 2 * self.c / h
        target = self.u + ((4 / h + self.c) * self.v + self.a) / scale
        return Springs(self.m * scale, target)

    def respond(self, u: np.ndarray, t: float) -> Response:
        return self._spring(t).respond(u, t)

    def after(self, u: np.ndarray, t: float) -> "Inertia":
        h = t - self.t
        if h <= 0:
            return replace(self, t=t, u=u)
        v = 2 / h * (u - self.u) - self.v
        return replace(self, t=t, u=u, v=v, a=2 / h * (v - self.v) - self.a)
