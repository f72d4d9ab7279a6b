"""Volume rendering of packed samples in Taichi (Max 1995; the paper's "Rendering"): colour, opacity and depth of rays.

Samples lie one behind the other in one array; `rays` (R, 2) holds the first one and the number of each ray.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti
import torch

from recon.radiance.precision import arrays_of, real_of
from sim.runtime import ensure


@dataclass(frozen=True, kw_only=True, eq=False)
class Composite:
    """Of rays: colour (R, 3) over black, opacity (R,), depth (R,) times opacity; of samples: weight (S,)."""

    colour: torch.Tensor
    opacity: torch.Tensor
    depth: torch.Tensor
    weight: torch.Tensor


def composite(
    density: torch.Tensor, colour: torch.Tensor, length: torch.Tensor, depth: torch.Tensor, rays: torch.Tensor
) -> Composite:
    """`w_i = T_i (1 - exp(-sigma_i delta_i))`, `T_i = exp(-sum_{j<i} sigma_j delta_j)`; sums of w, w c and w t.

    density sigma (S,) [1/m], colour c (S, 3), length delta (S,) [m], depth t (S,) [m]; rays (R, 2) int32. Gradients
    reach density and colour.
    """
    ensure()
    sums, weight = _Composite.apply(density, colour, length, depth, rays)
    return Composite(colour=sums[:, :3], opacity=sums[:, 3], depth=sums[:, 4], weight=weight)


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx, density, colour, length, depth, rays):
        inputs = [v.detach().contiguous() for v in (density, colour, length, depth)]
        sums, weight = density.new_empty(len(rays), 5), torch.empty_like(inputs[0])
        _kernels(density.dtype).forward(*inputs, rays, sums, weight)
        ctx.save_for_backward(*inputs, rays, weight)
        return sums, weight

    @staticmethod
    def backward(ctx, by_sums, by_weight):
        density, colour, length, depth, rays, weight = (v.detach() for v in ctx.saved_tensors)
        by_density, by_colour = torch.empty_like(density), torch.empty_like(colour)
        pulled = by_sums.contiguous(), by_weight.contiguous()
        _kernels(density.dtype).backward(colour, length, depth, density, rays, weight, *pulled, by_density, by_colour)
        return by_density, by_colour, None, None, None


@dataclass(frozen=True, kw_only=True)
class _Kernels:
    forward: object
    backward: object


@cache
def _kernels(dtype: torch.dtype) -> _Kernels:
    """The kernels in one precision."""
    real = real_of(dtype)
    Reals1, Reals2 = arrays_of(real)
    Rays = ti.types.ndarray(dtype=ti.i32, ndim=2)

    @ti.kernel
    def forward(
        density: Reals1, colour: Reals2, length: Reals1, depth: Reals1, rays: Rays, sums: Reals2, weight: Reals1
    ):
        for r in range(rays.shape[0]):
            left, total = ti.cast(1, real), ti.Vector.zero(real, 5)
            for i in range(rays[r, 0], rays[r, 0] + rays[r, 1]):
                passed = ti.exp(-density[i] * length[i])
                w = left * (1 - passed)
                for a in ti.static(range(3)):
                    total[a] += w * colour[i, a]
                total[3] += w
                total[4] += w * depth[i]
                weight[i] = w
                left *= passed
            for a in ti.static(range(5)):
                sums[r, a] = total[a]

    @ti.func
    def worth(by_sums: ti.template(), by_weight: ti.template(), colour: ti.template(), depth: ti.template(), r, i):
        """What one more unit of a sample's weight adds to the loss."""
        v = by_sums[r, 3] + by_sums[r, 4] * depth[i] + by_weight[i]
        for a in ti.static(range(3)):
            v += by_sums[r, a] * colour[i, a]
        return v

    @ti.kernel
    def backward(
        colour: Reals2, length: Reals1, depth: Reals1, density: Reals1, rays: Rays, weight: Reals1, by_sums: Reals2,
        by_weight: Reals1, by_density: Reals1, by_colour: Reals2,
    ):  # fmt: skip
        # dL/dsigma_i = delta_i (T_{i+1} v_i - sum_{j>i} w_j v_j), with v the worth of a weight
        for r in range(rays.shape[0]):
            left, behind = ti.cast(1, real), ti.cast(0, real)
            first, count = rays[r, 0], rays[r, 1]
            for i in range(first, first + count):
                behind += weight[i] * worth(by_sums, by_weight, colour, depth, r, i)
            for i in range(first, first + count):
                v = worth(by_sums, by_weight, colour, depth, r, i)
                behind -= weight[i] * v
                left *= ti.exp(-density[i] * length[i])
                by_density[i] = length[i] * (left * v - behind)
                for a in ti.static(range(3)):
                    by_colour[i, a] = by_sums[r, a] * weight[i]

    return _Kernels(forward=forward, backward=backward)
