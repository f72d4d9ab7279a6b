"""The networks: a canonical field v(x) = (density, colour), and offsets that bend samples into it and carry points out.

Paper, section "4D Reconstruction"; Tretschk et al. 2021 (NR-NeRF).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch

from recon.radiance.hashgrid import HashEncoding, HashGrid
from sim.checks import as_array, require

Field = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, torch.Tensor]]  # places, frames -> density, colour

ENCODINGS = ("hash", "positional")
_DENSEST = 8.0  # log of the largest density times the box's side
_START = 2.0  # log of the density, likewise, that an untrained field has
_LEAK = 0.1  # of offset networks: while frames hardly move, all of a layer's plain units can die, and stay so
_HALF = 0.625  # half the box in the units that offset networks see


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """The cube of space that is reconstructed: lowest corner (3,) and side [m]."""

    origin: np.ndarray
    side: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", as_array("origin", self.origin, (3,)))
        require(0 < self.side < math.inf, "side", "be positive", self.side)

    def unit(self, places: torch.Tensor) -> torch.Tensor:
        """Places (N, 3) [m] in the unit cube."""
        return (places - torch.from_numpy(self.origin).to(places)) / self.side


@dataclass(frozen=True, kw_only=True)
class FieldOptions:
    """encoding: "hash", or "positional" as the paper has it; bands of the latter; width and depth of the network."""

    encoding: str = "hash"
    grid: HashGrid = field(default_factory=HashGrid)
    bands: int = 8
    width: int = 32
    depth: int = 1

    def __post_init__(self) -> None:
        require(self.encoding in ENCODINGS, "encoding", f"be one of {', '.join(ENCODINGS)}", self.encoding)
        require(min(self.bands, self.width, self.depth) >= 1, "bands, width and depth", "be positive", self)

    @classmethod
    def paper(cls) -> "FieldOptions":
        """NeRF's: positional encoding with ten bands, eight layers of 256."""
        return cls(encoding="positional", bands=10, width=256, depth=8)


class CanonicalField(torch.nn.Module):
    """v(x): density [1/m] and colour in 0 to 1 at places (N, 3) [m]."""

    def __init__(self, box: Box, options: FieldOptions, *, seed: int = 0) -> None:
        super().__init__()
        self.box = box
        hashed = options.encoding == "hash"
        self.encoding = HashEncoding(options.grid, seed=seed) if hashed else Positional(options.bands)
        width = options.grid.width if hashed else self.encoding.width
        self.network = perceptron(width, options.width, options.depth, 4, seed=seed)

    def forward(self, places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """`density = exp(min(h + 2, 8)) / side`: never negative, and no step can make it infinite."""
        h = self.network(self.encoding(self.box.unit(places)))
        density = torch.exp((h[:, 0] + _START).clamp(max=_DENSEST)) / self.box.side
        return density, torch.sigmoid(h[:, 1:])


class Positional(torch.nn.Module):
    """x, then sines and cosines of 2^k pi x for x in -1 to 1 (Mildenhall et al. 2020)."""

    def __init__(self, bands: int) -> None:
        super().__init__()
        self.register_buffer("frequency", math.pi * 2.0 ** torch.arange(bands), persistent=False)

    @property
    def width(self) -> int:
        """Numbers that encode one place."""
        return 3 + 6 * len(self.frequency)

    def forward(self, unit: torch.Tensor) -> torch.Tensor:
        """(N, 3) in the unit cube to (N, width)."""
        x = 2 * unit - 1
        angle = (x[..., None] * self.frequency).flatten(1)
        return torch.cat([x, torch.sin(angle), torch.cos(angle)], dim=1)


class Offset(torch.nn.Module):
    """An offset (N, 3) [m] of places (N, 3) [m], conditioned by latents (N, L); zero until trained.

    The same network serves the bending b(x, l) and the forward warp w(x, l).
    """

    def __init__(
        self, box: Box, latent: int, *, width: int = 64, depth: int = 4, bands: int = 2, seed: int = 0
    ) -> None:
        super().__init__()
        self.box = box
        self.register_buffer("frequency", math.pi * 2.0 ** torch.arange(bands), persistent=False)
        self.network = perceptron(3 + 6 * bands + latent, width, depth, 3, seed=seed, leak=_LEAK)
        torch.nn.init.zeros_(self.network[-1].weight)
        torch.nn.init.zeros_(self.network[-1].bias)

    def forward(self, places: torch.Tensor, latent: torch.Tensor) -> torch.Tensor:
        """In the box's own units inside, so that the same rates suit objects of every size."""
        x = _HALF * (2 * self.box.unit(places) - 1)
        angle = (x[..., None] * self.frequency).flatten(1)
        h = self.network(torch.cat([2 * x, torch.sin(angle), torch.cos(angle), latent], dim=1))
        return h * (self.box.side / (2 * _HALF))


class Dynamic(torch.nn.Module):
    """A canonical field with the motion of all frames: `v(x + b(x, l_t))`, and w that carries canonical points to t.

    Training starts with frame 0 as the canonical state. Later frame 0 is bent like any other: what the motions of all
    frames have in common then moves the canonical state, and not frame 0 against all others.
    """

    def __init__(self, box: Box, frames: int, options: FieldOptions, *, latent: int = 16, seed: int = 0) -> None:
        super().__init__()
        require(frames >= 1, "frames", "be at least 1", frames)
        self.canonical = CanonicalField(box, options, seed=seed)
        self.bending = Offset(box, latent, seed=seed + 1)
        self.warping = Offset(box, latent, seed=seed + 2)
        self.latents = torch.nn.Parameter(torch.zeros(frames, latent))

    def forward(self, places: torch.Tensor, frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Density [1/m] and colour at places (N, 3) [m] in frames (N,)."""
        return self.canonical(self.bent(places, frame))

    def first(self, places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Density [1/m] and colour at places (N, 3) [m] in frame 0."""
        return self.canonical(self.from_first(places))

    def from_first(self, places: torch.Tensor) -> torch.Tensor:
        """Where in the canonical state a place of frame 0 belongs, (N, 3) [m]."""
        return self.bent(places, torch.zeros(len(places), dtype=torch.long, device=places.device))

    def bent(self, places: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
        """Where in the canonical state a place of a frame belongs, (N, 3) [m]."""
        return places + self.bending(places, self._latent(frame))

    def warped(self, canonical: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
        """Where in a frame a canonical place is, (N, 3) [m]."""
        return canonical + self.warping(canonical, self._latent(frame).detach())

    def _latent(self, frame: torch.Tensor) -> torch.Tensor:
        count = len(self.latents)
        known = bool(((frame >= 0) & (frame < count)).all())
        require(known, "frame", f"be 0 to {count - 1}", frame.tolist()[:5] if not known else "")
        return torch.nn.functional.embedding(frame, self.latents)  # whose gradient is summed in the same order always


def perceptron(
    inputs: int, width: int, depth: int, outputs: int, *, seed: int, leak: float = 0.0
) -> torch.nn.Sequential:
    """A multilayer perceptron with `depth` hidden layers and ReLU, leaking so much below zero; the same weights for the
    same seed."""
    layers: list[torch.nn.Module] = []
    for _ in range(depth):
        layers += [torch.nn.Linear(inputs, width), torch.nn.LeakyReLU(leak, inplace=True)]
        inputs = width
    layers.append(torch.nn.Linear(inputs, outputs))
    generator = torch.Generator().manual_seed(seed)
    for layer in layers[::2]:
        bound = 1 / math.sqrt(layer.in_features)
        for values in (layer.weight, layer.bias):
            with torch.no_grad():
                values.uniform_(-bound, bound, generator=generator)
    return torch.nn.Sequential(*layers)
