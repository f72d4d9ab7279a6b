"""Laws to stand beside the Neo-Hookean one, each the energy that a cause adds and nothing at its null parameter.

`I = I_c - 3 - 2 ln J` is twice the Neo-Hookean energy at mu = 1, lam = 0, `B = F - F^-T` its stress; I and B vanish at
rotations only. `E = (F^T F - 1) / 2` is the Green strain. All are isotropic but for `Fibre`; all are linear in their
parameters but for `GentStiffening.g`, the fibre's axis and products of two parameters.
"""

import taichi as ti

from sim.laws.neo_hookean import cofactor, cross, dpiola, piola, psi

_LOCKED = 0.95  # of its limit, up to which a strain follows Gent's law


@ti.func
def _invariant(F):
    """I = I_c - 3 - 2 ln J; infinite where J <= 0."""
    return 2.0 * psi(F, 1.0, 0.0)


class YeohStiffening:
    """`psi = mu beta/2 I^2`: mu [Pa], beta [-], null 0. The stress grows by the factor 1 + 2 beta I.

    `P = 2 mu beta I B`, `dP[W] = 2 mu beta (2 (B:W) B + I dB[W])`. Yeoh's own term is C2 (I_1 - 3)^2 with
    C2 = mu beta / 2.
    """

    parameters = ("mu", "beta")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        return 0.5 * m[i, 0] * m[i, 1] * _invariant(F) ** 2

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return (2.0 * m[i, 0] * m[i, 1] * _invariant(F)) * piola(F, 1.0, 0.0)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        B = piola(F, 1.0, 0.0)
        change = (2.0 * (B * W).sum()) * B + _invariant(F) * dpiola(F, W, 1.0, 0.0)
        return (2.0 * m[i, 0] * m[i, 1]) * change


@ti.func
def _locking(x):
    """x/(1 - x) and its slope, up to `_LOCKED`; beyond it along its tangent there."""
    near = ti.min(x, _LOCKED)
    slope = 1.0 / (1.0 - near) ** 2
    return ti.Vector([near / (1.0 - near) + slope * (x - near), slope])


@ti.func
def _excess(x):
    """The integral of x/(1 - x) over x, (-ln(1 - x) - x) / x = x/2 + x^2/3 + ..., by the series where the difference
    would lose its digits."""
    value = 0.0
    if ti.abs(x) < 0.02:
        tail = x * (1 / 5 + x * (1 / 6 + x * (1 / 7 + x * (1 / 8 + x / 9))))
        value = x * (1 / 2 + x * (1 / 3 + x * (1 / 4 + tail)))
    else:
        near = ti.min(x, _LOCKED)
        there = _locking(near)
        beyond = (x - near) * (there[0] + 0.5 * (x - near) * there[1])
        value = (-ti.log(1.0 - near) - near + beyond) / x
    return value


class GentStiffening:
    """Gent's law less the Neo-Hookean one, `psi = -mu/(2 g) ln(1 - g I) - mu/2 I`: mu [Pa], g = 1/J_m [-], null 0.

    With x = g I: `P = mu x/(1 - x) B`, `dP[W] = mu (2 g (B:W)/(1 - x)^2 B + x/(1 - x) dB[W])`. It locks at I = 1/g;
    from x = 0.95 on, at twenty times the stress, that goes on along its tangent, so that a motion which was found
    without it has an energy. Its slope in g at the null is Yeoh's in 2 beta: weak, the two are the same.
    """

    parameters = ("mu", "g")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        invariant = _invariant(F)
        value = ti.math.inf
        if invariant < ti.math.inf:
            value = 0.5 * m[i, 0] * invariant * _excess(m[i, 1] * invariant)
        return value

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return (m[i, 0] * _locking(m[i, 1] * _invariant(F))[0]) * piola(F, 1.0, 0.0)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        B, stiff = piola(F, 1.0, 0.0), _locking(m[i, 1] * _invariant(F))
        along = 2.0 * m[i, 1] * (B * W).sum() * stiff[1]
        return m[i, 0] * (along * B + stiff[0] * dpiola(F, W, 1.0, 0.0))


class VolumetricChange:
    """`psi = w lam/2 (ln^2 J - (J - 1)^2)`: lam [Pa], w [-], null 0; at w = 1 the volume term lam/2 ln^2 J is left.

    `P = w lam (ln J/J - (J - 1)) cof F`,
    `dP[W] = w lam (((1 - ln J)/J^2 - 1) (cof F:W) cof F + (ln J/J - (J - 1)) cross(F, W))`. Stiffer than the base in
    compression; soft beyond J = e at w = 1.
    """

    parameters = ("lam", "w")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        J = F.determinant()
        value = ti.math.inf
        if J > 0:
            value = 0.5 * m[i, 0] * m[i, 1] * (ti.log(J) ** 2 - (J - 1.0) ** 2)
        return value

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        J = F.determinant()
        return (m[i, 0] * m[i, 1] * (ti.log(J) / J - (J - 1.0))) * cofactor(F)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        J, C = F.determinant(), cofactor(F)
        bend = ((1.0 - ti.log(J)) / (J * J) - 1.0) * (C * W).sum()
        return m[i, 0] * m[i, 1] * (bend * C + (ti.log(J) / J - (J - 1.0)) * cross(F, W))


@ti.func
def _lengthening(a, b):
    """|b|^2 - |a|^2, exactly zero for b = a."""
    return (b - a).dot(b + a)


@ti.func
def _share(s, push):
    """Of their stiffness, with which fibres resist s."""
    return ti.select(s < 0, push, 1.0)


class Fibre:
    """`psi = mu k/2 h s^2`, s = |F a|^2 - |a|^2, h = 1 where the fibres are pulled and `push` where they are pressed:
    mu [Pa], k [-], null 0, the axis a at rest, a unit vector, and push [-], 1, or 0 of fibres that then buckle
    (Holzapfel, Gasser & Ogden 2000).

    `P = 2 mu k h s (F a) a^T`, `dP[W] = 2 mu k h (2 (Fa.Wa) F a + s W a) a^T`. Stiff along a (k > 0).
    """

    parameters = ("mu", "k", "ax", "ay", "az", "push")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        a = ti.Vector([m[i, 2], m[i, 3], m[i, 4]])
        s = _lengthening(a, F @ a)
        return 0.5 * m[i, 0] * m[i, 1] * _share(s, m[i, 5]) * s**2

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        a = ti.Vector([m[i, 2], m[i, 3], m[i, 4]])
        b = F @ a
        s = _lengthening(a, b)
        return (2.0 * m[i, 0] * m[i, 1] * _share(s, m[i, 5]) * s) * b.outer_product(a)

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        a = ti.Vector([m[i, 2], m[i, 3], m[i, 4]])
        b, c = F @ a, W @ a
        s = _lengthening(a, b)
        change = (2.0 * b.dot(c)) * b + s * c
        return (2.0 * m[i, 0] * m[i, 1] * _share(s, m[i, 5])) * change.outer_product(a)


class TensionCompression:
    """`psi = mu alpha/3 (tr E)^3`: mu [Pa], alpha [-], null 0; alpha > 0 stiffens tension and softens compression.

    `P = mu alpha (tr E)^2 F`, `dP[W] = mu alpha (2 tr E (F:W) F + (tr E)^2 W)`. For alpha < 0 the energy falls without
    bound in tension.
    """

    parameters = ("mu", "alpha")

    @staticmethod
    @ti.func
    def psi(F, m: ti.template(), i):
        return m[i, 0] * m[i, 1] / 3.0 * (0.5 * (F.norm_sqr() - 3.0)) ** 3

    @staticmethod
    @ti.func
    def piola(F, m: ti.template(), i):
        return (m[i, 0] * m[i, 1] * (0.5 * (F.norm_sqr() - 3.0)) ** 2) * F

    @staticmethod
    @ti.func
    def dpiola(F, W, m: ti.template(), i):
        trace = 0.5 * (F.norm_sqr() - 3.0)
        return (m[i, 0] * m[i, 1] * trace) * ((2.0 * (F * W).sum()) * F + trace * W)
